"""One state: a snapshot restored goes on with the same bytes, and a tick is committed whole or not at all."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from optsc.collision import CollisionAvoidance
from optsc.control.arbitration import Arbitration
from optsc.control.fine_tuning import FineTuning
from optsc.control.modes import Event, Mode
from optsc.control.policies import POLICIES
from optsc.control.servo import Servo
from optsc.control.state import same
from optsc.control.status import Status
from optsc.errors import Mismatch
from optsc.geometry import Pose
from optsc.operators import Button, OperatorSample
from optsc.operators.smoothing import Smoothing
from optsc.robot import load_robot
from optsc.testing.loop import Loop, assert_limits_hold, scene

AHEAD = 60
"""Ticks that are gone twice."""
PLACE = {"thing": (0.45, 0.1, 0.25)}


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def decided(step):
    """Everything that a tick decided, as bytes and words."""
    c = step.command
    numbers = np.concatenate([c.q, c.v, c.a, c.error, [c.volume, c.slack, c.outside, step.opening, step.time]])
    target = None if step.target is None else step.target.candidate
    best = None if step.ranking is None else step.ranking.best
    return numbers.tobytes(), step.mode, step.event, c.status, step.reason, target, best, step.belief


class Recording(Loop):
    """A loop that keeps what it feeds to the controller, and a snapshot now and then."""

    def __init__(self, *args, every=97, **settings):
        self.inputs, self.snapshots, self.every = [], {}, every
        super().__init__(*args, **settings)

    def tick(self, sample=None):
        if len(self.inputs) % self.every == 0:
            self.snapshots[len(self.inputs)] = self.controller.snapshot()
        self.inputs.append((sample, self.measured))
        return super().tick(sample)

    def again(self, index):
        """What the controller decides from a snapshot on, with the same inputs."""
        self.controller.restore(self.snapshots[index])
        return [decided(self.controller.step(*one)) for one in self.inputs[index : index + AHEAD]]


def assert_goes_on_the_same(loop):
    first = [decided(step) for step in loop.steps]
    for index in sorted(loop.snapshots, reverse=True):
        assert loop.again(index) == first[index : index + AHEAD], f"from tick {index}"


@pytest.mark.parametrize("policy", sorted(POLICIES))
def test_a_snapshot_restored_anywhere_goes_on_with_the_same_bytes_under_every_policy(robot, policy):
    loop = Recording(robot, scene(), arbitration=POLICIES[policy]())
    loop.go(0.5, move=(0.08, 0.06, -0.05))
    loop.press()
    loop.go(0.7)
    loop.go(0.4, move=(0.0, -0.1, 0.02))
    loop.press()
    loop.go(1.0)
    assert_goes_on_the_same(loop)


def until(loop, mode, longest=8.0):
    end = loop.time + longest
    while loop.controller.mode is not mode:
        assert loop.time < end, f"{mode} was not reached"
        loop.go(0.02)


def test_a_snapshot_restored_in_any_mode_goes_on_with_the_same_bytes(robot):
    avoid = CollisionAvoidance(robot, table_height=0.0)
    loop = Recording(robot, scene(PLACE), fine_tuning=FineTuning(), avoid=avoid, smoothing=Smoothing())
    loop.tick()
    loop.go(0.3, move=(0.02, 0.0, 0.0))
    loop.press()
    loop.go(1.0, nudge=(1e-4, 0, 0, 0, 0, 1e-3))
    until(loop, Mode.ADJUST)
    loop.go(0.2)
    loop.go(0.02, buttons=frozenset({Button.CONFIRM}))
    until(loop, Mode.CARRY)
    loop.go(0.2)
    loop.press()
    loop.go(0.3, move=(0.0, 0.05, 0.05))
    loop.press()
    until(loop, Mode.RETREAT)
    until(loop, Mode.MANUAL)
    assert {step.mode for step in loop.steps} == set(Mode)
    assert_goes_on_the_same(loop)


def test_snapshots_are_equal_where_the_states_are(robot):
    loop = Recording(robot, scene())
    loop.go(0.3, move=(0.05, 0.0, 0.0))
    before, count = loop.controller.snapshot(), len(loop.inputs)
    assert before == loop.controller.snapshot()
    loop.go(0.1, move=(0.05, 0.0, 0.0))
    after = loop.controller.snapshot()
    assert before != after
    loop.controller.restore(before)
    for one in loop.inputs[count:]:
        loop.controller.step(*one)
    assert loop.controller.snapshot() == after


@pytest.mark.parametrize("policy", ["alternating", "hindsight optimisation"])
def test_a_step_reports_the_newest_ranking_and_belief(robot, policy):
    loop = Loop(robot, scene(), arbitration=POLICIES[policy]())
    for _ in range(40):
        step = loop.go(0.004, move=(0.001, 0.0, 0.0))
        assert step.ranking is loop.controller.ranking
        assert step.belief == loop.controller.state.choice.probabilities


class FailsError(Exception):
    """What a part of the user's raises."""


