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

SPEED = 0.25
"""Share of the velocity limits that a command is led with (tuned here) ..."""
CHANGE = 0.5
"""... and of the acceleration and jerk limits."""
COMING = 0.9
"""An arm whose distance falls to this share of what it was comes to its command by itself, and is let come."""
PATIENCE = 0.3
"""For how long [s] an arm that is not at rest has to stay away from its command before that is led to it."""
RESTING = 1e-3
"""A command slower than this [rad/s] is at rest."""
ALIKE = 0.5
"""How much of a distance may have changed, as a share, for the arm to have gone away from the command led to it."""


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

    Attributes:
        lead: the motion of the command, while there is one.
        away, waited: how far the arm was from the command [rad], and for how long it has not come nearer [s].
        tried: distance (n,) [rad] over which the command was led last to an arm at rest, until the arm is near it.
    """

    lead: Lead | None = None
    away: float = 0.0
    waited: float = 0.0
    tried: Array | None = None

    @property
    def elsewhere(self) -> bool:
        """Whether the arm is not where it is commanded to be."""
        return self.lead is not None or self.waited > 0.0

    def step(self, servo: Servo, hand: HandInput, opening: float) -> tuple[Activity, Outcome]:
        """Do one tick; see `Activity`."""
        after = self._decided(servo, hand.arm)
        lead = after.lead
        if lead is None:
            return after, Outcome(servo.stop())
        command = servo.move(lead.velocity(servo.period))
        return after._replace(lead=lead._replace(ticks=lead.ticks + 1)), Outcome(command)

    def _decided(self, servo: Servo, arm: MeasuredArm) -> Holding:
        """Return what is done at this tick: whether the command is led, and where to."""
        tolerance, limits = arm.tolerance, servo.guard.limits
        command, speed, _ = servo.guard.columns
        q = arm.q
        if q is None or not arm.believed:
            return self._still()
        gap = offset(servo.robot, limits, q, command)
        distance = float(np.abs(gap).max())
        if self.lead is not None:
            left = float(np.abs(self.lead.start + self.lead.shift - command).max())
            came_back = distance < 0.5 * tolerance.resume < left
            if self.lead.over(servo.period) or came_back:
                return self._still()
            return self
        if distance <= tolerance.resume or np.abs(speed).max() > RESTING:
            near = distance < 0.5 * tolerance.resume
            return self._still() if not near or self.tried is None else self._still()._replace(tried=None)
        if self.waited == 0.0 or distance < COMING * self.away:
            return self._replace(away=distance, waited=servo.period)
        at_rest = arm.at_rest
        if self.waited < (tolerance.rest_time if at_rest else PATIENCE) or self.went_away(gap):
            return self._replace(waited=self.waited + servo.period)
        tried = gap if at_rest else None
        return self._replace(lead=Lead.begin(limits, command.copy(), gap), waited=0.0, tried=tried)

    def _still(self) -> Holding:
        return self if self.lead is None and self.waited == 0.0 else self._replace(lead=None, waited=0.0)

    def went_away(self, gap: Array) -> bool:
        """Tell whether the arm is as far from the command as before that was led to it.

        It would go on so for ever with an arm that sags by more than the tolerance.
        """
        if self.tried is None or self.lead is not None:
            return False
        return bool(np.abs(gap - self.tried).max() <= ALIKE * np.abs(self.tried).max())


def unready(holding: Activity, servo: Servo, arm: MeasuredArm) -> str:
    """Return why motion cannot begin, in words; empty where the arm is at rest where it is commanded to be."""
    doubt, q = arm.doubt, arm.q
    if doubt or q is None:
        return doubt
    robot, command = servo.robot, servo.guard.q
    gap = offset(robot, servo.guard.limits, q, command)
    distance = float(np.abs(gap).max())
    if distance > arm.tolerance.resume:
        error = tracking_error(robot, q, command)
        if isinstance(holding, Holding) and holding.went_away(gap):
            return f"the arm stays {error:.2f} rad from its command, wherever that is led"
        return f"the arm is {error:.2f} rad from its command; the command is being led to it"
    if isinstance(holding, Holding) and holding.lead is not None:
        return "the command is being led to where the arm is"
    moving = not arm.at_rest or np.abs(servo.guard.columns[1]).max() > RESTING
    return "the arm is not at rest yet" if moving else ""
