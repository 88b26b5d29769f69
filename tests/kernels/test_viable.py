"""The viable interval holds every limit for ever, whatever is asked for."""

import numpy as np
import pytest

from optsc.kernels.kernel import build_kernel
from optsc.kernels.viable import Bound, advance, viable_interval

N = 12


def random_limits(rng):
    velocity, acceleration = rng.uniform(0.3, 4, N), 10 ** rng.uniform(0, 1.5, N)
    jerk = acceleration / 10 ** rng.uniform(-2.7, -0.5, N)
    return np.column_stack([-rng.uniform(0.05, 3, N), rng.uniform(0.05, 3, N), velocity, acceleration, jerk])


def wishes(kind, rng, ticks):
    if kind == "push to one end, then the other":
        return np.where((np.arange(ticks) // 700) % 2, 50.0, -50.0)[:, None] * np.ones(N)
    if kind == "bang-bang":
        return rng.choice([-50.0, 50.0], size=(ticks, N))
    return np.repeat(rng.normal(scale=3, size=(ticks // 37 + 1, N)), 37, axis=0)[:ticks]


def drive(limits, wanted, period, state=None):
    kernel = build_kernel(viable_interval(N))
    state = np.zeros((N, 3)) if state is None else state.copy()
    states, closed = [state.copy()], []
    for wish in wanted:
        lowest, highest, bounds, outside = kernel(state, limits, [period])
        beyond = np.maximum(state[:, 0] - limits[:, 1], limits[:, 0] - state[:, 0])
        assert outside == pytest.approx(max(beyond.max(), 0.0), abs=1e-12)
        assert np.all(lowest <= highest)
        v = np.clip(wish, lowest, highest)
        q = state[:, 0] + 0.5 * period * (state[:, 1] + v)
        state = np.column_stack([q, v, (v - state[:, 1]) / period])
        states.append(state)
        closed.append(bounds)
    return np.array(states), np.array(closed)


@pytest.mark.parametrize("kind", ["push to one end, then the other", "bang-bang", "steps"])
@pytest.mark.parametrize("period", [1e-3, 4e-3])
def test_every_limit_holds_at_every_tick_for_every_wish(kind, period):
    rng = np.random.default_rng(5)
    limits = random_limits(rng)
    states, _ = drive(limits, wishes(kind, rng, 3000), period)
    q, v, a = np.moveaxis(states, 2, 0)
    lower, upper, V, A, J = limits.T
    assert np.all(q <= upper + 1e-12)
    assert np.all(q >= lower - 1e-12)
    assert np.all(np.abs(v) <= V + 1e-12)
    assert np.all(np.abs(a) <= A * (1 + 1e-12))
    assert np.all(np.abs(np.diff(a, axis=0)) <= J * period * (1 + 1e-9))


def test_a_push_against_a_limit_comes_to_rest_there_without_a_bounce():
    limits = random_limits(np.random.default_rng(2))
    states, closed = drive(limits, np.full((12000, N), 50.0), 1e-3)
    q, v, _ = np.moveaxis(states, 2, 0)
    np.testing.assert_allclose(q[-1], limits[:, 1], atol=1e-4)
    assert np.all(v[-2000:] >= -1e-9)
    np.testing.assert_array_equal(closed[-1, :, 1], Bound.POSITION)


def test_a_start_outside_comes_back_and_keeps_the_rates():
    rng = np.random.default_rng(3)
    limits = random_limits(rng)
    start = np.column_stack([limits[:, 1] + 0.1, rng.uniform(-0.2, 0.2, N), np.zeros(N)])
    states, _ = drive(limits, np.full((6000, N), 50.0), 1e-3, start)
    q, v, a = np.moveaxis(states, 2, 0)
    assert np.all(q[-1] <= limits[:, 1] + 1e-9)
    assert np.all(np.abs(v) <= limits[:, 2] + 1e-12)
    assert np.all(np.abs(np.diff(a, axis=0)) <= limits[:, 4] * 1e-3 * (1 + 1e-9))


def test_limits_that_tighten_in_motion_are_met_as_soon_as_jerk_and_acceleration_allow():
    rng = np.random.default_rng(4)
    limits = random_limits(rng)
    limits[:, 0], limits[:, 1] = -50, 50
    states, _ = drive(limits, np.full((3000, N), 50.0), 1e-3)
    tight = limits * [1, 1, 0.3, 1, 1]
    states, _ = drive(tight, np.full((3000, N), 50.0), 1e-3, states[-1])
    _, v, a = np.moveaxis(states, 2, 0)
    np.testing.assert_allclose(v[-1], tight[:, 2], rtol=1e-6)
    assert np.all(np.abs(np.diff(a, axis=0)) <= limits[:, 4] * 1e-3 * (1 + 1e-9))


def test_an_endless_joint_is_bounded_by_its_rates_alone():
    limits = random_limits(np.random.default_rng(6))
    limits[:, 0], limits[:, 1] = -np.inf, np.inf
    states, closed = drive(limits, np.full((4000, N), 50.0), 1e-3)
    np.testing.assert_allclose(states[-1, :, 1], limits[:, 2], rtol=1e-9)
    assert not np.any(closed == Bound.POSITION)


def test_motion_away_from_a_limit_is_free():
    limits = random_limits(np.random.default_rng(7))
    resting = np.column_stack([limits[:, 1], np.zeros(N), np.zeros(N)])
    lowest, highest, *_ = build_kernel(viable_interval(N))(resting, limits, [1e-3])
    np.testing.assert_allclose(lowest, -np.minimum(limits[:, 4] * 1e-3, limits[:, 3]) * 1e-3)
    np.testing.assert_allclose(highest, 0, atol=1e-12)


def test_a_tick_in_one_call_is_the_motion_of_the_formulas_and_the_interval_of_the_state_it_leads_to():
    together, alone = build_kernel(advance(N)), build_kernel(viable_interval(N))
    rng, viable = np.random.default_rng(4), 0
    for _ in range(300):
        rates = rng.uniform([0.5, 1, 50], [3, 20, 5000], (N, 3))
        limits = np.column_stack([-rng.uniform(0.1, 3, N), rng.uniform(0.1, 3, N), rates])
        state, dt = rng.uniform(-1, 1, (N, 3)) * [1.0, 0.5, 1.0], rng.choice([1e-3, 8e-3])
        interval = np.column_stack(alone(state, limits, [dt])[:2])
        share = rng.uniform(-0.02, 1.02, N) if rng.random() < 0.3 else rng.uniform(0, 1, N)
        velocity = interval[:, 0] + share * (interval[:, 1] - interval[:, 0])
        after, next_interval, bounds, outside, inside = together(state, interval, velocity, limits, [dt])
        is_viable = np.all((velocity >= interval[:, 0]) & (velocity <= interval[:, 1]))
        assert inside[0] == is_viable
        viable += is_viable
        q, v, _ = state.T
        expected = np.column_stack([q + 0.5 * dt * (v + velocity), velocity, (velocity - v) / dt])
        np.testing.assert_array_equal(after, expected)
        lowest, highest, *rest = alone(after, limits, [dt])
        np.testing.assert_array_equal(next_interval, np.column_stack([lowest, highest]))
        np.testing.assert_array_equal(bounds, rest[0])
        np.testing.assert_array_equal(outside, rest[1])
    assert 150 < viable < 300
    (*_, inside) = together(state, interval, np.full(N, np.nan), limits, [dt])
    assert inside[0] == 0.0
