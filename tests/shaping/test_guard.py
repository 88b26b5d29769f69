"""The joint guard: a feasible reference passes unchanged, and no wish breaks a limit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import Result, RuckigError

from optsc.errors import InvalidValue
from optsc.robot import ROBOT_NAMES, load_robot
from optsc.shaping import JointGuard

TOLERANCE = 1e-9


def run(guard, wishes):
    states = [guard.state]
    for wish in wishes:
        states.append(guard.advance(wish))
    return (np.array([getattr(state, name) for state in states]) for name in "qva")


def assert_within(limits, period, q, v, a):
    assert np.all(q <= limits.upper + TOLERANCE)
    assert np.all(q >= limits.lower - TOLERANCE)
    assert np.all(np.abs(v) <= limits.velocity + TOLERANCE)
    assert np.all(np.abs(a) <= limits.acceleration + TOLERANCE * limits.acceleration)
    assert np.all(np.abs(np.diff(a, axis=0)) <= limits.jerk * period * (1 + TOLERANCE))


@settings(deadline=None, max_examples=25)
@given(
    st.sampled_from(ROBOT_NAMES),
    st.sampled_from([250.0, 500.0, 1000.0]),
    st.integers(0, 2**32 - 1),
    st.sampled_from(["steps", "noise", "not a number", "infinite"]),
)
def test_commanded_position_velocity_acceleration_and_jerk_stay_within_limits(name, rate, seed, kind):
    robot, rng = load_robot(name), np.random.default_rng(seed)
    guard = JointGuard(robot.limits, 1 / rate)
    guard.reset(robot.random_configuration(rng))
    wishes = np.repeat(rng.normal(scale=5, size=(12, robot.n)), 40, axis=0)
    if kind == "noise":
        wishes = rng.normal(scale=5, size=(480, robot.n))
    elif kind == "not a number":
        wishes[rng.random(480) < 0.3] = np.nan
    elif kind == "infinite":
        wishes = np.where(rng.random((480, robot.n)) < 0.5, np.inf, wishes)
    assert_within(robot.limits, 1 / rate, *run(guard, wishes))


def test_a_feasible_reference_passes_through_unchanged():
    robot = load_robot("panda")
    guard = JointGuard(robot.limits, 1e-3)
    guard.reset(robot.home)
    t = np.arange(1, 3000) * 1e-3
    wishes = (0.3 * np.sin(2 * t) ** 3)[:, None] * np.ones(7)
    _, v, _ = run(guard, wishes)
    np.testing.assert_array_equal(v[1:], wishes)


def test_a_stop_is_jerk_limited_and_does_not_overshoot():
    robot = load_robot("iiwa")
    guard = JointGuard(robot.limits, 2e-3)
    guard.reset(robot.home)
    _, v, _ = run(guard, np.full((200, 7), 0.5))
    assert v[-1] == pytest.approx(0.5)
    q, v, a = run(guard, np.zeros((300, 7)))
    assert np.all(v >= -1e-9)
    np.testing.assert_allclose(v[-1], 0, atol=1e-9)
    assert_within(robot.limits, 2e-3, q, v, a)
    assert guard.planner_failures == 0


def test_a_stop_takes_no_longer_than_jerk_and_acceleration_force():
    robot = load_robot("iiwa")
    guard = JointGuard(robot.limits, 1e-3)
    guard.reset(robot.home)
    run(guard, np.full((300, 7), 0.5))
    _, v, _ = run(guard, np.zeros((300, 7)))
    needed = 0.5 / robot.limits.acceleration[0] + robot.limits.acceleration[0] / robot.limits.jerk[0]
    stopped = np.argmax(np.all(np.abs(v) < 1e-6, axis=1)) * 1e-3
    assert stopped <= 1.2 * needed + 0.005


def test_limits_that_tighten_in_motion_are_met_without_breaking_jerk_or_acceleration():
    robot = load_robot("panda")
    guard = JointGuard(robot.limits, 1e-3)
    guard.reset(robot.home)
    _, v, a = run(guard, np.full((300, 7), 1.0))
    tight = robot.limits.tightened(velocity=0.2)
    guard.set_limits(tight)
    _, v, after = run(guard, np.full((400, 7), 1.0))
    np.testing.assert_allclose(v[-1], tight.velocity, rtol=1e-6)
    a = np.concatenate([a, after[1:]])
    assert np.all(np.abs(a) <= robot.limits.acceleration * (1 + TOLERANCE))
    assert np.all(np.abs(np.diff(a, axis=0)) <= robot.limits.jerk * 1e-3 * (1 + TOLERANCE))
    with pytest.raises(InvalidValue, match="joints"):
        guard.set_limits(load_robot("ur5").limits)


def test_a_start_outside_says_how_far_and_comes_back():
    robot = load_robot("panda")
    guard = JointGuard(robot.limits, 1e-3)
    start = robot.home.copy()
    start[3] = robot.limits.upper[3] + 0.05
    guard.reset(start)
    assert guard.outside == pytest.approx(0.05)
    run(guard, np.full((2000, 7), 1.0))
    assert guard.outside <= 1e-9


def test_a_bad_start_is_refused():
    robot = load_robot("panda")
    guard = JointGuard(robot.limits, 1e-3)
    for wrong in (np.full(7, np.nan), np.zeros(6)):
        with pytest.raises(InvalidValue):
            guard.reset(wrong)
    with pytest.raises(InvalidValue, match="period"):
        JointGuard(robot.limits, 0.0)


FAILURES = sorted(set(Result.__members__) - {"Working", "Finished"})


class Answers:
    """A planner that answers one thing, whatever it is asked."""

    def __init__(self, answer):
        self.answer = answer

    def calculate(self, plan, trajectory):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


@pytest.mark.parametrize("name", [*FAILURES, "an exception"])
def test_whatever_error_the_planner_answers_the_limits_hold_and_it_is_counted(name):
    limits = load_robot("panda").limits
    guard = JointGuard(limits, 1e-3)
    guard.reset(load_robot("panda").home)
    guard._planner = Answers(RuckigError("no") if name == "an exception" else Result.__members__[name])
    states = [guard.advance(np.full(7, 100.0)) for _ in range(300)]
    assert guard.planner_failures > 0
    q, v, a = (np.array([getattr(state, part) for state in states]) for part in "qva")
    assert_within(limits, 1e-3, q, v, a)
    # It goes where it is told all the same, only not by the planner's way.
    assert np.all(v[50] > 0.0)
