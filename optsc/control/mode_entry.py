"""Entering a control mode: the activity that begins, and what else changes with it."""

from __future__ import annotations

from math import dist
from typing import NamedTuple

from optsc.control.activities import (
    Activity,
    Adjusting,
    Coupling,
    Following,
    Standing,
    Travelling,
)
from optsc.control.approach import Approach
from optsc.control.arbitration import Arbitration
from optsc.control.assisted import Assisted
from optsc.control.controller_state import ControllerState
from optsc.control.fine_tuning import FineTuning, Shift, Tuning, TuningScene, untouched
from optsc.control.holding import Holding
from optsc.control.jaws import GripStatus, JawSettings
from optsc.control.modes import TRANSITIONS, Event, Mode, next_mode
from optsc.control.placing import Lowering, PlaceSettings
from optsc.control.servo import Servo
from optsc.geometry import Pose, scalar
from optsc.geometry.scalar import Quaternion, Vector
from optsc.robot import RobotModel
from optsc.selection import Target

MOVED = (0.01, 0.1)
"""An object that was carried no further than this [m, rad] is where it was."""


class ModeSettings(NamedTuple):
    """What the activities of all modes are made with.

    Attributes:
        robot: the arm, with a gripper.
        arbitration: how hand and robot share the motion.
        approach: how the robot moves by itself.
        fine_tuning: how far a grasp may be shifted on the way to it, if at all.
        open: distance of the open jaws [m].
        jaws: what the measured opening means.
        place: how the robot puts down what it holds.
    """

    robot: RobotModel
    arbitration: Arbitration
    approach: Approach
    fine_tuning: FineTuning | None
    open: float
    jaws: JawSettings
    place: PlaceSettings


def after_event(settings: ModeSettings, state: ControllerState, servo: Servo, event: Event | None) -> ControllerState:
    """Return the state in the mode that follows on an event, if one does; some events begin the same mode again.

    Hold is not begun again: what its command is being led to does not change by another fault.
    """
    if event is None or (state.mode, event) not in TRANSITIONS:
        return state
    mode, before = next_mode(state.mode, event), state.mode
    if mode is before is Mode.HOLD:
        return state._replace(wish=None)
    stepped_in = mode is not Mode.HOLD and (state.stepped_in or state.mode.automatic)
    if event is Event.OPENED:
        state = _counted(state)
    elif event is Event.RELEASED or mode is Mode.RELEASE:
        state = released(settings, state, servo)
    elif event is Event.LOST and state.jaws.target is not None:
        state = state._replace(moved=state.moved | {state.jaws.target.object_name})
    if state.mode is Mode.RETREAT and event is Event.ARRIVED:
        # What was to be done is done: the robot may begin the next by itself.
        stepped_in = False
    state = state._replace(mode=mode, entered=servo.time, stepped_in=stepped_in, wish=None)
    if mode in (Mode.HOLD, Mode.MANUAL, Mode.PLACE):
        servo.forget()
        state = state._replace(target=None, tuning=None)
    elif mode is Mode.APPROACH:
        tuning = _begun_tuning(settings, state, servo.time)
        state = released(settings, state, servo)._replace(confirmed=False, tuning=tuning)
    elif mode is Mode.CLOSE:
        jaws = state.jaws.closing(state.target, servo.reference)
        state = state._replace(opening=0.0, jaws=jaws, counted=False)
    # Where the robot is at the object already, a tool that turns to the hand would turn around it.
    return state._replace(activity=activity_of(settings, state, servo, before in _AT_THE_OBJECT))


