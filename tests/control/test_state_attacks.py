"""Attacks on the state: solvers that remember, parts that raise, and input of wrong types."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

import optsc.control.mode_entry as mode_entry
from optsc.collision import CollisionAvoidance
from optsc.control import activities
from optsc.control.arbitration import HAND_ALONE, Arbitration, Blend
from optsc.control.modes import Mode
from optsc.control.policies import LinearBlending
from optsc.control.servo import Servo
from optsc.control.status import Status
from optsc.followers import FollowerState
from optsc.geometry import Pose, TriangleMesh
from optsc.ik import solver_names
from optsc.ik.solvers import QpSolution, Rows
from optsc.operators import Button, OperatorSample
from optsc.operators.smoothing import Smoothing
from optsc.robot import JointLimits, load_robot
from optsc.selection import PositionDistance, WeightedSum
from optsc.selection.filters import GraspFilter
from optsc.selection.hysteresis import Hysteresis
from optsc.study.faults.catalogue import FAULTS
from optsc.study.faults.check import problems
from optsc.study.faults.reading_faults import NO_READINGS
from optsc.study.faults.run import run
from optsc.study.faults.sample_faults import NO_SAMPLES, Raises
from optsc.study.faults.world import MODES, World
from optsc.testing.loop import PERIOD, Loop, assert_limits_hold, scene

SOLVERS = [name for name in ("daqp", "proxqp", "quadprog") if name in solver_names()]
CUBE = TriangleMesh(0.05 * np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]), [[0, 1, 3]])


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def bytes_of(commands):
    return [np.concatenate([c.q, c.v, c.a, c.error, [c.slack]]).tobytes() for c in commands]


def slower(limits, share):
    return JointLimits(limits.lower, limits.upper, share * limits.velocity, limits.acceleration, limits.jerk)


@pytest.mark.parametrize("solver", SOLVERS)
def test_with_any_solver_a_snapshot_goes_on_with_the_same_bytes_whatever_happened_since(robot, solver):
    X = robot.forward(robot.home)
    avoid = CollisionAvoidance(robot, {"cube": (CUBE, Pose.from_translation(X.translation + [0.2, 0, 0]))})
    servo = Servo(robot, solver=solver, avoid=avoid)

    def go(count):
        start = servo.state.ticks
        targets = [Pose(X.quaternion, X.translation + [4e-4 * k, 0.0, 0.0]) for k in range(start, start + count)]
        return [servo.step(target, servo.time) for target in targets]

    go(150)
    before = servo.snapshot()
    first = bytes_of(go(150))
    avoid.move("cube", Pose.from_translation([0.3, 0.4, 0.3]), np.full(6, 0.01))
    avoid.hand_may_touch("cube")
    servo.set_limits(slower(robot.limits, 0.5))
    servo.prefer(robot.home + 0.1)
    go(37)
    servo.restore(before)
    assert servo.snapshot() == before
    assert bytes_of(go(150)) == first


@pytest.mark.parametrize("name", SOLVERS)
def test_answers_of_a_solver_follow_from_the_problem_alone(robot, name):
    servo = Servo(robot, solver=name)
    rng = np.random.default_rng(0)
    problems = []
    for n in (7, 5, 7, 7, 5):
        A = rng.normal(size=(n, n))
        problems.append((A @ A.T + np.eye(n), 5.0 * rng.normal(size=n), -np.ones(n), np.ones(n)))
    solve = servo.ik.solver.solve
    first = [solve(*problem).x.tobytes() for problem in problems]
    assert [solve(*problem).x.tobytes() for problem in problems[::-1]][::-1] == first


def test_hysteresis_recentring_and_observing_again_are_part_of_the_state(robot):
    loop = Loop(robot, scene(), arbitration=LinearBlending())
    loop.controller.selector.hysteresis = Hysteresis()
    loop.go(0.3, move=(0.05, 0.03, 0.0))
    controller = loop.controller
    before, measured, hand, time = controller.snapshot(), loop.measured, loop.hand, loop.time

    def go():
        loop.measured, loop.hand, loop.steps = measured, hand, []
        loop.go(0.3, move=(0.03, 0.05, -0.02))
        return bytes_of([step.command for step in loop.steps]), [step.belief for step in loop.steps]

    first = go()
    loop.go(0.1)
    controller.recentre()
    controller.observe(scene(count=3))
    loop.go(0.1, buttons=frozenset({Button.VETO}))
    controller.restore(before)
    assert controller.time == time
    assert controller.snapshot() == before
    assert go() == first


class FailsError(Exception):
    """What a part of the user raises; it cannot even say why."""

    def __str__(self):
        raise RuntimeError


def fail(*args, **kwargs):
    raise FailsError


class RaisingFilter(GraspFilter):
    reason = "raises"
    armed = False

    def passes(self, situation):
        if self.armed:
            fail()
        return situation.grid.reachable


class RaisingCost(PositionDistance):
    def key(self, situation):
        if situation.position[1] > 0.04:
            fail()
        return super().key(situation)


class UsersSolver:
    """A QP solver that is asked at every tick; the one by default only where something holds its minimum."""

    name = "a user's"

    def __init__(self, solve):
        self.solve = solve


def raising(part, loop, monkeypatch):
    """Let one part raise from now on."""
    controller = loop.controller
    if part == "solver":
        monkeypatch.setattr(controller.servo.ik, "solver", UsersSolver(fail))
    elif part == "cost":
        controller.selector.rank_by(WeightedSum(((RaisingCost(), 1.0),)), controller.selector.solver.manipulability)
    elif part == "filter":
        controller.selector.filters[0].armed = True
    elif part == "policy":
        monkeypatch.setattr(LinearBlending, "blend", fail)
    elif part == "inverse kinematics":
        solver = replace(controller.selector.solver, solve=fail, refresh_angle=1e-9)
        monkeypatch.setattr(controller.selector, "solver", solver)
    elif part == "time law":
        monkeypatch.setattr(activities, "StraightPath", fail)
    elif part == "smoothing":
        monkeypatch.setattr(activities, "smoothed", fail)
    elif part == "mode entry":
        monkeypatch.setattr(mode_entry, "activity_of", fail)
    elif part == "path":
        monkeypatch.setattr("optsc.control.path_search.path_rollout", fail)


PARTS = (
    "solver",
    "cost",
    "filter",
    "policy",
    "inverse kinematics",
    "time law",
    "smoothing",
    "mode entry",
    "path",
)


@pytest.mark.parametrize("part", PARTS)
def test_whatever_raises_the_arm_comes_to_rest_within_limits_and_can_be_led_on(robot, part, monkeypatch):
    arbitration = LinearBlending() if part == "policy" else None
    loop = Loop(robot, scene(), smoothing=Smoothing(), arbitration=arbitration)
    loop.controller.selector.filters = (RaisingFilter(),)
    loop.controller.selector.forget()
    loop.go(0.3, move=(0.02, 0.02, 0.0))
    with monkeypatch.context() as patch:
        raising(part, loop, patch)
        ticks = loop.controller.servo.state.ticks
        loop.go(0.2, move=(0.02, 0.05, 0.0))
        loop.press()
        loop.go(0.3)
        assert any("FailsError" in step.reason for step in loop.steps)
        assert loop.controller.servo.state.ticks > ticks
        assert np.abs(loop.steps[-1].command.v).max() < 1e-12
    if part not in ("cost", "filter"):
        loop.go(0.1, clutch=False)
        loop.go(0.3, move=(0.01, 0.0, 0.0))
        assert loop.controller.mode is Mode.MANUAL
    assert_limits_hold(robot, loop.steps)


def test_a_scene_that_cannot_be_judged_changes_nothing(robot):
    loop = Loop(robot, scene())
    loop.go(0.3)
    loop.go(0.02, buttons=frozenset({Button.VETO}))
    assert loop.controller.selector.state.vetoed
    before = loop.controller.snapshot()
    with pytest.raises(FailsError):
        loop.controller.observe(scene(count=4), fail)
    assert loop.controller.snapshot() == before
    with pytest.raises(ValueError, match="shape"):
        loop.controller.reset(np.zeros(3))
    assert loop.controller.snapshot() == before


I4 = Pose.identity()
SAMPLES = (
    "a sample",
    np.eye(4),
    3.0,
    OperatorSample(0.0, np.eye(4)),
    OperatorSample(0.0, None),
    OperatorSample(None, I4),
    OperatorSample("now", I4),
    OperatorSample(0.0, SimpleNamespace(translation=np.zeros(3), quaternion=np.zeros(3))),
    OperatorSample(0.0, SimpleNamespace(translation=[0.0, 0.0, 0.0], quaternion=[1.0, 0.0, 0.0, 0.0])),
    OperatorSample(0.0, I4, clutch=np.array([True, False])),
    OperatorSample(0.0, I4, buttons=None),
    OperatorSample(0.0, I4, buttons={1, "confirm"}),
    OperatorSample(0.0, I4, nudge=3.0),
    OperatorSample(0.0, I4, nudge=("a",) * 6),
    OperatorSample(float("inf"), I4),
)


def measured_of(kind, measured):
    q, v, nan = measured.q, measured.v, float("nan")
    return {
        "none": None,
        "no values": FollowerState(None, None, None, None),
        "nan": FollowerState(nan, nan * q, nan * v, nan),
        "infinite": FollowerState(0.0, q + np.inf, v, 0.0),
        "long": FollowerState(0.0, np.zeros(8), v, 0.0),
        "one": FollowerState(0.0, np.zeros(1), v, 0.0),
        "matrix": FollowerState(0.0, q[None], v[None], 0.0),
        "words": FollowerState(0.0, "q", "v", "opening"),
        "far": FollowerState(0.0, q + 3.0, v, 0.0),
    }[kind]


@pytest.mark.parametrize("sample", SAMPLES, ids=range(len(SAMPLES)))
def test_a_sample_of_a_wrong_type_never_raises_and_stops_nothing_for_good(robot, sample):
    loop = Loop(robot, scene())
    loop.go(0.3, move=(0.03, 0.0, 0.0))
    if isinstance(sample, OperatorSample) and sample.stamp == 0.0:
        sample = sample._replace(stamp=loop.time)
    loop.tick(sample)
    loop.go(0.3, clutch=False)
    loop.go(0.3, move=(0.01, 0.0, 0.0))
    assert loop.controller.mode is Mode.MANUAL
    assert_limits_hold(robot, loop.steps)


@pytest.mark.parametrize("kind", ["none", "no values", "nan", "infinite", "long", "one", "matrix", "words", "far"])
def test_a_measured_state_that_is_none_never_raises_and_stops_the_arm(robot, kind, caplog):
    loop = Loop(robot, scene())
    loop.go(0.3, move=(0.03, 0.0, 0.0))
    good = loop.measured
    for _ in range(100):
        step = loop.controller.step(None, measured_of(kind, good))
        loop.steps.append(step)
    assert loop.controller.mode is Mode.HOLD
    assert len(caplog.records) <= 1
    assert_limits_hold(robot, loop.steps)
    loop.measured = FollowerState(0.0, step.command.q, step.command.v, 0.08)
    loop.go(0.1, clutch=False)
    loop.go(0.2)
    assert loop.controller.mode is Mode.MANUAL
    assert_limits_hold(robot, loop.steps)


@pytest.mark.parametrize("target", [np.eye(4), "home", 3, SimpleNamespace(translation=None), [0.0] * 3])
def test_a_target_of_a_wrong_type_is_refused(robot, target):
    servo = Servo(robot)
    command = servo.step(target)
    assert command.status is Status.INVALID
    assert servo.step(robot.forward(robot.home), "soon").status is Status.INVALID
    assert servo.state.ticks == 2


def test_interrupting_the_servo_leaves_the_state_before_it(robot, monkeypatch):
    servo = Servo(robot)
    servo.step(robot.forward(robot.home))
    before = servo.snapshot()

    def interrupted(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(servo.ik, "solve", interrupted)
    with pytest.raises(KeyboardInterrupt):
        servo.step(robot.forward(robot.home + 0.01))
    assert servo.snapshot() == before


def test_what_a_command_holds_is_the_callers_to_write_into(robot):
    servo = Servo(robot)
    for values in servo.step()[:3]:
        values[:] = 7.0
    command = servo.step()
    np.testing.assert_array_equal(command.q, robot.home)
    np.testing.assert_array_equal(command.v, 0.0)


@dataclass(frozen=True)
class OneArray(Arbitration):
    """A policy that answers with the same array at every tick."""

    answer: Blend = field(default_factory=lambda: Blend(np.eye(6), np.zeros(6), 0.0))
    name: ClassVar[str] = "one array"

    def blend(self, moment):
        self.answer.robot[0] += 1e-3
        return self.answer


def test_what_a_policy_does_with_its_answer_later_does_not_change_the_state(robot):
    loop = Loop(robot, scene(), arbitration=OneArray())
    loop.go(0.2)
    state = loop.controller.state.activity.last
    assert state is not HAND_ALONE
    kept = state.robot.copy()
    loop.go(PERIOD)
    np.testing.assert_array_equal(state.robot, kept)


def test_an_operator_may_use_one_set_of_buttons_again(robot):
    loop = Loop(robot, scene())
    buttons = set()
    loop.go(0.3, buttons=buttons)
    buttons.add(Button.VETO)
    loop.tick(OperatorSample(loop.time, loop.hand, buttons=buttons))
    assert loop.controller.selector.state.vetoed


WRONG_ANSWERS = {
    "no numbers": lambda n: np.full(n, np.nan),
    "infinity": lambda n: np.full(n, -np.inf),
    "too few": lambda n: np.zeros(n - 1),
    "a matrix": lambda n: np.zeros((n, n)),
    "a number": lambda n: 0.0,
    "complex numbers": lambda n: np.full(n, 1j),
    "nothing": lambda n: None,
}


@pytest.mark.parametrize("what", WRONG_ANSWERS)
def test_what_a_solver_calls_solved_and_is_no_velocity_stops_the_arm_and_is_said(robot, what, monkeypatch):
    servo = Servo(robot)
    X = robot.forward(robot.home)
    for k in range(100):
        servo.step(Pose(X.quaternion, X.translation + [3e-4 * k, 0.0, 0.0]))
    answer = QpSolution(WRONG_ANSWERS[what](robot.n), True, 1)
    monkeypatch.setattr(servo.ik, "solver", UsersSolver(lambda *_: answer))
    commands = [servo.step(X) for _ in range(100)]
    assert {command.status for command in commands} == {Status.UNSOLVED}
    assert all("usable" in command.reason for command in commands)
    np.testing.assert_allclose(commands[-1].v, 0.0, atol=1e-12)
    a = np.array([command.a for command in commands])
    assert np.all(np.abs(np.diff(a, axis=0)) <= robot.limits.jerk * servo.period * (1 + 1e-9))


def test_what_a_users_solver_and_avoidance_write_into_what_they_are_given_changes_nothing(robot, monkeypatch):
    def moves(servo):
        X = robot.forward(robot.home)
        targets = [Pose(X.quaternion, X.translation + [5e-4 * k, 0.0, 0.0]) for k in range(60)]
        return bytes_of([servo.step(target) for target in targets])

    def spoiled(part, name):
        genuine = getattr(part, name)

        def spoil(*arguments):
            answer = genuine(*arguments)
            for array in arguments:
                if isinstance(array, np.ndarray):
                    array[...] = 1e6
            return answer

        monkeypatch.setattr(part, name, spoil, raising=False)

    far = Pose.from_translation([9.0, 0.0, 0.0])
    servos = [Servo(robot, avoid=CollisionAvoidance(robot, {"cube": (CUBE, far)})) for _ in range(2)]
    for name in ("rows", "stopping", "blocking"):
        spoiled(servos[1].avoid, name)
    for servo in servos:
        servo.ik.solver = UsersSolver(servo.ik.solver.solve)
    spoiled(servos[1].ik.solver, "solve")
    assert moves(servos[0]) == moves(servos[1])


def test_what_a_policy_is_shown_of_its_last_answer_cannot_be_written_into(robot):
    loop = Loop(robot, scene(), arbitration=LinearBlending())
    loop.go(0.3, move=(0.03, 0.0, 0.0))
    last = loop.controller.state.activity.last
    for values in (last.hand, last.robot):
        with pytest.raises(ValueError, match="read-only"):
            values[...] = 1.0


@pytest.mark.parametrize("wrong", [np.full((1, 7), np.nan), np.full((1, 7), np.inf), np.zeros((1, 6)), np.zeros(7)])
def test_rows_of_avoidance_that_are_none_stop_the_arm_and_are_not_left_out(robot, wrong, monkeypatch):
    avoid = CollisionAvoidance(robot, {"cube": (CUBE, Pose.from_translation([9.0, 0.0, 0.0]))})
    servo = Servo(robot, avoid=avoid)
    X = robot.forward(robot.home)
    for k in range(100):
        servo.step(Pose(X.quaternion, X.translation + [3e-4 * k, 0.0, 0.0]))
    monkeypatch.setattr(avoid, "rows", lambda *_: Rows(wrong, np.array([-1.0]), np.array([1.0]), 10.0))
    commands = [servo.step(X) for _ in range(100)]
    assert {command.status for command in commands} == {Status.UNSOLVED}
    assert all("rows of avoidance" in command.reason for command in commands)
    np.testing.assert_allclose(commands[-1].v, 0.0, atol=1e-12)


@pytest.fixture(scope="module")
def world():
    return World("panda", 250.0)


@pytest.mark.parametrize("mode", [mode for mode in MODES if mode.automatic])
def test_without_a_solution_no_mode_in_which_the_robot_moves_by_itself_goes_on(world, mode):
    fault = FAULTS["the QP solver says that it is infeasible"]
    assert problems(world.robot, world.period, run(world, mode, fault, (0,))) == []


@pytest.mark.parametrize("name", ["avoidance raises (snapshot)", "avoidance raises (rows and restore)"])
def test_an_avoidance_that_cannot_be_taken_back_does_not_make_a_tick_raise(world, name):
    assert problems(world.robot, world.period, run(world, Mode.MANUAL, FAULTS[name], (0,))) == []


def test_no_sample_with_no_reading_at_no_time_makes_a_tick_raise(world):
    rng = np.random.default_rng(5)
    times = (None, "noon", np.nan, np.inf, 1e300, 10**400, 1j, np.zeros(2), True, Raises(), [1.0])
    samples, readings = tuple(NO_SAMPLES.values()), tuple(NO_READINGS.values())
    for mode in MODES:
        hand = world.restore(mode).hand
        for _ in range(60):
            sample = samples[rng.integers(len(samples))](OperatorSample(world.controller.time, hand))
            reading = readings[rng.integers(len(readings))](world.arm.measured())
            step = world.controller.step(sample, reading, times[rng.integers(len(times))])
            assert np.all(np.isfinite(step.command.q))
        assert step.mode is Mode.HOLD
        assert step.reason


@pytest.mark.parametrize("wrong", [np.full(7, 1e300), np.full(7, np.nan), np.full(7, 3.0), np.zeros(6), None])
def test_a_velocity_to_stop_with_that_is_none_stops_the_arm_by_its_limits_alone(robot, wrong, monkeypatch):
    avoid = CollisionAvoidance(robot, {"cube": (CUBE, Pose.from_translation([9.0, 0.0, 0.0]))})
    servo = Servo(robot, avoid=avoid)
    X = robot.forward(robot.home)
    for k in range(100):
        servo.step(Pose(X.quaternion, X.translation + [3e-4 * k, 0.0, 0.0]))
    monkeypatch.setattr(avoid, "stopping", lambda *_: wrong)
    commands = [servo.step() for _ in range(300)]
    assert commands[-1].status is Status.UNSOLVED
    assert commands[-1].reason
    np.testing.assert_allclose(commands[-1].v, 0.0, atol=1e-12)
    q = np.array([command.q for command in commands])
    assert np.abs(q[-1] - q[0]).max() < 0.1
