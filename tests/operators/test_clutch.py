"""The clutch against the paper's formulas, and its law: coupling never moves the target."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optsc.errors import InvalidValue
from optsc.geometry import rotation, scalar
from optsc.operators import ClutchSettings, Slerp
from optsc.operators.clutch import Hand, engage, follow

seeds = st.integers(0, 2**32 - 1)


def random_hand(rng, stamp):
    return Hand(tuple(rng.normal(size=3)), tuple(rotation.random(rng)), stamp)


def settings_from(rng):
    relative = rng.random() < 0.5
    return ClutchSettings(
        R_WS=tuple(rotation.random(rng)),
        scale=rng.uniform(0.1, 3),
        rotation_scale=rng.uniform(0.1, 3) if relative else 1.0,
        orientation="relative" if relative else "absolute",
    )


@given(seeds)
def test_engaging_releasing_or_re_engaging_the_clutch_never_moves_the_target(seed):
    rng = np.random.default_rng(seed)
    settings = settings_from(rng)
    p, q = tuple(rng.normal(size=3)), tuple(rotation.random(rng))
    for n in range(5):
        state = engage(settings, random_hand(rng, float(n)), p, q)
        assert state.tool_p == p
        assert rotation.angle(state.tool_q, q) < 1e-12
        # A hand that does not move while no time passes leaves it there, too.
        again = follow(
            settings,
            state,
            Hand(
                scalar.rotate(scalar.conjugate(settings.R_WS), state.hand_p),
                scalar.multiply(scalar.conjugate(settings.R_WS), state.hand_q),
                float(n),
            ),
        )
        np.testing.assert_allclose(again.tool_p, p, atol=1e-9)
        assert rotation.angle(again.tool_q, q) < 1e-7
        moved = follow(settings, state, random_hand(rng, n + 0.5))
        p, q = moved.tool_p, moved.tool_q


@given(seeds)
def test_position_follows_the_papers_formula(seed):
    rng = np.random.default_rng(seed)
    R_WS = rotation.random(rng)
    settings = ClutchSettings(R_WS=tuple(R_WS), fade=0.0)
    first, p0 = random_hand(rng, 0.0), rng.normal(size=3)
    state = engage(settings, first, tuple(p0), (1.0, 0.0, 0.0, 0.0))
    for k in range(1, 6):
        hand = random_hand(rng, 0.01 * k)
        state = follow(settings, state, hand)
        expected = p0 + rotation.rotate(R_WS, np.subtract(hand.p, first.p))
        np.testing.assert_allclose(state.tool_p, expected, atol=1e-9)


@given(seeds)
def test_the_papers_slerp_is_its_equation_sample_for_sample(seed):
    rng = np.random.default_rng(seed)
    alpha, rate, R_WS = 0.1, 90.0, rotation.random(rng)
    settings = ClutchSettings(R_WS=tuple(R_WS), slerp=Slerp.paper(alpha, rate))
    hand = random_hand(rng, 0.0)
    state = engage(settings, hand, (0.0, 0.0, 0.0), tuple(rotation.random(rng)))
    R = np.array(state.tool_q)
    q = np.array(hand.q)
    for k in range(1, 20):
        q = rotation.multiply(rotation.exp(rng.normal(size=3) * 0.05), q)
        state = follow(settings, state, Hand(hand.p, tuple(q), k / rate))
        R = rotation.slerp(R, rotation.multiply(R_WS, q), alpha)
        assert rotation.angle(R, state.tool_q) < 1e-6


def test_a_resting_hand_is_reached_alike_by_both_ways_of_slerp():
    hand, q0 = Hand((0, 0, 0), (1.0, 0, 0, 0), 0.0), tuple(rotation.exp([0.0, 0.4, 0.0]))
    ends = []
    for lagging in (False, True):
        settings = ClutchSettings(slerp=Slerp(0.1, lagging=lagging))
        state = engage(settings, hand, (0, 0, 0), q0)
        for k in range(1, 60):
            state = follow(settings, state, hand._replace(stamp=k / 90))
        ends.append(state.tool_q)
    assert rotation.angle(*ends) < 1e-9
    assert rotation.angle(ends[0], hand.q) < 0.01


def test_a_moving_hand_is_followed_without_lag_once_the_mismatch_is_gone():
    settings = ClutchSettings()
    state = engage(settings, Hand((0, 0, 0), (1.0, 0, 0, 0), 0.0), (0, 0, 0), tuple(rotation.exp([0.3, 0, 0])))
    for k in range(1, 400):
        q = tuple(rotation.exp([0, 0, 0.01 * k]))
        state = follow(settings, state, Hand((0, 0, 0), q, k / 90))
    assert rotation.angle(state.tool_q, q) < 1e-6


def test_the_speed_that_the_fading_adds_is_bounded_at_every_rate():
    for rate in (50.0, 90.0, 1000.0):
        settings = ClutchSettings(slerp=Slerp(0.1, largest_rate=1.0))
        state = engage(settings, Hand((0, 0, 0), (1.0, 0, 0, 0), 0.0), (0, 0, 0), tuple(rotation.exp([2.5, 0, 0])))
        for k in range(1, 200):
            before, state = state, follow(settings, state, Hand((0, 0, 0), (1.0, 0, 0, 0), k / rate))
            assert rotation.angle(before.tool_q, state.tool_q) * rate <= 1.0 + 1e-6


def test_a_relative_rotation_is_scaled_and_goes_beyond_half_a_turn():
    settings = ClutchSettings(orientation="relative", rotation_scale=0.5)
    state = engage(settings, Hand((0, 0, 0), (1.0, 0, 0, 0), 0.0), (0, 0, 0), (1.0, 0, 0, 0))
    for k in range(1, 101):
        state = follow(settings, state, Hand((0, 0, 0), tuple(rotation.exp([0, 0, 0.05 * k])), k / 90))
    assert rotation.angle(state.tool_q, rotation.exp([0, 0, 2.5])) < 1e-9


@given(seeds)
def test_once_the_motion_has_faded_in_the_mapping_is_the_papers_again(seed):
    rng = np.random.default_rng(seed)
    relative = rng.random() < 0.5
    fading = ClutchSettings(scale=rng.uniform(0.1, 3), orientation="relative" if relative else "absolute", fade=0.3)
    plain = replace(fading, fade=0.0)
    hand = random_hand(rng, 1.0)
    p, q = tuple(rng.normal(size=3)), tuple(rotation.random(rng))
    held, free = engage(fading, hand, p, q), engage(plain, hand, p, q)
    for stamp in (1.01, 1.1, 1.2, 1.31, 1.5):
        hand = random_hand(rng, stamp)
        held, free = follow(fading, held, hand), follow(plain, free, hand)
    np.testing.assert_allclose(held.tool_p, free.tool_p, atol=1e-9)
    assert rotation.angle(held.tool_q, free.tool_q) < 1e-6


@pytest.mark.parametrize("orientation", ["absolute", "relative"])
def test_a_moving_hand_sets_the_target_in_motion_from_rest_and_no_faster_than_four_thirds_of_its_own(
    orientation,
):
    settings, steps = ClutchSettings(fade=0.3, orientation=orientation), []
    state = engage(settings, Hand((0, 0, 0), (1.0, 0, 0, 0), 1.0), (0, 0, 0), (1.0, 0, 0, 0))
    for k in range(1, 301):
        before = state.tool_p[0]
        state = follow(settings, state, Hand((1e-3 * k, 0, 0), (1.0, 0, 0, 0), 1.0 + k / 500))
        steps.append(state.tool_p[0] - before)
    assert 0.0 < steps[0] < 0.02 * 1e-3
    assert np.abs(np.diff(steps)).max() < 1.1 * 4.0 / 0.3 / 500 * 1e-3
    assert max(steps) == pytest.approx(4 / 3 * 1e-3, rel=1e-3)
    np.testing.assert_allclose(steps[150:], 1e-3)
    assert state.tool_p[0] == pytest.approx(0.3)


@pytest.mark.parametrize(
    "wrong",
    [
        {"R_WS": (0.0, 0.0, 0.0, 0.0)},
        {"R_WS": (2.0, 0.0, 0.0, 0.0)},
        {"scale": -1.0},
        {"orientation": "sideways"},
        {"rotation_scale": 0.5},
    ],
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(InvalidValue):
        ClutchSettings(**wrong)
    with pytest.raises(InvalidValue):
        Slerp(time_constant=0.0)
    with pytest.raises(InvalidValue):
        Slerp.paper(1.5, 90.0)
