"""Arbitration policy: how the hand's wish and the robot's become one motion.

In manual mode a policy says how much of the hand's velocity u_h is executed, and what the robot adds:

    u = A u_h + r

Every policy here has this form. `optsc.control.assisted` integrates it from where the tool is, lets A and r come in
smoothly from A = I, r = 0, and bounds them: whatever a policy answers, and however suddenly, nothing jumps.
"""

from __future__ import annotations

from enum import Enum
from math import hypot
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from optsc.control.approach import Approach
from optsc.geometry import scalar
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Quaternion, Vector


class Trigger(Enum):
    """What the trigger means in manual mode."""

    HANDS_OVER = "the robot takes over and grasps by itself"
    GRASPS = "the jaws close where they are"


class GraspPose(NamedTuple):
    """A grasp that the arm can execute: the tool's pose in W, and the number of the candidate."""

    p: Vector
    q: Quaternion
    candidate: int


class Goal(NamedTuple):
    """An object that may be intended.

    Attributes:
        name: of the object.
        probability: that it is the intended one.
        nearest: its grasp that is nearest to the tool, of those that the arm can execute.
        best: its grasp of greatest manipulability.
    """

    name: str
    probability: float
    nearest: GraspPose
    best: GraspPose


class Blend(NamedTuple):
    """How hand and robot are blended: u = A u_h + r, twists (6,) in W, linear over angular.

    Attributes:
        hand: A (6, 6), what is executed of the hand's velocity.
        robot: r (6,) [m/s, rad/s], what the robot adds.
        share: how much of the authority is the robot's, in [0, 1]; for displays, records and rate limits.
    """

    hand: Array
    robot: Array
    share: float = 0.0


def _alone() -> Blend:
    hand, robot = np.eye(6), np.zeros(6)
    hand.flags.writeable = robot.flags.writeable = False
    return Blend(hand, robot)


HAND_ALONE = _alone()
"""The hand's velocity and nothing else."""


class Moment(NamedTuple):
    """What a policy decides from, at one tick.

    Attributes:
        p, q: tool pose in W that the arm is being led along.
        hand: velocity (6,) that the hand asks for [m/s, rad/s].
        goals: the objects that may be intended, by name; empty where no grasp is in reach.
        gap: by how much the most probable object leads the second, in [0, 1].
        last: what the policy answered at the tick before; `HAND_ALONE` after the clutch has closed.
        period: time since then [s].
        approach: the speeds that the robot may add.
    """

    p: Vector
    q: Quaternion
    hand: Array
    goals: tuple[Goal, ...]
    gap: float
    last: Blend
    period: float
    approach: Approach

    @property
    def goal(self) -> Goal | None:
        """The most probable object, of equals the first by name; None where there is none."""
        return max(self.goals, key=lambda goal: goal.probability, default=None)


class Arbitration(Protocol):
    """An arbitration policy: a value, whose answers follow from their arguments alone.

    Subclasses change what they need: with nothing but a `blend` they help in manual mode, and the trigger grasps.

    Attributes:
        name: for tables and records.
        trigger: what the trigger means in manual mode.
        assists: whether `blend` is asked at all; otherwise the hand moves the tool by the clutch's own mapping.
    """

    name: ClassVar[str]
    trigger: ClassVar[Trigger] = Trigger.GRASPS
    assists: ClassVar[bool] = True

    def aim(self, goal: Goal) -> GraspPose:
        """Return which grasp of an object the robot helps towards, which is the one that is shown."""
        return goal.nearest

    def blend(self, moment: Moment) -> Blend:
        """Return how hand and robot are blended now."""
        return HAND_ALONE

    def begins(self, intended_for: float) -> bool:
        """Tell whether the robot takes over by itself, the same object having been intended for ``intended_for`` [s].

        Asked until the operator has stepped in, and again after a halt.
        """
        return False


SLOWING = 0.3
"""Time constant [s] of coming to rest at a pose: from 0.1 m/s the last 3 cm are slower."""


def offset(moment: Moment, grasp: GraspPose) -> tuple[Vector, Vector]:
    """Return the displacement [m] and the rotation vector [rad], in W, that lead the tool to a grasp."""
    (x, y, z), (gx, gy, gz) = moment.p, grasp.p
    return (gx - x, gy - y, gz - z), scalar.log(scalar.multiply(grasp.q, scalar.conjugate(moment.q)))


def towards(moment: Moment, grasp: GraspPose) -> Array:
    """Return the twist (6,) that leads straight to a grasp: e / `SLOWING`, at the approach's speeds at most.

    The slower of the two parts sets the pace, so that line and rotation end together.
    """
    shift, turn = offset(moment, grasp)
    approach = moment.approach
    pace = max(hypot(*shift) / approach.speed, hypot(*turn) / approach.angular_speed, SLOWING)
    return np.array([*shift, *turn]) / pace


def ramp(value: float, low: float, high: float) -> float:
    """Return 0 up to ``low``, 1 from ``high`` on, and a straight line between; a step where both are equal."""
    if value <= low:
        return 0.0
    return 1.0 if value >= high else (value - low) / (high - low)


def limited(last: float, wanted: float, most: float) -> float:
    """Return ``wanted``, but no further from ``last`` than ``most``."""
    return min(max(wanted, last - most), last + most)


def blended(moment: Moment, wanted: float, rate: float, grasp: GraspPose) -> Blend:
    """Return u = (1 - alpha) u_h + alpha u_r towards a grasp; alpha nears ``wanted`` at most at ``rate`` [1/s]."""
    alpha = limited(moment.last.share, wanted, rate * moment.period)
    return Blend((1.0 - alpha) * np.eye(6), alpha * towards(moment, grasp), alpha)
