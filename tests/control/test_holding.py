"""Hold: the command goes to where the arm is, within every limit, and motion begins from there."""

import numpy as np
import pytest

import optsc
from optsc.control.measured_arm import TrackingTolerance
from optsc.control.modes import Event, Mode
from optsc.control.status import Status
from optsc.followers import FollowerState
from optsc.geometry import Pose
from optsc.operators import OperatorSample
from optsc.robot import load_robot


def endless_arm():
    """A Panda whose odd joints turn endlessly."""
    limits = load_robot("panda").limits
    odd = np.arange(7) % 2 == 0
    lower, upper = np.where(odd, -np.inf, limits.lower), np.where(odd, np.inf, limits.upper)
    return load_robot("panda", limits={"lower": lower, "upper": upper})


@pytest.fixture(scope="module", params=["panda", "endless", "ur5"])
def robot(request):
    return endless_arm() if request.param == "endless" else load_robot(request.param)


class Loop:
    """A controller, and an arm of the test's: ``arm(q, command)`` says where it is after a tick."""

    def __init__(self, robot, rate, start, arm, hold=None, **options):
        self.robot, self.rate, self.arm = robot, rate, arm
        self.controller = optsc.SharedController(robot, optsc.GraspSelector(robot), **options)
        self.controller.reset(robot.home if hold is None else hold, rate)
        self.q = np.array(start, dtype=float)
        self.commands, self.steps = [self.controller.servo.guard.q.copy()], []

    def tick(self, clutch=True, hand=None, reading=None):
        time = self.controller.time
        X = Pose.identity() if hand is None else hand
        measured = FollowerState(time, self.q if reading is None else reading, np.zeros(self.robot.n), 0.08)
        step = self.controller.step(OperatorSample(time, X, clutch), measured)
        self.q = self.arm(self.q, step.command.q)
        self.commands.append(step.command.q.copy())
        self.steps.append(step)
        return step

    def go(self, seconds, **options):
        for _ in range(round(seconds * self.rate)):
            self.tick(**options)
        return self.steps[-1]

    def until(self, mode, seconds, **options):
        """Return the first step in a mode; None if there is none within ``seconds``."""
        for _ in range(round(seconds * self.rate)):
            step = self.tick(**options)
            if step.mode is mode:
                return step
        return None


def stuck(q, command):
    """An arm whose brakes are closed."""
    return q


def assert_limits(loop, share=1.0):
    limits, T = loop.robot.limits, 1.0 / loop.rate
    q = np.array(loop.commands)
    v = 2.0 * np.diff(q, axis=0) / T
    speeds = np.array([step.command.v for step in loop.steps])
    np.testing.assert_allclose(v, speeds + np.vstack([np.zeros(loop.robot.n), speeds[:-1]]), atol=1e-6)
    assert (np.abs(np.diff(q, axis=0)) <= limits.velocity * T * (1 + 1e-9) * share).all()
    a = np.diff(np.vstack([np.zeros(loop.robot.n), speeds]), axis=0) / T
    assert (np.abs(a) <= limits.acceleration * (1 + 1e-9)).all()
    jerk = np.diff(np.vstack([np.zeros(loop.robot.n), a]), axis=0) / T
    assert (np.abs(jerk) <= limits.jerk * (1 + 1e-9) + 1e-6).all()


def away(robot, rng, size):
    """A configuration inside the limits whose furthest joint is ``size`` [rad] from home."""
    direction = rng.uniform(-1.0, 1.0, robot.n)
    direction[rng.integers(robot.n)] = rng.choice([-1.0, 1.0])
    q = robot.limits.clip(robot.home + size * direction)
    return q


@pytest.mark.parametrize("rate", [100.0, 500.0, 1000.0])
@pytest.mark.parametrize("size", [0.05, 0.15, 0.29, 1.2])
def test_motion_begins_where_the_arm_is_measured_and_the_command_never_jumps(robot, rate, size):
    rng = np.random.default_rng([round(rate), round(100 * size)])
    start = away(robot, rng, size)
    loop = Loop(robot, rate, start, stuck)
    first = loop.until(Mode.MANUAL, 8.0)
    assert first is not None, loop.steps[-1].reason
    assert np.abs(loop.commands[-1] - start).max() < 1e-3
    told = [step.reason for step in loop.steps if step.mode is Mode.HOLD]
    assert any("rad from its command; the command is being led to it" in reason for reason in told)
    assert any(step.command.status is Status.LED for step in loop.steps)
    assert_limits(loop)


