"""Linear policy blending by confidence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from optsc.control.arbitration.interface import HAND_ALONE, Arbitration, Blend, Moment
from optsc.control.arbitration.motions import blended, ramp
from optsc.errors import InvalidValue, require_positive, require_within


@dataclass(frozen=True)
class LinearBlending(Arbitration):
    """Linear blending, u = (1 - alpha) u_h + alpha u_r, towards the nearest grasp of the most probable object.

    A. Dragan, S. Srinivasa, "A policy-blending formalism for shared control", 2013. The confidence is the lead c of
    the most probable object over the second; alpha = most (c - low) / (high - low), between 0 and ``most``, the
    piecewise linear form of Gopinath et al.; equal thresholds make it the switch at a lead of 0.4 in the program of
    Javdani et al., whose largest alpha is 0.6 too. The rate limit of alpha and the upper threshold are ours.

    Attributes:
        low, high: leads between which alpha rises [1].
        most: the largest alpha [1].
        rate: by how much alpha changes at most [1/s].
    """

    low: float = 0.4
    high: float = 0.8
    most: float = 0.6
    rate: float = 2.0

    name: ClassVar[str] = "linear blending"

    def __post_init__(self) -> None:
        if not 0.0 <= self.low <= self.high <= 1.0:
            raise InvalidValue("low, high", (self.low, self.high), "0 <= low <= high <= 1")
        require_positive("LinearBlending", {"rate": self.rate})
        require_within("LinearBlending", {"most": self.most}, {"most": (0.0, 1.0)})

    def blend(self, moment: Moment) -> Blend:
        """Return A = (1 - alpha) I and r = alpha u_r."""
        goal = moment.goal
        if goal is None:
            return HAND_ALONE
        wanted = self.most * ramp(moment.gap, self.low, self.high)
        return blended(moment, wanted, self.rate, self.aim(goal))
