"""The belief over objects: its cost-to-go, its law, and what keeps it from running away."""

from itertools import pairwise

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import rotation
from optsc.selection.intent import Belief, Goals, HuberCost, IntentSettings, cost_to_go, updated, wasted

SETTINGS = IntentSettings()
PLAIN = IntentSettings(rationality=1.0, leak=0.0, cap=1.0 - 1e-12)
FORWARD = np.array([1.0, 0.0, 0.0, 0.0])


def goals_at(*places, quaternions=None, names=None):
    """Objects with one grasp each."""
    p = np.array(places, dtype=float)
    count = len(p)
    q = np.tile(FORWARD, (count, 1)) if quaternions is None else np.array(quaternions)
    names = names or tuple("abcdefgh"[:count])
    index = np.arange(count)
    return Goals(names, index, index, p, q, index, np.ones(count))


def go(settings, goals, belief, path, q=FORWARD):
    """Let the hand move the tool along a path (T, 3)."""
    for x, y in pairwise(path):
        before, after = cost_to_go(settings, goals, x, q), cost_to_go(settings, goals, y, q)
        belief = updated(settings, belief, wasted(settings, before, after, np.linalg.norm(y - x), 0.0))
    return belief


def test_the_cost_to_go_has_the_values_that_the_constants_give():
    # V_t(0.05) = 2.25 / 0.14 * 0.0025 + 0.2 * 0.05; V_t(0.5) = 2.45 * 0.5 - 2.25 * 0.07 / 2
    V_t = SETTINGS.translation
    assert V_t.value(np.array(0.05)) == pytest.approx(0.0401785714 + 0.01)
    assert V_t.value(np.array(0.5)) == pytest.approx(1.225 - 0.07875)
    assert V_t.derivative(np.array(0.5)) == pytest.approx(2.45)
    assert V_t.derivative(np.array(0.035)) == pytest.approx(1.125 + 0.2)
    # V_r(1) = 0.07 (0.21 - 0.2 * pi / 64)
    assert SETTINGS.rotation.value(np.array(1.0)) == pytest.approx(0.07 * (0.21 - 0.2 * np.pi / 64))


def test_the_cost_to_go_and_its_derivative_belong_together_and_meet_at_the_width():
    cost = HuberCost(2.25, 0.07, 0.2, 1.3)
    d = np.linspace(0.0, 0.2, 2001)
    np.testing.assert_allclose(np.gradient(cost.value(d), d)[1:-1], cost.derivative(d)[1:-1], atol=0.02)
    assert cost.value(np.array(0.07)) == pytest.approx(float(cost.value(np.array(0.07 + 1e-12))))


def test_the_nearest_grasp_of_an_object_counts():
    goals = Goals(
        ("a", "b"),
        np.array([0, 0, 1]),
        np.array([0, 2]),
        np.array([[0.5, 0, 0], [0.1, 0, 0], [0.3, 0, 0]]),
        np.array([FORWARD, rotation.exp([0, 0, 0.5]), FORWARD]),
        np.array([7, 8, 9]),
        np.ones(3),
    )
    here = cost_to_go(SETTINGS, goals, np.zeros(3), FORWARD)
    assert here.row.tolist() == [1, 2]
    np.testing.assert_allclose(here.distance, [0.1, 0.3])
    np.testing.assert_allclose(here.angle, [0.5, 0.0], atol=1e-12)
    expected = SETTINGS.translation.value(np.array(0.1)) + SETTINGS.rotation.value(np.array(0.5))
    assert here.value[0] == pytest.approx(float(expected))


def test_nothing_is_wasted_on_the_straight_path_far_from_the_goal_and_twice_the_path_on_the_opposite():
    goals = goals_at([0.5, 0, 0], [-0.5, 0, 0])
    x, y = np.zeros(3), np.array([0.1, 0, 0])
    before, after = (cost_to_go(SETTINGS, goals, p, FORWARD) for p in (x, y))
    np.testing.assert_allclose(wasted(SETTINGS, before, after, 0.1, 0.0), [0.0, 2 * 2.45 * 0.1], atol=1e-12)


def test_no_motion_wastes_less_than_nothing():
    rng = np.random.default_rng(0)
    for _ in range(200):
        goals = goals_at(rng.uniform(-0.3, 0.3, 3), quaternions=[rotation.random(rng)])
        x, y = rng.uniform(-0.3, 0.3, (2, 3))
        q, turn = rotation.random(rng), rng.uniform(-0.5, 0.5, 3)
        before = cost_to_go(SETTINGS, goals, x, q)
        after = cost_to_go(SETTINGS, goals, y, rotation.multiply(rotation.exp(turn), q))
        waste = wasted(SETTINGS, before, after, np.linalg.norm(y - x), np.linalg.norm(turn))
        assert waste[0] > -1e-12


def test_a_hand_computed_posterior():
    # The path of 10 cm straight to a wastes 0.49 on b, which is opposite: odds e^0.49 to 1.
    goals = goals_at([0.5, 0, 0], [-0.5, 0, 0])
    belief = go(PLAIN, goals, Belief.even(("a", "b")), np.array([[0, 0, 0], [0.1, 0, 0]], dtype=float))
    assert belief.probability[0] == pytest.approx(1 / (1 + np.exp(-0.49)))
    assert belief.best == "a"
    assert belief.gap == pytest.approx(np.tanh(0.245))


