"""Events of a tick: what the operator's input and the arm's state mean in the present mode, before anything moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optsc.control.activities import Adjusting, Travelling
from optsc.control.arbitration import Trigger
from optsc.control.controller_state import ControllerState
from optsc.control.fine_tuning import hand_nudge
from optsc.control.grasp_choice import GraspChoice
from optsc.control.mode_entry import ModeSettings, pose_of
from optsc.control.modes import Event, Mode
from optsc.control.operator_input import OperatorInput
from optsc.control.servo import Servo
from optsc.followers.protocol import FollowerState
from optsc.operators import Button
from optsc.operators.clutch import Hand

LARGEST_LAG = 0.3
"""Difference of measured and commanded joint position [rad] that means the arm does not follow."""
RETRY = 1.0
"""Time [s] after which a robot that begins by itself tries again, where it found no path."""
_TUNABLE = (Mode.APPROACH, Mode.ADJUST)


class Parts(NamedTuple):
    """What is asked to find out what happens.

    Attributes:
        modes: what the modes are made with.
        choice: chooses grasps.
        servo: follows the target.
        within: distance and angle to a grasp [m, rad] within which the trigger closes the jaws; None for anywhere.
    """

    modes: ModeSettings
    choice: GraspChoice
    servo: Servo
    within: tuple[float, float] | None


class Happening(NamedTuple):
    """The state after it is known what happens, the event, if any, and what is wrong or refused, in words."""

    state: ControllerState
    event: Event | None = None
    reason: str = ""


def happening(parts: Parts, state: ControllerState, given: OperatorInput, measured: FollowerState) -> Happening:
    """Return what happens at this tick before anything moves."""
    fault = _fault(parts.servo, state, measured)
    if fault:
        return Happening(state._replace(doubt=""), Event.FAULT, fault)
    event, reason = given.event, given.reason
    silent = not given.new and state.monitor.silent(parts.servo.time, parts.servo.settings.timeout)
    if event is None and silent and state.mode.automatic:
        # Nobody could step in.
        return Happening(state, Event.FAULT, "the operator's samples have stopped")
    if event is Event.FAULT:
        return Happening(state, event, reason)
    if state.mode is Mode.MANUAL:
        return _by_hand(parts, state, event, given)
    if state.mode.automatic and event is not Event.TRIGGERED and given.pressed:
        return _by_button(parts, state, event, given.pressed)
    return Happening(state, event, reason)


def lag(servo: Servo, measured: FollowerState) -> float:
    """Return how far the joint furthest from its command is from it [rad]."""
    return float(np.abs(servo.robot.difference(measured.q, servo.guard.q)).max())


def leading_hand(state: ControllerState) -> Hand | None:
    """Return the hand while it is coupled to the tool."""
    return state.monitor.hand if state.mode is Mode.MANUAL and state.monitor.clutch else None


def tuned(parts: Parts, state: ControllerState, given: OperatorInput) -> tuple[ControllerState, str]:
    """Return the state with the grasp shifted as the operator nudges it, and why it cannot be, in words."""
    tuning, target, monitor = state.tuning, state.target, state.monitor
    if tuning is None or state.mode not in _TUNABLE or target is None:
        return state, ""
    if given.nudge is not None:
        tuning = tuning.pushed(given.nudge)
    if Button.NUDGE in monitor.buttons and given.new and given.moved_from and monitor.hand:
        grasp = pose_of(target.X_WG)[1]
        tuning = tuning.pushed(hand_nudge(state.clutch, given.moved_from, monitor.hand, grasp))
    tuning, reason = tuning.settled(parts.servo.time)
    activity = state.activity
    if tuning.tuned.target is not target:
        target = tuning.tuned.target
        if isinstance(activity, (Travelling, Adjusting)):
            activity = activity.led(*pose_of(target.X_WP))
    return state._replace(tuning=tuning, target=target, activity=activity), reason


def _fault(servo: Servo, state: ControllerState, measured: FollowerState) -> str:
    n = servo.robot.n
    if (shape := getattr(measured.q, "shape", None)) != (n,):
        return f"the measured configuration has the shape {shape}, not ({n},)"
    behind = lag(servo, measured)
    if behind != behind:
        return "the measured configuration is not finite"
    # While holding it is known already, and must not keep the operator from leading the arm away.
    if behind > LARGEST_LAG and state.mode is not Mode.HOLD:
        return f"the arm is {behind:.2f} rad off its command"
    return state.doubt


def _by_hand(parts: Parts, state: ControllerState, event: Event | None, given: OperatorInput) -> Happening:
    if Button.VETO in given.pressed:
        choice, done = parts.choice.veto(state.choice, None)
        return Happening(state._replace(choice=choice), event, done)
    if event is Event.TRIGGERED and parts.modes.arbitration.trigger is Trigger.GRASPS:
        return _grasp_here(parts, state)
    begins = event is None and _begins_by_itself(parts, state)
    if begins:
        state = state._replace(tried=parts.servo.time)
    elif event is not Event.TRIGGERED:
        return Happening(state, event)
    choice, target, refusal = parts.choice.choose(state.choice, parts.servo, leading_hand(state), state.clutch)
    state = state._replace(choice=choice)
    if target is None:
        return Happening(state, None, refusal)
    return Happening(state._replace(target=target), Event.BEGUN if begins else event)


def _grasp_here(parts: Parts, state: ControllerState) -> Happening:
    if state.opening < parts.modes.open:
        return Happening(state._replace(opening=parts.modes.open), None, "the jaws open")
    target, refusal = parts.choice.near(state.choice, parts.servo, parts.within)
    if refusal:
        return Happening(state, None, refusal)
    return Happening(state._replace(target=target), Event.GRASPED)


def _begins_by_itself(parts: Parts, state: ControllerState) -> bool:
    time, ranking = parts.servo.time, state.choice.ranking
    if state.stepped_in or not state.monitor.clutch or time - state.tried < RETRY:
        return False
    intended_for = min(state.choice.intended_for(time), time - state.entered)
    return ranking is not None and ranking.best is not None and parts.modes.arbitration.begins(intended_for)


def _by_button(parts: Parts, state: ControllerState, event: Event | None, pressed: frozenset[Button]) -> Happening:
    if Button.CANCEL in pressed:
        return Happening(state, Event.CANCELLED)
    if state.mode not in _TUNABLE:
        return Happening(state, event)
    if Button.NEXT in pressed or Button.VETO in pressed:
        choice, done = state.choice, ""
        if Button.VETO in pressed:
            choice, done = parts.choice.veto(choice, state.target)
        choice, target, refusal = parts.choice.next(choice, parts.servo)
        state = state._replace(choice=choice)
        if target is not None:
            return Happening(state._replace(target=target), Event.RETARGETED, done)
        # What was refused must not be grasped; what was merely the best may.
        return Happening(state, Event.CANCELLED if done else event, "; ".join(filter(None, (done, refusal))))
    if Button.CONFIRM in pressed:
        state = state._replace(confirmed=True)
        return Happening(state, Event.CONFIRMED if state.mode is Mode.ADJUST else event)
    return Happening(state, event)