def test_a_servo_tick_that_fails_is_taken_back_and_becomes_a_stop_within_limits(robot):
    servo = Servo(robot)
    X = robot.forward(robot.home)
    commands = []
    for k in range(400):
        target = Pose(X.quaternion, X.translation + [2e-4 * k, 0.0, 0.0])
        if k % 37 == 30:
            solve, servo.ik.solve = servo.ik.solve, lambda *a: (_ for _ in ()).throw(FailsError("no answer"))
            command = servo.step(target, servo.time)
            servo.ik.solve = solve
            assert (command.status, command.reason) == (Status.UNSOLVED, "FailsError: no answer")
        else:
            command = servo.step(target, servo.time)
        commands.append(command)
    assert servo.state.ticks == len(commands)
    assert_limits_hold(robot, [SimpleNamespace(command=command) for command in commands])


@dataclass(frozen=True)
class Fails(Arbitration):
    """A policy that fails once the hand moves quickly."""

    name: ClassVar[str] = "fails"

    def blend(self, moment):
        if np.linalg.norm(moment.hand[:3]) > 0.05:
            raise FailsError("no blend")
        return super().blend(moment)


def test_a_tick_in_which_a_policy_raises_is_taken_back_as_a_whole_and_the_arm_comes_to_rest(robot, caplog):
    loop = Loop(robot, scene(), arbitration=Fails())
    loop.go(0.3, move=(0.005, 0.0, 0.0))
    ticks = loop.controller.servo.state.ticks
    loop.go(0.5, move=(0.2, 0.0, 0.0))
    failed = next(step for step in loop.steps if step.event is Event.FAULT)
    assert (failed.mode, failed.reason) == (Mode.HOLD, "FailsError: no blend")
    assert "a control tick failed" in caplog.text
    assert loop.controller.mode is Mode.HOLD
    assert np.abs(loop.steps[-1].command.v).max() == 0.0
    assert loop.controller.servo.state.ticks > ticks
    assert_limits_hold(robot, loop.steps)


def test_the_operator_leads_on_after_a_failed_tick(robot):
    loop = Loop(robot, scene(), arbitration=Fails())
    loop.go(0.4, move=(0.1, 0.0, 0.0))
    assert loop.controller.mode is Mode.HOLD
    loop.go(0.3, clutch=False)
    start = loop.tool().translation
    loop.go(1.0, move=(0.02, 0.0, 0.0))
    assert loop.controller.mode is Mode.MANUAL
    assert np.linalg.norm(loop.tool().translation - start) > 0.01


def test_interrupting_a_tick_leaves_the_state_before_it(robot):
    loop = Loop(robot, scene())
    loop.go(0.3, move=(0.02, 0.0, 0.0))
    controller = loop.controller
    before = controller.snapshot()

    def interrupted(*args):
        raise KeyboardInterrupt

    controller.servo.guard.advance = interrupted
    with pytest.raises(KeyboardInterrupt):
        loop.tick(OperatorSample(loop.time, loop.hand))
    assert controller.snapshot() == before


def test_a_snapshot_of_another_rate_or_arm_is_refused_and_changes_nothing(robot):
    servo = Servo(robot, rate=500.0)
    before = servo.snapshot()
    for other in (Servo(robot, rate=250.0), Servo(load_robot("ur5"), rate=500.0)):
        with pytest.raises(Mismatch, match="snapshot"):
            servo.restore(other.snapshot())
    assert servo.snapshot() == before


def test_what_is_the_same_and_what_is_not():
    nan = float("nan")
    assert same((1.0, nan, "a", np.array([1.0, nan])), (1.0, nan, "a", np.array([1.0, nan])))
    assert not same(np.array([0.0]), np.array([-0.0]))
    assert not same((1,), (1.0,))
    assert not same({"a": 1}, {"b": 1})
    assert same({"a": [1, 2]}, {"a": [1, 2]})
