"""Hold: the arm comes to rest and stays there, and its command is led to where it is, if that is elsewhere.

Something may have stopped the arm or moved it: a protective stop, another controller, a person who leads it by hand.
Its old command would pull it back at once, or as soon as it is enabled again. So the command goes to the arm, along a
straight line in joint space, and motion begins only from where the arm is believed to be and at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optsc.control.activities import Activity, HandInput, Outcome
from optsc.control.measured_arm import MeasuredArm, offset, tracking_error
from optsc.control.servo import Servo
from optsc.geometry.rotation import Array
from optsc.robot import JointLimits
from optsc.shaping import TimeLaw

SPEED = 0.9
"""Share of the velocity limits that a command is led with: the arm itself does not move ..."""
CHANGE = 0.9
"""... and of the acceleration and jerk limits."""
RESTING = 1e-3
"""A command slower than this [rad/s] is at rest."""
ATTEMPT = 2.0
"""How far the command is led, in parts of the tolerance, before the arm has to have come nearer for it."""
PUSHED = 5.0
"""How far an arm that had gone away has to be moved, in parts of the tolerance, to be followed again."""


class Lead(NamedTuple):
    """A motion of the command to where the arm is.

    Attributes:
        start, shift: configuration at the start and displacement from there (n,) [rad].
        law: share of the displacement over time.
        ticks: since the start.
    """

    start: Array
    shift: Array
    law: TimeLaw
    ticks: int = 0

    @classmethod
    def begin(cls, limits: JointLimits, start: Array, shift: Array) -> Lead:
        """Return the motion over ``shift`` (n,) [rad]; the joint that has to spare least sets the pace."""
        way = np.maximum(np.abs(shift), 1e-9)
        speed, acceleration, jerk = (
            float((share * limit / way).min())
            for share, limit in ((SPEED, limits.velocity), (CHANGE, limits.acceleration), (CHANGE, limits.jerk))
        )
        return cls(start, shift, TimeLaw(1.0, speed, acceleration, jerk))

    def velocity(self, period: float) -> Array:
        """Return the velocity (n,) [rad/s] at the end of the next tick."""
        return self.law.at((self.ticks + 1) * period).rate * self.shift

    def over(self, period: float) -> bool:
        """Tell whether the motion has ended."""
        return self.ticks * period >= self.law.duration


class Holding(NamedTuple):
    """Come to rest and stay there; lead the command to an arm that is at rest elsewhere.

    An arm that keeps its distance as the command is led to it is not where its readings say, or sags by more than the
    tolerance: following it would never end, and would move it.

    Attributes:
        lead: the motion of the command, while there is one.
        refused: distance (n,) [rad] of an arm that went away from the command; None where none did.
    """

    lead: Lead | None = None
    refused: Array | None = None

    def step(self, servo: Servo, hand: HandInput, opening: float) -> tuple[Activity, Outcome]:
        """Do one tick; see `Activity`."""
        after = self._decided(servo, hand.arm)
        lead = after.lead
        if lead is None:
            return after, Outcome(servo.stop())
        command = servo.move(lead.velocity(servo.period))
        return after._replace(lead=lead._replace(ticks=lead.ticks + 1)), Outcome(command)

    def asked_again(self) -> Holding:
        """Return the same for an operator who asks again: an arm that went away is followed once more."""
        return self if self.refused is None else self._replace(refused=None)

    def _decided(self, servo: Servo, arm: MeasuredArm) -> Holding:
        """Return what is done at this tick: whether the command is led, and where to."""
        gap = gap_to(servo, arm)
        if gap is None:
            return self if self.lead is None else self._replace(lead=None)
        resume, distance = arm.tolerance.resume, float(np.abs(gap).max())
        if self.lead is not None:
            return self._led_on(self.lead, servo, gap, resume)
        if distance <= resume:
            return self._replace(refused=None) if self.refused is not None and distance < 0.5 * resume else self
        if np.abs(servo.guard.columns[1]).max() > RESTING or not arm.at_rest:
            return self
        if self.refused is not None and np.abs(gap - self.refused).max() <= PUSHED * resume:
            return self
        return Holding(Lead.begin(servo.guard.limits, servo.guard.q.copy(), gap))

    def _led_on(self, lead: Lead, servo: Servo, gap: Array, resume: float) -> Holding:
        command, over = servo.guard.q, lead.over(servo.period)
        travel, left = (float(np.abs(part).max()) for part in (command - lead.start, lead.start + lead.shift - command))
        distance = float(np.abs(gap).max())
        came = float(np.abs(lead.shift).max()) - distance
        if (over or travel > ATTEMPT * resume) and came < 0.5 * travel:
            return Holding(refused=gap)
        came_back = distance < 0.5 * resume < left
        return Holding() if over or came_back else self


def gap_to(servo: Servo, arm: MeasuredArm) -> Array | None:
    """Return how far (n,) [rad] the command has to be led to the arm; None while the readings are not believed."""
    q = arm.q
    if q is None or not arm.believed:
        return None
    return offset(servo.robot, servo.guard.limits, q, servo.guard.q)


def elsewhere(servo: Servo, arm: MeasuredArm) -> bool:
    """Tell whether the arm is not where it is commanded to be."""
    gap = gap_to(servo, arm)
    return gap is not None and float(np.abs(gap).max()) > arm.tolerance.resume


def unready(holding: Activity, servo: Servo, arm: MeasuredArm) -> str:
    """Return why motion cannot begin, in words; empty where the arm is at rest where it is commanded to be."""
    q = arm.q
    if q is None or not arm.believed:
        return arm.doubt
    lead, refused = (holding.lead, holding.refused) if isinstance(holding, Holding) else (None, None)
    if elsewhere(servo, arm):
        error = tracking_error(servo.robot, q, servo.guard.q)
        if refused is not None:
            return f"the arm stays {error:.2f} rad from its command, wherever that is led"
        away = f"the arm is {error:.2f} rad from its command"
        if lead is None:
            return f"{away}; the command is led to it as soon as it rests"
        return f"{away}; the command is being led to it"
    if lead is not None:
        return "the command is being led to where the arm is"
    moving = not arm.at_rest or np.abs(servo.guard.columns[1]).max() > RESTING
    return "the arm is not at rest yet" if moving else ""
