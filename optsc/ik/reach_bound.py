"""Bound of an arm's reach: poses of the tool that no configuration has, told from distances between joints alone.

Turning a joint does not move its own origin. So the distance between the origins before and after a joint depends on
that joint alone, and is greatest where they lie on opposite sides of its axis:

    d_max^2 = (r_1 + r_2)^2 + (z_1 - z_2)^2        r, z: distance from the axis, height along it

Links that fold, such as those of an offset elbow, never reach as far as their lengths add up to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optsc.geometry.rotation import Array
from optsc.kernels.chain import Chain
from optsc.robot.model import RobotModel

MARGIN = 1e-3
"""Added to distances [m]: a pose just outside is within a solver's tolerance of one inside."""


@dataclass(frozen=True, eq=False)
class ReachBound:
    """How far the origins of an arm's last two joints can be from that of the first one, which stands still.

    Where the last joint is, and its axis, follows from the pose of the tool alone, because turning it moves neither.
    The joint before is somewhere on a circle about that axis.

    Attributes:
        centre: origin of the first joint (3,), in W [m].
        radius: greatest distance of the last joint [m]; infinite where a joint slides without limit.
        radius_before: the same of the joint before; infinite where there is none, or the last joint slides.
        last, axis: origin [m] and axis of the last joint (3,), in T.
        circle: height along the axis and radius of the circle on which the joint before is [m].
    """

    centre: Array
    radius: float
    radius_before: float
    last: Array
    axis: Array
    circle: tuple[float, float]

    @classmethod
    def of(cls, robot: RobotModel) -> ReachBound:
        """Return the bound for an arm."""
        chain, furthest = robot.chain, np.maximum(np.abs(robot.limits.lower), np.abs(robot.limits.upper))
        slide = np.where(chain.slides, furthest, 0.0)
        reach = _greatest_distances(chain, slide)
        on_a_circle = robot.n > 1 and not chain.slides[-1]
        before = -chain.rotation[-1].T @ chain.translation[-1]
        height = float(chain.axis[-1] @ before)
        return cls(
            centre=chain.translation[0],
            radius=reach[-1],
            radius_before=reach[-2] if on_a_circle else np.inf,
            last=-chain.tip_rotation.T @ chain.tip_translation,
            axis=chain.tip_rotation.T @ chain.axis[-1],
            circle=(height, float(np.linalg.norm(before - height * chain.axis[-1]))),
        )

    def excludes(self, quaternion: Array, p_WT: Array) -> NDArray[np.bool_]:
        """Return which poses of the tool (N, 4), (N, 3) are out of reach for certain; the others may be, too."""
        offset = _turned(quaternion, self.last) + p_WT - self.centre
        too_far = np.einsum("ij,ij->i", offset, offset) > (self.radius + MARGIN) ** 2
        if not np.isfinite(self.radius_before):
            return too_far
        height, radius = self.circle
        axis = _turned(quaternion, self.axis)
        to_circle = offset + height * axis
        along = np.einsum("ij,ij->i", to_circle, axis)
        beside = np.sqrt(np.maximum(np.einsum("ij,ij->i", to_circle, to_circle) - along * along, 0.0))
        before_too_far = along * along + (beside - radius) ** 2 > (self.radius_before + MARGIN) ** 2
        return too_far | before_too_far


def _greatest_distances(chain: Chain, slide: Array) -> list[float]:
    """Return bounds of the distances of each joint's origin from the first one's [m]; ``slide`` (n,) [m] are added."""
    lengths = [float(np.linalg.norm(translation)) for translation in chain.translation]
    reach = [float(slide[0])]
    for k in range(1, chain.n):
        bound = reach[k - 1] + lengths[k]
        if k >= 2 and not chain.slides[k - 1]:
            bound = min(bound, reach[k - 2] + _greatest_across(chain, k - 1))
        reach.append(bound + float(slide[k]))
    return reach


def _greatest_across(chain: Chain, k: int) -> float:
    """Return the greatest distance between the origins of the joints before and after joint ``k``, which turns [m]."""
    axis = chain.axis[k]
    before, after = -chain.rotation[k].T @ chain.translation[k], chain.translation[k + 1]
    heights = [float(axis @ point) for point in (before, after)]
    radii = [np.linalg.norm(point - h * axis) for point, h in zip((before, after), heights, strict=True)]
    return float(np.hypot(radii[0] + radii[1], heights[0] - heights[1]))


def _turned(quaternion: Array, vector: Array) -> Array:
    """Return one vector (3,) turned by many unit quaternions (N, 4): (w² - v·v) u + 2 (v·u) v + 2 w v × u."""
    w, v = quaternion[:, :1], quaternion[:, 1:]
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # v @ cross is v × u
    return (2.0 * w * w - 1.0) * vector + 2.0 * (v @ vector)[:, None] * v + 2.0 * w * (v @ cross)
