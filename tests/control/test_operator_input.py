"""Samples of the operator: what cannot be used is skipped and counted; only silence or a lost hand stops the arm."""

from collections import UserDict
from types import SimpleNamespace

import numpy as np
import pytest

from optsc.control.modes import Event, Mode
from optsc.control.operator_input import InputMonitor, OperatorInput
from optsc.control.policies import POLICIES, make_policy
from optsc.control.status import Status
from optsc.geometry import Pose
from optsc.operators import Button, OperatorSample
from optsc.operators.sample import fault_of
from optsc.robot import load_robot
from optsc.testing.loop import PERIOD, Loop, assert_limits_hold, scene

GOOD = OperatorSample(1.0, Pose.identity())
NONE_OF_THEM = {
    "a matrix": np.eye(4),
    "a word": "here",
    "a vector": [0.0, 0.0, 0.0],
    "a dictionary": UserDict(stamp=1.0),
    "nothing in it": OperatorSample(None, None, None, None, None, None, None),
    "a batch": GOOD._replace(X_SH=Pose.identity((2,))),
    "a look-alike pose": GOOD._replace(X_SH=SimpleNamespace(translation=np.zeros(3), quaternion=np.eye(4)[0])),
    "a pose of wrong lengths": GOOD._replace(X_SH=Pose(np.zeros(3), np.zeros(4))),
    "a matrix as pose": GOOD._replace(X_SH=np.eye(4)),
    "no clutch": GOOD._replace(clutch=None),
    "two clutches": GOOD._replace(clutch=np.array([True, False])),
    "a word as trigger": GOOD._replace(trigger="pressed"),
    "no buttons": GOOD._replace(buttons=None),
    "a word as stamp": GOOD._replace(stamp="1.0"),
    "no stamp": GOOD._replace(stamp=None),
    "a short nudge": GOOD._replace(nudge=(0.0, 0.0, 0.0)),
    "a nudge of words": GOOD._replace(nudge=("x",) * 6),
    "a number as nudge": GOOD._replace(nudge=1.0),
    "NaN in the nudge": GOOD._replace(nudge=(np.nan,) * 6),
    "lost in words": GOOD._replace(lost="no"),
}


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


@pytest.mark.parametrize("sample", NONE_OF_THEM.values(), ids=NONE_OF_THEM)
def test_what_is_no_sample_is_refused_with_a_reason_and_nothing_is_raised(sample):
    monitor, _ = InputMonitor().read(GOOD, 1.0, None)
    after, given = monitor.read(sample, 1.1, None)
    assert not given.new
    assert given.event is None
    assert "refused" in given.reason
    assert after.counts.refused == 1
    assert after._replace(counts=monitor.counts) == monitor


@pytest.mark.parametrize(
    "odd",
    [
        GOOD._replace(clutch=np.bool_(True), trigger=0),
        GOOD._replace(stamp=np.float32(1.0)),
        GOOD._replace(stamp=1),
        GOOD._replace(buttons=[Button.NEXT, "fire"]),
        GOOD._replace(nudge=np.zeros(6)),
    ],
)
def test_what_is_odd_and_clear_is_used(odd):
    after, given = InputMonitor().read(odd, 1.0, None)
    assert given.new
    assert after.counts.refused == 0
    assert after.buttons <= set(Button)


def test_late_and_duplicate_samples_are_counted_and_change_nothing():
    monitor, _ = InputMonitor().read(GOOD, 1.0, None)
    late, given = monitor.read(GOOD._replace(stamp=0.99, clutch=False, trigger=True), 1.01, None)
    assert (late.counts.late, given.new, late.clutch, late.trigger) == (1, False, True, False)
    same, given = late.read(GOOD, 1.02, None)
    assert (same.counts.duplicate, given.new, same.arrived) == (1, False, 1.0)
    assert same.silence(1.2, 0.1) == "the operator's samples have stopped: 1 late, 1 duplicate"


