"""Putting down: the tool is lowered straight down until what it holds stands on something."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np

from optsc.checks import Checked, Positive
from optsc.control.activities import Activity, HandInput, Outcome, Travelling
from optsc.control.approach import Approach
from optsc.control.modes import Event
from optsc.control.path_feasibility import can_travel
from optsc.control.servo import Servo
from optsc.geometry import Pose


@dataclass(frozen=True)
class PlaceSettings(Checked):
    """How the robot puts down what it holds.

    Attributes:
        speed: of the tool on its way down [m/s].
        contact: the measured tool that is higher above the commanded one than in free motion by more than this stands
            on something [m].
        deepest: how far the tool is lowered where it is lower than where the object was lifted from [m].
        retreat: distance that the tool moves back along its approach axis once the jaws are open [m].
    """

    speed: Annotated[float, Positive] = 0.05
    contact: Annotated[float, Positive] = 2e-3
    deepest: Annotated[float, Positive] = 0.3
    retreat: Annotated[float, Positive] = 0.08


STANDS = 5e-3
"""A tool that is no lower than this [m] below where it grasped has the object standing where it stood."""


LEARNING_TIME = 0.3
"""In the first part of the way down [s] it shows how far an arm in free motion is behind its command."""


class Lowering(NamedTuple):
    """Lower the tool until it meets something, or is as high as where the object was lifted from.

    Attributes:
        settings: of putting down.
        motion: down to the end.
        known: whether the end is the height of the support; below it, there is none that is known.
        lag: by how much the measured tool is above the commanded one in free motion [m].
    """

    settings: PlaceSettings
    motion: Travelling
    known: bool
    lag: float = 0.0

    @classmethod
    def begin(cls, settings: PlaceSettings, approach: Approach, servo: Servo, support: float) -> Lowering:
        """Return the motion from where the tool is led along; ``support`` is its height where it grasped [m]."""
        (x, y, z), q = servo.reference
        known = _is_above(z, support)
        end = min(z, support) if known else z - settings.deepest
        motion = Travelling.begin(replace(approach, speed=settings.speed), servo, (x, y, end), q)
        return cls(settings, motion, known)

    def step(self, servo: Servo, hand: HandInput, opening: float) -> tuple[Activity, Outcome]:
        """Do one tick; see `Activity`."""
        motion, outcome = self.motion.step(servo, hand, opening)
        if not isinstance(motion, Travelling):
            return motion, outcome
        after = self._replace(motion=motion)
        above = _above(servo, hand)
        if above is not None:
            learning = motion.ticks * servo.period < LEARNING_TIME
            if above > (4.0 * self.settings.contact if learning else self.lag + self.settings.contact):
                return after, outcome._replace(event=Event.SUPPORTED)
            if learning:
                after = after._replace(lag=max(self.lag, above))
        if outcome.event is Event.ARRIVED:
            if self.known:
                return after, outcome._replace(event=Event.SUPPORTED)
            words = f"there is nothing to put it down on within {1e3 * self.settings.deepest:.0f} mm"
            return after, outcome._replace(event=Event.UNSUPPORTED, reason=words)
        return after, outcome


def can_lower(settings: PlaceSettings, approach: Approach, servo: Servo, support: float) -> bool:
    """Tell whether the arm can lower the tool straight down to the height ``support`` [m], where it is above that."""
    (x, y, z), q = servo.reference
    if not _is_above(z, support) or z <= support:
        return True
    start, end = (Pose(np.array(q), np.array([x, y, height])) for height in (z, support))
    return can_travel(servo.robot, replace(approach, speed=settings.speed), servo.guard.q.copy(), (start, end))


def _is_above(z: float, support: float) -> bool:
    return z >= support - STANDS


def _above(servo: Servo, hand: HandInput) -> float | None:
    """Return how far the measured tool is above the commanded one [m]; None while readings are not believed."""
    if hand.arm.q is None or not hand.arm.believed:
        return None
    z = servo.robot.forward(np.stack([hand.arm.q, servo.guard.q])).translation[:, 2]
    return float(z[0] - z[1])
