"""The table plane in a depth image: a least-squares fit near the expected height."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage
from optsc.geometry.rotation import Array
from optsc.perception.segments import points_at

NEAR_TABLE = 0.02
"""Points this close to where the table is expected are fitted [m]."""
LARGEST_TILT = 0.05
"""A fitted plane is refused if it is tilted more against the expected one [rad]."""
FEWEST = 200
"""A plane takes at least so many points."""
_MOST, _ROUNDS, _BIN = 20_000, 4, 0.01


class TablePlane(NamedTuple):
    """A plane: points p in W with normal . p = offset.

    Attributes:
        normal: upwards, unit (3,).
        offset: [m]; the height of the table where the normal is vertical.
        measured: whether it was fitted to the image; otherwise it is the expected one.
    """

    normal: Array
    offset: float
    measured: bool

    def heights(self, image: DepthImage) -> Array:
        """Return the height above the table of every pixel (H, W) [m], NaN where nothing was measured."""
        a, b, c = image.X_WC.rotation_matrix().T @ self.normal
        camera = image.camera
        right = (np.arange(camera.width) - camera.cx) / camera.fx
        down = (np.arange(camera.height) - camera.cy) / camera.fy
        slope = (a * right + c) + (b * down)[:, None]
        return image.depth * slope + (float(self.normal @ image.X_WC.translation) - self.offset)


def find_table(image: DepthImage, expected: float | None = 0.0) -> TablePlane:
    """Return the plane of the table, fitted to the points near the expected height.

    Least squares with what is farther than 2.5 deviations left out, in four rounds. The expected plane is
    returned where too few points are near it, or where the fit is tilted by more than `LARGEST_TILT`.

    Args:
        expected: height of the table in W [m]; None to take the height that most points have.

    Raises:
        InvalidValue: an infinite height; no height given, and no level plane in the image.
    """
    if expected is not None and not np.isfinite(expected):
        raise InvalidValue("table_height", expected, "finite [m], or None")
    step = max(1, int(np.sqrt(image.depth.size / _MOST)))
    rows, columns = np.nonzero(~np.isnan(image.depth[::step, ::step]))
    points = image.X_WC.apply(points_at(image, step * rows, step * columns))
    height = _commonest_height(points[:, 2]) if expected is None else float(expected)
    level = TablePlane(np.array([0.0, 0.0, 1.0]), height, False)
    near = points[np.abs(points[:, 2] - height) < NEAR_TABLE]
    for _ in range(_ROUNDS):
        if len(near) < FEWEST:
            return level
        A = np.column_stack([near[:, :2], np.ones(len(near))])
        plane = np.linalg.lstsq(A, near[:, 2], rcond=None)[0]
        residual = np.abs(near[:, 2] - A @ plane)
        near = near[residual <= max(2.5 * float(np.sqrt(np.mean(residual**2))), 1e-6)]
    normal = np.array([-plane[0], -plane[1], 1.0])
    length = float(np.linalg.norm(normal))
    if np.arctan(np.hypot(plane[0], plane[1])) > LARGEST_TILT:
        return level
    return TablePlane(normal / length, float(plane[2]) / length, True)


def _commonest_height(z: Array) -> float:
    """Return the middle of the interval of heights with the most points."""
    if len(z) >= FEWEST:
        low, high = np.percentile(z, [0.5, 99.5])
        counts, edges = np.histogram(z, bins=np.arange(low, high + 2 * _BIN, _BIN))
        best = int(np.argmax(counts))
        if counts[best] >= max(FEWEST, 0.1 * len(z)):
            return float(np.median(z[(z >= edges[best]) & (z <= edges[best + 1])]))
    raise InvalidValue(
        "table_height", None, f"a height [m]: the {len(z)} points looked at show no level plane to find it by"
    )