def test_a_command_is_led_to_an_arm_that_was_moved_in_hold_and_not_back(robot):
    rng = np.random.default_rng(3)
    loop = Loop(robot, 500.0, robot.home, lambda q, command: command)
    loop.go(0.3, clutch=False)
    moved, speed = away(robot, rng, 0.4), 0.25 * robot.limits.velocity / 500.0
    loop.arm = lambda q, command: q + np.clip(moved - q, -speed, speed)
    loop.go(4.0, clutch=False)
    assert np.abs(loop.commands[-1] - moved).max() < 1e-3
    assert loop.steps[-1].command.status is Status.HOLDING
    loop.arm = lambda q, command: command
    first = loop.until(Mode.MANUAL, 0.3)
    assert first is not None
    assert np.abs(loop.commands[-1] - moved).max() < 1e-3
    assert_limits(loop)


def test_one_engagement_is_enough_as_long_as_the_clutch_stays_closed(robot):
    start = away(robot, np.random.default_rng(4), 0.2)
    loop = Loop(robot, 250.0, start, stuck)
    assert loop.until(Mode.MANUAL, 5.0).event is Event.ENGAGED
    loop = Loop(robot, 250.0, start, stuck)
    loop.go(0.1)
    loop.go(5.0, clutch=False)
    assert all(step.mode is Mode.HOLD for step in loop.steps)


def test_an_arm_that_sags_less_than_the_tolerance_is_left_alone(robot):
    sag = np.linspace(-0.015, 0.015, robot.n)
    loop = Loop(robot, 500.0, robot.home + sag, lambda q, command: command + sag)
    loop.go(1.0, clutch=False)
    assert np.ptp(loop.commands, axis=0).max() == 0.0
    assert loop.until(Mode.MANUAL, 0.1) is not None


def test_an_arm_that_sags_more_is_not_followed_for_ever(robot):
    sag = np.full(robot.n, 0.05)
    loop = Loop(robot, 500.0, robot.home + sag, lambda q, command: q + 0.05 * (command + sag - q))
    last = loop.go(6.0)
    assert last.mode is Mode.HOLD
    assert "wherever that is led" in last.reason
    assert np.abs(loop.commands[-1] - robot.home).max() < 0.11
    assert np.ptp(loop.commands[-1000:], axis=0).max() < 1e-9
    # A tolerance of the user's own for such an arm.
    loop = Loop(robot, 500.0, robot.home + sag, lambda q, c: c + sag, tracking=TrackingTolerance(resume=0.08))
    assert loop.until(Mode.MANUAL, 0.3) is not None


@pytest.mark.parametrize("bias", [0.4, 1.0])
@pytest.mark.parametrize("drifts", [False, True])
def test_readings_that_are_off_do_not_lead_the_arm_away(robot, bias, drifts):
    rng = np.random.default_rng([drifts, round(10 * bias)])
    direction = rng.uniform(-1.0, 1.0, robot.n)
    direction *= bias / np.abs(direction).max()
    loop = Loop(robot, 250.0, robot.home, lambda q, command: command)
    loop.go(0.4)
    for k in range(750):
        share = min(1.0, k / 500) if drifts else 1.0
        loop.tick(clutch=k < 5, reading=loop.q + share * direction)
    assert loop.steps[-1].mode is Mode.HOLD
    assert np.ptp(loop.commands[-50:], axis=0).max() < 1e-9
    begun = next(k for k, step in enumerate(loop.steps) if step.event is Event.FAULT)
    assert np.abs(np.array(loop.commands[begun:]) - loop.commands[begun]).max() < 0.1
    assert_limits(loop)


def test_an_arm_that_comes_to_its_command_is_let_come(robot):
    loop = Loop(robot, 500.0, robot.home + 0.2, lambda q, command: q + 0.02 * (command - q))
    loop.go(2.0, clutch=False)
    assert np.abs(loop.commands[-1] - robot.home).max() < 0.02


def test_an_arm_led_by_hand_is_followed_until_it_is_let_go_anywhere(robot):
    rng = np.random.default_rng(5)
    loop = Loop(robot, 250.0, robot.home, stuck)
    for _ in range(3):
        goal, speed = away(robot, rng, rng.uniform(0.1, 0.5)), rng.uniform(0.05, 0.5) / 250.0
        loop.arm = lambda q, command, g=goal, s=speed: q + np.clip(g - q, -s, s)
        loop.go(rng.uniform(0.3, 2.0), clutch=False)
        loop.arm = stuck
        assert loop.until(Mode.MANUAL, 6.0) is not None, loop.steps[-1].reason
        assert np.abs(loop.commands[-1] - loop.q).max() < 0.02
        loop.arm = lambda q, command: q + 1.0  # thrown out of manual mode
        loop.go(0.3)
        loop.q, loop.arm = robot.home.copy(), stuck
        loop.go(0.3, clutch=False)
    assert_limits(loop)


