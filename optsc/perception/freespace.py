"""What a depth image says about points that are not on any measured surface: seen through, agreed with, or unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage
from optsc.geometry.rotation import Array


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """A depth image prepared for asking about many points.

    Attributes:
        image: what was measured.
        front: (H, W) the nearest surface around each pixel [m]; NaN where the pixel was not measured.
        tolerance: how far a point has to be in front of what was measured to be seen through [m].
    """

    image: DepthImage
    front: Array
    tolerance: float

    def judge(self, points: Array) -> tuple[np.ndarray, np.ndarray]:
        """Return for points (..., 3) in W [m] whether each was seen through and whether it was seen, both (...) bool.

        Seen through: the camera measured something behind it, all around its pixel. Seen: it measured about its
        depth. Neither: something is in front, nothing was measured, or it is outside the image.
        """
        camera, X_WC = self.image.camera, self.image.X_WC
        local = (points - X_WC.translation) @ X_WC.rotation_matrix()
        z = local[..., 2]
        inverse = 1.0 / np.maximum(z, 1e-6)
        u = np.rint(np.clip(camera.cx + camera.fx * local[..., 0] * inverse, -1.0, camera.width)).astype(
            np.int32
        )
        v = np.rint(np.clip(camera.cy + camera.fy * local[..., 1] * inverse, -1.0, camera.height)).astype(
            np.int32
        )
        inside = (z > 1e-6) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        pixel = np.where(inside, v * camera.width + u, 0)
        with np.errstate(invalid="ignore"):
            through = inside & (self.front.ravel()[pixel] > z + self.tolerance)
            seen = inside & (np.abs(self.image.depth.ravel()[pixel] - z) <= self.tolerance)
        return through, seen


def free_space(
    image: DepthImage, robot_depth: Array | None = None, *, tolerance: float = 0.008, radius: int = 2
) -> FreeSpace:
    """Return what ``image`` says about free space.

    Args:
        image: what was measured.
        robot_depth: (H, W) depth of the arm's own surface [m], infinite where it is not; it hides what is behind it
            even where the camera measured nothing.
        tolerance: see `FreeSpace`.
        radius: half the side of the neighbourhood that has to be behind a point, in pixels: it forgives small errors
            of the pose at the edges of an object.

    Raises:
        InvalidValue: a robot_depth of another size than the image.
    """
    from scipy.ndimage import minimum_filter

    nearest = np.where(np.isnan(image.depth), np.inf, image.depth)
    if robot_depth is not None:
        if robot_depth.shape != nearest.shape:
            raise InvalidValue("robot_depth", robot_depth.shape, f"shape {nearest.shape}, that of the image")
        nearest = np.fmin(nearest, robot_depth)
    unknown = ~np.isfinite(nearest)
    front = minimum_filter(nearest, size=2 * radius + 1, mode="nearest")
    front[unknown] = np.nan
    return FreeSpace(image, front, float(tolerance))
