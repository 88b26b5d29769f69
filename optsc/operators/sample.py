"""Operator interface: one reading of the hand, what the operator sees, and the check of incoming samples."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from math import isfinite
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np

from optsc.geometry import Pose
from optsc.operators.clock import number

DEVICE_UNIT_TOLERANCE = 1e-3
"""How far the norm of a device's quaternion may be from one [-].

Wide enough for single precision and for the three or four decimals of a text file, narrow enough to catch a
quaternion that was never filled in, was averaged component by component, or is no quaternion at all.
"""

POSITION_RANGE = 1e3
"""How far from the station's origin a hand can be [m]: beyond it a number is a fault, not a place."""


HALTED = "hold"
"""The control mode in which the arm stands still."""
LARGEST_NUDGE = 1.0
"""The largest component of a nudge [m, rad] in one sample: beyond it a number is a fault, not a nudge."""


Nudge = tuple[float, float, float, float, float, float]
"""A small displacement: x, y, z [m] and a rotation vector [rad]."""


class Button(Enum):
    """What an operator can ask for besides clutch and trigger; all but `NUDGE` count when they are pressed."""

    CONFIRM = "go on from the pre-grasp"
    CANCEL = "leave the motion to the hand again"
    NEXT = "take the next best grasp instead"
    VETO = "never take this grasp"
    RELEASE = "open the jaws here"
    PLACE = "lower what the jaws hold until it stands, then open them"
    NUDGE = "while it is held, the hand shifts the grasp that the robot goes to"


class OperatorSample(NamedTuple):
    """One reading of the operator's hand.

    Attributes:
        stamp: when the hand was there [s], on the clock of `OperatorView.time` or on the device's own, which is learnt.
        X_SH: hand H in the operator's station frame S.
        clutch: True while the hand is coupled to the arm.
        trigger: in manual mode its rising edge hands over to the robot, or closes the jaws where the arbitration is
            such, or has the robot put down what they hold; while the robot moves by itself it takes over again.
        buttons: what is held down.
        nudge: how far the grasp that the robot goes to is to be shifted since the last sample, in the gripper's own
            frame: x, y, z [m] and a rotation vector [rad]; None for not at all. For devices with buttons or a stick.
        lost: the device says that it is gone or no longer tracks the hand; all else then means nothing.
    """

    stamp: float
    X_SH: Pose
    clutch: bool = True
    trigger: bool = False
    buttons: frozenset[Button] = frozenset()
    nudge: Nudge | None = None
    lost: bool = False


class OperatorView(NamedTuple):
    """What the operator sees at one instant.

    Attributes:
        time: now [s].
        X_WT: the arm's tool in the world.
        automatic: whether the arm is approaching by itself.
        finished: whether the task is done.
        objects: pose of each object in the world.
        grasps: the grasp that is shown for each object, tool poses in the world; {} where none is.
        target: the object that the robot is grasping by itself; None where it does not, or it is unknown.
        mode: the control mode, as `optsc.control.modes.Mode` calls it; empty before the first tick.
        status: what held the last command back, as `optsc.control.status.Status` calls it.
        reason: why the arm has stopped or does not do what was asked for, in words; empty when all is well.
        held: the object between the jaws; empty where something is that has no name, None where nothing is.
    """

    time: float
    X_WT: Pose
    automatic: bool
    finished: bool
    objects: Mapping[str, Pose]
    grasps: Mapping[str, Pose] = MappingProxyType({})
    target: str | None = None
    mode: str = ""
    status: str = ""
    reason: str = ""
    held: str | None = None

    @property
    def halted(self) -> bool:
        """Whether the arm stands still whatever the hand does, until the clutch is closed once more."""
        return self.mode == HALTED


class Operator(Protocol):
    """Anything that moves a hand: a device, a recording, a simulated person."""

    def read(self, view: OperatorView) -> OperatorSample | None:
        """Return the newest sample; None when there is none since the last call."""
        ...


def fault_of(sample: object, previous_stamp: float | None = None) -> str | None:
    """Return what is wrong with ``sample``, in words, or None when it can be used.

    Refused are: what is no sample, or has a field of another type than it should be; a stamp that is not finite or
    earlier than ``previous_stamp`` (None where that is of no interest), a position that is not finite or beyond
    `POSITION_RANGE`, an orientation that is not finite or not of unit norm within `DEVICE_UNIT_TOLERANCE`, a batch of
    poses, and a nudge that is not six numbers up to `LARGEST_NUDGE`. An equal stamp is no fault: it is a tracker that
    stands still. Of a sample that says it is lost only that counts.

    Called at every control tick: it never raises, and costs about a microsecond, which is why it compares plain floats
    instead of arrays.
    """
    if not isinstance(sample, OperatorSample):
        return f"it is of type {type(sample).__name__}, not an operator sample"
    stamp, X_SH, clutch, trigger, buttons, nudge, lost = sample
    for name, value in (("clutch", clutch), ("trigger", trigger), ("lost", lost)):
        if value is not True and value is not False and not isinstance(value, (int, np.bool_)):
            return f"{name} is of type {type(value).__name__}, not a bool"
    if lost:
        return None
    time = stamp if type(stamp) is float else number(stamp)
    if not isfinite(time):
        return f"stamp is {stamp if isinstance(stamp, float) else type(stamp).__name__}, not a time"
    if previous_stamp is not None and time < previous_stamp:
        return f"stamp {time:.6f} s is earlier than the one before, {previous_stamp:.6f} s"
    if not isinstance(X_SH, Pose):
        return f"hand pose is of type {type(X_SH).__name__}, not a pose"
    return _pose_fault(X_SH) or _buttons_fault(buttons) or (None if nudge is None else _nudge_fault(nudge))


def _pose_fault(X_SH: Pose) -> str | None:
    if X_SH.translation.shape != (3,) or X_SH.quaternion.shape != (4,):
        shapes = f"{X_SH.quaternion.shape} and {X_SH.translation.shape}"
        return f"hand pose has the shapes {shapes}, as a batch has, and is not one pose"
    x, y, z = X_SH.translation.tolist()
    # Squares in plain floats overflow to infinity and carry NaN, so one comparison catches all three.
    if not x * x + y * y + z * z <= POSITION_RANGE * POSITION_RANGE:
        return f"hand position is ({x:.6g}, {y:.6g}, {z:.6g}) m, not finite or beyond {POSITION_RANGE:g} m"
    w, i, j, k = X_SH.quaternion.tolist()
    square = w * w + i * i + j * j + k * k
    if not (1.0 - DEVICE_UNIT_TOLERANCE) ** 2 <= square <= (1.0 + DEVICE_UNIT_TOLERANCE) ** 2:
        return f"hand orientation is ({w:.6g}, {i:.6g}, {j:.6g}, {k:.6g}), not a unit quaternion"
    return None


def _buttons_fault(buttons: object) -> str | None:
    # What is in it and no button is a button that nobody here knows, and no fault.
    if isinstance(buttons, (frozenset, set, list, tuple)):
        return None
    return f"buttons are of type {type(buttons).__name__}, not a set"


def _nudge_fault(nudge: object) -> str | None:
    parts = nudge.tolist() if isinstance(nudge, np.ndarray) else nudge
    if not isinstance(parts, (tuple, list)):
        return f"nudge is of type {type(nudge).__name__}, not six numbers"
    numbers = tuple(number(part) for part in parts)
    # Written so that what is not a number fails too.
    if len(numbers) == 6 and all(abs(part) <= LARGEST_NUDGE for part in numbers):
        return None
    return f"nudge is {numbers}, not six numbers up to {LARGEST_NUDGE:g} [m, rad]"