def test_many_steps_telescope_to_what_they_cost_less_what_the_path_gained():
    rng = np.random.default_rng(1)
    goals = goals_at([0.4, 0.1, 0], [0.1, 0.4, 0], [-0.3, 0.2, 0.1])
    path = np.cumsum(rng.normal(0.01, 0.01, (30, 3)), axis=0)
    belief = go(PLAIN, goals, Belief.even(goals.names), path)
    ends = [cost_to_go(PLAIN, goals, path[i], FORWARD) for i in (0, -1)]
    cost = sum(
        PLAIN.translation.derivative(cost_to_go(PLAIN, goals, x, FORWARD).distance) * np.linalg.norm(y - x)
        for x, y in pairwise(path)
    )
    log_b = -(cost + ends[1].value - ends[0].value)
    expected = np.exp(log_b - log_b.max())
    np.testing.assert_allclose(belief.probability, expected / expected.sum(), rtol=1e-9)


def test_the_belief_follows_the_hand_and_changes_its_mind_with_it():
    goals = goals_at([0.4, 0.2, 0], [0.4, -0.2, 0], [0.5, 0, 0])
    to_a = np.linspace([0, 0, 0], [0.35, 0.18, 0], 40)
    belief = go(SETTINGS, goals, Belief.even(goals.names), to_a)
    assert belief.best == "a"
    assert belief.gap > 0.4
    belief = go(SETTINGS, goals, belief, np.linspace(to_a[-1], [0.4, -0.15, 0], 40))
    assert belief.best == "b"
    assert belief.gap > 0.4


def test_the_greatest_belief_is_capped_and_the_excess_goes_to_the_others_evenly():
    settings = IntentSettings(leak=0.0)
    belief = updated(settings, Belief.even(("a", "b", "c")), np.array([0.0, 50.0, 60.0]))
    np.testing.assert_allclose(belief.probability, [0.99, 0.005, 0.005])
    assert belief.probability.sum() == pytest.approx(1.0)


def test_the_leak_brings_back_what_was_given_up():
    belief = Belief.even(("a", "b"))
    for _ in range(300):
        belief = updated(SETTINGS, belief, np.array([0.0, 0.02]))
    assert belief.probability[1] > 0.005
    for _ in range(1000):
        belief = updated(SETTINGS, belief, np.zeros(2))
    assert belief.gap < 1e-3


def test_absurd_waste_leaves_a_belief_that_is_a_belief():
    belief = updated(SETTINGS, Belief.even(("a", "b")), np.array([1e9, 2e9]))
    assert np.all(np.isfinite(belief.probability))
    assert belief.probability.sum() == pytest.approx(1.0)


def test_a_single_object_is_certain_and_none_is_nothing():
    assert updated(SETTINGS, Belief.even(("a",)), np.array([3.0])).gap == 1.0
    assert (Belief.even(()).best, Belief.even(()).gap) == (None, 0.0)


def test_among_other_objects_those_known_keep_their_proportions():
    belief = Belief(("a", "b", "c"), np.array([0.6, 0.3, 0.1]))
    fewer = belief.among(("a", "b"))
    np.testing.assert_allclose(fewer.probability, [2 / 3, 1 / 3])
    more = fewer.among(("a", "b", "d"))
    np.testing.assert_allclose(more.probability, [4 / 9, 2 / 9, 1 / 3])
    np.testing.assert_allclose(belief.among(("x", "y")).probability, [0.5, 0.5])
    assert belief.among(belief.names) is belief


def test_the_belief_does_not_depend_on_the_world_frame():
    rng = np.random.default_rng(2)
    places, q = rng.uniform(-0.4, 0.4, (3, 3)), rotation.random(rng, (3,))
    R, shift = rotation.random(rng), rng.normal(size=3)
    path = np.cumsum(rng.normal(0.01, 0.01, (10, 3)), axis=0)
    here = go(SETTINGS, goals_at(*places, quaternions=q), Belief.even(tuple("abc")), path)
    moved = goals_at(*(rotation.rotate(R, places) + shift), quaternions=rotation.multiply(R, q))
    there = go(SETTINGS, moved, Belief.even(tuple("abc")), rotation.rotate(R, path) + shift, q=R)
    np.testing.assert_allclose(here.probability, there.probability, rtol=1e-9)


@pytest.mark.parametrize(
    "bad",
    [
        {"rationality": 0.0},
        {"leak": 1.0},
        {"cap": 1.0},
        {"dead_band": (0.01, -1.0)},
        {"dead_band": (0.01,)},
        {"rationality": np.nan},
    ],
)
def test_settings_out_of_range_are_refused(bad):
    with pytest.raises(InvalidValue):
        IntentSettings(**bad)


def test_a_cost_without_a_width_is_refused():
    with pytest.raises(InvalidValue, match="width"):
        HuberCost(1.0, 0.0, 0.1)