def activity_of(settings: ModeSettings, state: ControllerState, servo: Servo, keeps_offset: bool = False) -> Activity:
    """Return the activity that begins with the mode of ``state``; the servo prefers what suits it.

    In manual mode the hand fades in by the clutch's settings, or ``keeps_offset``, see `Coupling`.
    """
    mode, target, approach = state.mode, state.target, settings.approach
    if mode is Mode.HOLD:
        return Holding()
    if mode is Mode.MANUAL:
        servo.prefer(settings.robot.home)
        if settings.arbitration.assists:
            return Assisted.begin(settings.arbitration, approach, state.clutch, state.smoothing)
        return Following(Coupling(state.clutch, state.smoothing, keeps_offset=keeps_offset))
    if mode is Mode.APPROACH and target is not None:
        servo.prefer(target.q)
        shift = None if state.tuning is None else Shift(state.tuning.settings.speed)
        return Travelling.begin(approach, servo, *pose_of(target.X_WP), shift)
    if mode is Mode.ADJUST and settings.fine_tuning is not None:
        return Adjusting.begin(servo, Shift(settings.fine_tuning.speed))
    if mode is Mode.ADVANCE and target is not None:
        return Travelling.begin(approach, servo, *pose_of(target.X_WG))
    if mode is Mode.LIFT:
        (x, y, z), q = servo.reference
        return Travelling.begin(approach, servo, (x, y, z + approach.lift), q)
    if mode is Mode.PLACE:
        if state.jaws.target is not None:
            servo.prefer(state.jaws.target.q)
        return Lowering.begin(settings.place, approach, servo, state.jaws.at[0][2])
    if mode is Mode.RETREAT:
        p, q = servo.reference
        x, y, z = scalar.rotate(q, (0.0, 0.0, -settings.place.retreat))
        return Travelling.begin(approach, servo, (p[0] + x, p[1] + y, p[2] + z), q)
    return Standing(servo.reference)


def released(settings: ModeSettings, state: ControllerState, servo: Servo) -> ControllerState:
    """Return the state with jaws that open; what was between them is no longer where it was observed, if it moved."""
    jaws, moved = state.jaws, state.moved
    if jaws.target is not None and jaws.grip.may_drop and _apart(jaws.at, servo.reference):
        moved = moved | {jaws.target.object_name}
    if jaws.grip is not GripStatus.OPEN:
        jaws = jaws.opening()
    return state._replace(opening=settings.open, jaws=jaws, moved=moved)


def _counted(state: ControllerState) -> ControllerState:
    return state if state.counted else state._replace(tasks=state.tasks + 1, counted=True)


def _apart(a: tuple[Vector, Quaternion], b: tuple[Vector, Quaternion]) -> bool:
    (p, q), (other_p, other_q) = a, b
    turned = scalar.angle(scalar.multiply(q, scalar.conjugate(other_q)))
    return dist(p, other_p) > MOVED[0] or turned > MOVED[1]


_AT_THE_OBJECT = (
    *(Mode.ADVANCE, Mode.CLOSE, Mode.LIFT, Mode.CARRY),
    *(Mode.PLACE, Mode.RELEASE, Mode.RETREAT),
)


def touchable(mode: Mode, target: Target | None, intended: str | None, so_far: str | None) -> str | None:
    """Return the object that the hand may touch, of those that avoidance keeps the arm away from.

    While the robot is at a grasp, that is the object of the grasp; it stays so for an operator who steps in there,
    until the robot sets out again. Where the hand itself grasps, it is the ``intended`` object.
    """
    if mode in _AT_THE_OBJECT:
        return target.object_name if target is not None else so_far
    return (intended or so_far) if mode is Mode.MANUAL else None


def _begun_tuning(settings: ModeSettings, state: ControllerState, time: float) -> Tuning | None:
    """Return the tuning of the target from ``time`` [s] on; None where it may not be tuned."""
    target, choice = state.target, state.choice
    if settings.fine_tuning is None or choice.candidates is None or target is None:
        return None
    scene = TuningScene(settings.robot, settings.approach, choice.candidates, choice.clear)
    return Tuning(settings.fine_tuning, scene, untouched(target), time)


def pose_of(X: Pose) -> tuple[Vector, Quaternion]:
    """Return a pose as plain tuples."""
    return tuple(X.translation.tolist()), tuple(X.quaternion.tolist())
