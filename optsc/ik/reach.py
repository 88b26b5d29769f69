"""How far an arm can possibly reach: a bound that needs no search."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optsc.geometry.rotation import Array
from optsc.robot.model import RobotModel

MARGIN = 1e-3
"""Added to the bound [m]: a pose just outside is within a solver's tolerance of one inside."""


@dataclass(frozen=True, eq=False)
class Reach:
    """A ball that holds the origin of the last joint in every posture.

    Where the last joint is follows from the pose of the tool alone, because turning it does not move it.

    Attributes:
        centre: origin of the first joint (3,), in W [m].
        radius: sum of the distances between successive joints, and of how far they slide [m].
        last: origin of the last joint (3,), in T [m].
    """

    centre: Array
    radius: float
    last: Array

    def excludes(self, quaternion: Array, p_WT: Array) -> NDArray[np.bool_]:
        """Tell for each pose of the tool (N, 4), (N, 3) whether it is out of reach for certain.

        Poses that are not excluded may be out of reach as well.
        """
        w, v = quaternion[:, :1], quaternion[:, 1:]
        # R u = (w² - v·v) u + 2 (v·u) v + 2 w v × u, for one u and many rotations.
        turned = (
            (2.0 * w * w - 1.0) * self.last + 2.0 * (v @ self.last)[:, None] * v + 2.0 * w * (v @ self._cross)
        )
        offset = turned + p_WT - self.centre
        return np.einsum("ij,ij->i", offset, offset) > (self.radius + MARGIN) ** 2

    @cached_property
    def _cross(self) -> Array:
        """The matrix for which v @ matrix is v × last."""
        x, y, z = self.last
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def reach(robot: RobotModel) -> Reach:
    """Return the bound for an arm; its radius is infinite where a joint slides without limit."""
    chain = robot.chain
    between = sum(float(np.linalg.norm(translation)) for translation in chain.translation[1:])
    furthest = np.maximum(np.abs(robot.limits.lower), np.abs(robot.limits.upper))
    slides = sum(furthest[i] for i in range(robot.n) if chain.slides[i])
    return Reach(
        centre=chain.translation[0],
        radius=between + slides,
        last=-chain.tip_rotation.T @ chain.tip_translation,
    )