@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_single_glitches_neither_stop_the_arm_nor_move_a_command(robot, rate):
    rng = np.random.default_rng(6)
    glitches = [
        None,
        "no",
        [],
        np.zeros(robot.n - 1),
        np.zeros((1, robot.n)),
        np.full(robot.n, np.nan),
        np.full(robot.n, np.inf),
        np.full(robot.n, 99.0),
        np.full(robot.n, 1e308),
        robot.home + 0.3,
        {"q": 1.0},
    ]
    clean, glitched = (Loop(robot, rate, robot.home, lambda q, command: command) for _ in range(2))
    count = 0
    for k in range(round(1.5 * rate)):
        hand = Pose.from_quaternion([1.0, 0.0, 0.0, 0.0], [0.05 * min(1.0, k / rate), 0.0, 0.0])
        clean.tick(hand=hand)
        bad = k % 9 == 4
        reading = glitches[rng.integers(len(glitches))] if bad else None
        if bad and reading is None:
            reading = float("nan")
        glitched.tick(hand=hand, reading=reading)
        count += bad
    begun = [next(k for k, step in enumerate(loop.steps) if step.mode is Mode.MANUAL) for loop in (clean, glitched)]
    assert begun[1] - begun[0] <= 0.1 * rate
    assert all(step.mode is Mode.MANUAL for step in glitched.steps[begun[1] :])
    assert glitched.controller.state.arm.skipped == count
    assert_limits(glitched)


def test_a_lack_of_readings_stops_the_arm_and_says_what_was_wrong_with_them(robot):
    loop = Loop(robot, 500.0, robot.home, lambda q, command: command)
    loop.go(0.5)
    assert loop.controller.mode is Mode.MANUAL
    before = len(loop.steps)
    step = loop.until(Mode.HOLD, 0.2, reading=np.full(robot.n, np.nan))
    assert 0.09 * 500.0 <= len(loop.steps) - before <= 0.11 * 500.0
    step = next(step for step in loop.steps if step.event is Event.FAULT)
    assert "no usable reading of the arm for 0.10 s" in step.reason
    assert "not finite" in step.reason
    assert "no usable reading" in loop.go(0.5, reading="gone").reason
    loop.go(0.1, clutch=False)
    assert loop.until(Mode.MANUAL, 0.5) is not None


def test_the_fault_of_an_arm_that_does_not_follow_needs_readings_that_agree(robot):
    loop = Loop(robot, 500.0, robot.home, lambda q, command: command)
    loop.go(0.5)
    for k in range(200):
        loop.tick(reading=loop.q + 0.5 if k % 3 else None)
    assert loop.controller.mode is Mode.MANUAL or "consistent" in loop.steps[-1].reason
    loop = Loop(robot, 500.0, robot.home, lambda q, command: command)
    loop.go(0.5)
    loop.q, loop.arm = robot.limits.clip(loop.q + 0.5), stuck
    step = loop.until(Mode.HOLD, 0.1)
    assert step is not None or loop.steps[-1].mode is Mode.HOLD
    assert any("off its command" in step.reason for step in loop.steps)
    assert_limits(loop)


@pytest.mark.parametrize("turns", [-3, 1, 7])
def test_whole_turns_of_an_endless_joint_are_no_distance(turns):
    robot = endless_arm()
    endless = np.isinf(robot.limits.lower)
    assert endless.any()
    shift = 2.0 * np.pi * turns * endless
    turned = Loop(robot, 500.0, robot.home + shift, lambda q, command: command + shift)
    plain = Loop(robot, 500.0, robot.home, lambda q, command: command)
    for loop in (turned, plain):
        loop.go(0.6)
        assert loop.controller.mode is Mode.MANUAL
    np.testing.assert_array_equal(turned.commands, plain.commands)


def test_an_arm_beyond_a_position_limit_is_led_only_to_the_limit(robot):
    bounded = np.flatnonzero(robot.limits.bounded)
    start = robot.home.copy()
    start[bounded[0]] = robot.limits.upper[bounded[0]] + 0.1
    loop = Loop(robot, 500.0, start, stuck)
    assert loop.until(Mode.MANUAL, 15.0) is not None, loop.steps[-1].reason
    assert loop.commands[-1][bounded[0]] == pytest.approx(robot.limits.upper[bounded[0]], abs=2e-3)
    assert (np.array(loop.commands) <= robot.limits.upper + 1e-9).all()
    assert_limits(loop)


def test_a_noisy_arm_at_rest_is_believed(robot):
    rng = np.random.default_rng(8)
    loop = Loop(robot, 500.0, robot.home, lambda q, command: command + rng.uniform(-1e-3, 1e-3, robot.n))
    assert loop.until(Mode.MANUAL, 0.5) is not None
    loop.go(1.0)
    assert loop.controller.mode is Mode.MANUAL


def test_tolerances_that_contradict_each_other_are_refused():
    with pytest.raises(optsc.errors.InvalidValue, match="resume"):
        TrackingTolerance(fault=0.1, resume=0.1)
