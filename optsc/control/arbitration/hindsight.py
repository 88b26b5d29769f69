"""Hindsight optimisation: help that is right on average over what may be meant."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot, pi
from typing import ClassVar

import numpy as np

from optsc.control.arbitration.interface import HAND_ALONE, Arbitration, Blend, Moment
from optsc.control.arbitration.motions import offset
from optsc.errors import require_pair
from optsc.geometry.scalar import Vector
from optsc.selection.intent import HuberCost, IntentSettings


@dataclass(frozen=True)
class Hindsight(Arbitration):
    """Hindsight optimisation, or QMDP: u = u_h + sum_g b_g a_g, with a_g the descent of the cost-to-go of object g.

    S. Javdani, S. Srinivasa, J. A. Bagnell, "Shared autonomy via hindsight optimization", 2015 and 2018, with the
    constants of the authors' program: a_g = -V_t'(d) / 40 along the line and -V_r'(a) / 0.05 about the axis that lead
    to the nearest grasp of g, made proportional to distance and angle within 2 cm and 15 degrees of it. Far away that
    is 0.061 m/s and 0.294 rad/s. There is help before anything is certain, and in the middle of two grasps it
    cancels.

    Attributes:
        translation, rotation: cost-to-go over distance and angle.
        dampings: what the derivatives are divided by [s/m^2, s/rad^2].
        near: distance and angle within which the help falls to zero [m, rad].
    """

    translation: HuberCost = field(default_factory=lambda: IntentSettings().translation)
    rotation: HuberCost = field(default_factory=lambda: IntentSettings().rotation)
    dampings: tuple[float, float] = (40.0, 0.05)
    near: tuple[float, float] = (0.02, pi / 12)

    name: ClassVar[str] = "hindsight optimisation"

    def __post_init__(self) -> None:
        require_pair("Hindsight", {"dampings": self.dampings, "near": self.near})

    def blend(self, moment: Moment) -> Blend:
        """Return A = I and r = sum_g b_g a_g; the share is the probability of the most probable object."""
        goal = moment.goal
        if goal is None:
            return HAND_ALONE
        r = np.zeros(6)
        for g in moment.goals:
            shift, turn = offset(moment, self.aim(g))
            r[:3] += g.probability * self._descent(self.translation, 0, shift)
            r[3:] += g.probability * self._descent(self.rotation, 1, turn)
        return Blend(HAND_ALONE.hand, r, goal.probability)

    def _descent(self, cost: HuberCost, part: int, way: Vector) -> np.ndarray:
        length = hypot(*way)
        slope = float(cost.derivative(np.array(length))) / self.dampings[part]
        return np.array(way) * slope / max(length, self.near[part])
