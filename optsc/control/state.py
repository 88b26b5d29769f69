"""State of the servo: its numbers in one block of memory with named views, and how two states are compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, NamedTuple

import numpy as np

from optsc.control.loop_time import LoopTime
from optsc.control.target_stream import TargetStream
from optsc.geometry.rotation import Array
from optsc.kernels.settling import WAITING
from optsc.operators.prediction import Track
from optsc.robot import JointLimits

REFERENCE = 19
"""Numbers of a reference: position, unit quaternion, twist (6) and its derivative (6), in W [m, rad, s]."""


class Numbers:
    """The numbers that a tick changes.

    Compiled functions read and write them in place, so the block keeps its address as long as it lives. A copy of
    ``block`` holds everything, and writing it back restores it.

    Attributes:
        block: all of them (4 n + 27,).
        joints: commanded position, velocity and acceleration (n, 3) [rad, rad/s, rad/s^2].
        reference: what the tool is led along (19,), see `REFERENCE`.
        preferred: configuration (n,) [rad] that spare motion goes to.
        waiting: (8,) how long there was little to gain and since which target, see `optsc.kernels.settling`.
    """

    __slots__ = ("block", "joints", "preferred", "reference", "waiting")

    def __init__(self, n: int) -> None:
        self.block = np.zeros(4 * n + REFERENCE + WAITING)
        self.joints = self.block[: 3 * n].reshape(n, 3, order="F")
        self.reference = self.block[3 * n : 3 * n + REFERENCE]
        self.preferred = self.block[3 * n + REFERENCE : -WAITING]
        self.waiting = self.block[-WAITING:]


class ServoState(NamedTuple):
    """What a servo remembers from tick to tick besides its `Numbers`.

    Attributes:
        ticks: how many there were since the reset.
        track: estimate of the target's motion; None before there is a target.
        stopped: whether the tool is led nowhere: the next target starts a new reference, from where the arm is.
        loop: what time it is, and how late the loop is.
        stream: of targets that `Servo.step` was given.
    """

    ticks: int = 0
    track: Track | None = None
    stopped: bool = True
    loop: LoopTime = LoopTime()
    stream: TargetStream = TargetStream()


@dataclass(frozen=True, eq=False, slots=True)
class ServoSnapshot:
    """The whole state of a servo at one moment, see `Servo.snapshot`.

    Attributes:
        period: of a tick [s].
        numbers: copy of `Numbers.block`.
        state: what else it remembers.
        limits: that are kept.
        obstacles: where obstacles are and what the hand may touch, see `Avoidance.snapshot`; None without avoidance.
    """

    period: float
    numbers: Array
    state: ServoState
    limits: JointLimits
    obstacles: Array | None

    def __eq__(self, other: object) -> bool:
        return same(self, other)


def same(a: Any, b: Any) -> bool:
    """Tell whether two states hold the same values: arrays to the last bit, values field by field.

    Functions and other objects that are no values are the same only where they are one object.
    """
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()
    if isinstance(a, float):
        return a == b or (a != a and b != b)
    if isinstance(a, (tuple, list)):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if is_dataclass(a):
        return all(same(getattr(a, field.name), getattr(b, field.name)) for field in fields(a))
    if type(a).__module__.startswith("optsc.") and hasattr(a, "__dict__"):
        return same(vars(a), vars(b))
    return bool(a == b)
