"""A virtual fixture: the robot adds no motion, but makes the wrong directions stiff."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import ClassVar

import numpy as np

from optsc.control.arbitration.interface import HAND_ALONE, Arbitration, Blend, Moment
from optsc.control.arbitration.motions import limited, offset, ramp
from optsc.errors import InvalidValue, require_pair, require_positive, require_within
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Vector


@dataclass(frozen=True)
class VirtualFixture(Arbitration):
    """Guidance fixture: u = ([D] + k_tau (I - [D])) u_h, with [D] = D (D^T D)^+ D^T the preferred directions.

    P. Marayong et al., "Spatial motion constraints", 2003. Preferred are here the line and the axis that lead to the
    nearest grasp of the most probable object, both ways. The fixture closes with the belief, which is ours: k_tau
    runs from 1, free, to its value as the lead of that object rises from ``low`` to ``high``; and it opens again
    within ``near`` of the grasp, where there is no direction to speak of.

    Attributes:
        k_tau: what is left of motion in other directions, from 0, hard, to 1, free [1].
        low, high: leads between which the fixture closes [1].
        near: distance and angle to the grasp within which it opens [m, rad].
        rate: by how much its hold changes at most [1/s].
    """

    k_tau: float = 0.3
    low: float = 0.4
    high: float = 0.8
    near: tuple[float, float] = (0.03, 0.2)
    rate: float = 2.0

    name: ClassVar[str] = "virtual fixture"

    def __post_init__(self) -> None:
        require_within("VirtualFixture", {"k_tau": self.k_tau}, {"k_tau": (0.0, 1.0)})
        if not 0.0 <= self.low <= self.high <= 1.0:
            raise InvalidValue("low, high", (self.low, self.high), "0 <= low <= high <= 1")
        require_pair("VirtualFixture", {"near": self.near})
        require_positive("VirtualFixture", {"rate": self.rate})

    def blend(self, moment: Moment) -> Blend:
        """Return A = I - hold (1 - k_tau) (I - [D]) and r = 0; the share is hold (1 - k_tau)."""
        goal = moment.goal
        if goal is None:
            return HAND_ALONE
        ways = offset(moment, self.aim(goal))
        wanted = (1.0 - self.k_tau) * ramp(moment.gap, self.low, self.high)
        share = limited(moment.last.share, wanted, self.rate * moment.period)
        A = np.eye(6)
        for part, way in enumerate(ways):
            block = slice(3 * part, 3 * part + 3)
            A[block, block] -= share * min(1.0, hypot(*way) / self.near[part]) * across(way)
        return Blend(A, HAND_ALONE.robot, share)


def across(way: Vector) -> Array:
    """Return I - [D] (3, 3) of a single preferred direction: what is left across it."""
    length = hypot(*way)
    if length < 1e-9:
        return np.zeros((3, 3))
    d = np.array(way) / length
    return np.eye(3) - np.outer(d, d)
