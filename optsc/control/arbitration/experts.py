"""Product of experts: hand and robot as Gaussian opinions about the velocity."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import ClassVar

import numpy as np

from optsc.control.arbitration.interface import HAND_ALONE, Arbitration, Blend, Moment
from optsc.control.arbitration.motions import offset, towards
from optsc.errors import require_pair
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Vector


@dataclass(frozen=True)
class ProductOfExperts(Arbitration):
    """Product of Gaussian experts: the velocity that hand and goals find most likely together.

        Lambda = Lambda_h + sum_g beta_g Lambda_g,   u = Lambda^-1 (Lambda_h u_h + sum_g beta_g Lambda_g u_g)

    The blending of K. Hansel, J. Urain, J. Peters, G. Chalvatzaki, "Hierarchical policy blending as inference for
    reactive robot control", 2022, without its planner. An expert that stands for a goal is sure across the way to it
    and less so along it: it corrects the direction more than the speed. Linear blending is the special case of scalar
    precisions. The weights are ours: beta_g = max(0, b_g - 1/K) / (1 - 1/K), the belief beyond knowing nothing; 1 for
    a single object.

    Attributes:
        hand: standard deviations of the hand's velocity [m/s, rad/s].
        across, along: those of a goal's velocity, across the way to it and along it [m/s, rad/s].
    """

    hand: tuple[float, float] = (0.05, 0.25)
    across: tuple[float, float] = (0.05, 0.25)
    along: tuple[float, float] = (0.1, 0.5)

    name: ClassVar[str] = "product of experts"

    def __post_init__(self) -> None:
        pairs = {"hand": self.hand, "across": self.across, "along": self.along}
        require_pair("ProductOfExperts", pairs)

    def blend(self, moment: Moment) -> Blend:
        """Return A = Lambda^-1 Lambda_h and r = Lambda^-1 sum_g beta_g Lambda_g u_g."""
        if not moment.goals:
            return HAND_ALONE
        by_hand = np.diag(np.repeat(np.array(self.hand) ** -2.0, 3))
        total, wish = by_hand.copy(), np.zeros(6)
        for goal, beta in zip(moment.goals, weights([g.probability for g in moment.goals]), strict=True):
            shift, turn = offset(moment, self.aim(goal))
            precision = np.zeros((6, 6))
            precision[:3, :3] = self._precision(0, shift)
            precision[3:, 3:] = self._precision(1, turn)
            total += beta * precision
            u_g = towards(moment, self.aim(goal))
            wish += beta * (precision @ u_g)
        A = np.asarray(np.linalg.solve(total, by_hand), dtype=float)
        r = np.asarray(np.linalg.solve(total, wish), dtype=float)
        return Blend(A, r, 1.0 - float(np.trace(A)) / 6.0)

    def _precision(self, part: int, way: Vector) -> Array:
        """Return the precision (3, 3) of a goal's velocity: low along the way, high across it."""
        across, along = self.across[part] ** -2.0, self.along[part] ** -2.0
        length = hypot(*way)
        if length < 1e-9:
            return across * np.eye(3)
        d = np.array(way) / length
        return across * np.eye(3) + (along - across) * np.outer(d, d)


def weights(probability: list[float]) -> list[float]:
    """Return beta_g: how far each probability is above that of knowing nothing, 1 where it is certain."""
    count = len(probability)
    if count == 1:
        return [1.0]
    return [max(0.0, b - 1.0 / count) / (1.0 - 1.0 / count) for b in probability]
