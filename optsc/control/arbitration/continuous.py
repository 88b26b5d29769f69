"""Continuous blending with a grasp chosen by manipulability alone: the paper's predecessor, as far as it is known."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import ClassVar

from optsc.control.arbitration.interface import (
    HAND_ALONE,
    Arbitration,
    Blend,
    Goal,
    GraspPose,
    Moment,
)
from optsc.control.arbitration.motions import blended, offset
from optsc.errors import require_positive, require_within


@dataclass(frozen=True)
class Continuous(Arbitration):
    """Continuous blending, u = (1 - alpha) u_h + alpha u_r, towards the grasp of greatest manipulability.

    Known of Zhu et al. (IEEE Access, 2023): it "dynamically and continuously" blends the user's intention with
    assistance, and the grasp is the one of best manipulability, whatever the hand's pose. Not known to us is the law
    by which it blends. Ours is the distance confidence that is usual elsewhere: alpha = most max(0, 1 - d / reach),
    with d the distance from the tool to that grasp, changing no quicker than ``rate``.

    Attributes:
        reach: distance at which the robot begins to help [m].
        most: the largest alpha [1].
        rate: by how much alpha changes at most [1/s].
    """

    reach: float = 0.3
    most: float = 0.6
    rate: float = 2.0

    name: ClassVar[str] = "continuous"

    def __post_init__(self) -> None:
        require_positive("Continuous", {"reach": self.reach, "rate": self.rate})
        require_within("Continuous", {"most": self.most}, {"most": (0.0, 1.0)})

    def aim(self, goal: Goal) -> GraspPose:
        """Return the grasp of greatest manipulability."""
        return goal.best

    def blend(self, moment: Moment) -> Blend:
        """Return A = (1 - alpha) I and r = alpha u_r."""
        goal = moment.goal
        if goal is None:
            return HAND_ALONE
        shift, _ = offset(moment, self.aim(goal))
        wanted = self.most * max(0.0, 1.0 - hypot(*shift) / self.reach)
        return blended(moment, wanted, self.rate, self.aim(goal))