def test_what_is_pressed_counts_where_the_hand_was_not_seen_again():
    monitor, _ = InputMonitor().read(GOOD, 1.0, None)
    again = GOOD._replace(trigger=True, buttons=frozenset({Button.NEXT}), nudge=(0.1,) * 6)
    pressed, given = monitor.read(again, 1.01, None)
    assert (given.event, given.new, given.pressed, given.nudge) == (Event.TRIGGERED, False, {Button.NEXT}, None)
    assert pressed.read(again, 1.02, None)[1] == OperatorInput()
    released, _ = pressed.read(GOOD._replace(clutch=False), 1.03, None)
    assert (released.clutch, released.hand, released.arrived) == (False, monitor.hand, 1.0)


def test_a_check_of_a_sample_alone_says_what_is_wrong_with_it():
    assert fault_of(GOOD) is None
    assert fault_of(GOOD._replace(stamp=np.nan, X_SH=None, lost=True)) is None
    assert "not an operator sample" in fault_of(3)


def in_mode(robot, policy, automatic):
    loop = Loop(robot, scene(), arbitration=make_policy(policy))
    loop.go(0.3)
    if automatic:
        loop.press()
    return loop


@pytest.mark.parametrize("offset", [0.0, 1.0, 1.7e9])
@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("automatic", [False, True])
def test_an_operator_who_falls_silent_stops_the_arm_within_the_time_out_whatever_the_stamps_say(
    robot, policy, automatic, offset
):
    loop = in_mode(robot, policy, automatic)
    mode = loop.controller.mode
    for k in range(100):
        hand = Pose(loop.hand.quaternion, loop.hand.translation + [0.0, 2e-4 * k, 0.0])
        loop.tick(OperatorSample(loop.time + offset, hand) if k % 5 == 0 else None)
    silent = [loop.tick() for _ in range(350)]
    timeout = loop.controller.servo.settings.timeout
    if mode.automatic:
        held = next(k for k, step in enumerate(silent) if step.mode is Mode.HOLD)
        assert (held + 5) * PERIOD <= timeout + 2 * PERIOD
        assert "samples have stopped" in silent[-1].reason
    assert not silent[-1].command.v.any()
    assert all(step.command.status is not Status.FOLLOWING for step in silent[60:])
    assert_limits_hold(robot, loop.steps)


@pytest.mark.parametrize("automatic", [False, True])
def test_a_frozen_tracker_is_no_sign_of_life(robot, automatic):
    loop = in_mode(robot, "alternating", automatic)
    frozen = OperatorSample(loop.time, loop.hand)
    steps = [loop.tick(frozen) for _ in range(300)]
    assert not steps[-1].command.v.any()
    assert "duplicate" in steps[-1].reason
    assert loop.controller.mode is (Mode.HOLD if automatic else Mode.MANUAL)


def test_samples_that_never_were_usable_do_not_leave_hold_and_are_told(robot):
    loop = Loop(robot, scene())
    steps = [loop.tick(np.eye(4)) for _ in range(20)]
    assert loop.controller.mode is Mode.HOLD
    assert "not an operator sample" in steps[-1].reason
    assert loop.controller.state.monitor.counts.refused == 20


@pytest.mark.parametrize("offset", [1.0, -20.0, 1.7e9])
@pytest.mark.parametrize("policy", ["alternating", "linear blending"])
def test_a_foreign_clock_leads_the_tool_where_the_loops_own_does(robot, policy, offset):
    ends = []
    for shift in (0.0, offset):
        loop = Loop(robot, scene({"far": (3.0, 0.0, 0.2)}), arbitration=make_policy(policy))
        for k in range(500):
            hand = Pose(loop.hand.quaternion, loop.hand.translation + [0.0, 0.05 * np.sin(0.01 * k), 0.0])
            loop.tick(OperatorSample(loop.time + shift, hand) if k % 5 == 0 else None)
        ends.append(loop.tool().translation)
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-5)


def test_one_late_packet_or_a_stamp_a_rounding_error_older_ends_no_approach(robot):
    for older in (1e-12, 0.01, 0.06):
        loop = in_mode(robot, "alternating", True)
        mode = loop.controller.mode
        stamp = loop.time
        loop.tick(OperatorSample(stamp, loop.hand))
        step = loop.tick(OperatorSample(stamp - older, loop.hand))
        assert loop.controller.mode is mode
        assert step.event is not Event.FAULT
        assert loop.controller.state.monitor.counts.late == 1
