"""Surface normals of a part of a depth image."""

from __future__ import annotations

import numpy as np

from optsc.geometry import PinholeCamera
from optsc.geometry.rotation import Array


def normals_in_image(
    depth: Array, mask: np.ndarray, camera: PinholeCamera, corner: tuple[int, int], window: int
) -> Array:
    """Return unit normals in C, towards the camera, at the pixels of ``mask`` in their order (N, 3).

    In an image a plane n . p = d has 1/z = (n . ray)/d, linear in the ray's slopes; so the normal is the
    direction of the coefficients of a least-squares fit to 1/z around the pixel. Where too few neighbours are
    known for a fit, the normal is towards the camera.

    Args:
        depth: a part of an image (h, w) [m].
        mask: which of its pixels belong to the surface (h, w) bool; their depths are finite.
        camera: of the whole image.
        corner: row and column of the part's first pixel in the image.
        window: side of the square of pixels that are fitted, odd.
    """
    from scipy.ndimage import uniform_filter

    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return np.zeros((0, 3))
    x = np.broadcast_to((np.arange(mask.shape[1]) + corner[1] - camera.cx) / camera.fx, mask.shape)
    y = np.broadcast_to(((np.arange(mask.shape[0]) + corner[0] - camera.cy) / camera.fy)[:, None], mask.shape)
    # Moments about the part's middle: about the optical axis they would cancel badly.
    dx, dy = x - x.mean(), y - y.mean()
    w = np.where(mask, 1.0 / np.where(mask, depth, 1.0), 0.0)

    def mean(values: Array) -> Array:
        return uniform_filter(np.where(mask, values, 0.0), window, mode="constant")[rows, columns]

    n = mean(np.ones(mask.shape))
    mx, my, mw = (mean(a) / n for a in (dx, dy, w))
    xx, xy, yy = mean(dx * dx) / n - mx * mx, mean(dx * dy) / n - mx * my, mean(dy * dy) / n - my * my
    xw, yw = mean(dx * w) / n - mx * mw, mean(dy * w) / n - my * mw
    determinant = xx * yy - xy * xy
    # A full window has side^2 / 12 as its variance in pixels; a fortieth of it is nearly a line.
    full = (window * window / 12.0) ** 2 / (camera.fx * camera.fy) ** 2
    known = determinant > 0.025 * full
    safe = np.where(known, determinant, 1.0)
    a = np.where(known, (yy * xw - xy * yw) / safe, 0.0)
    b = np.where(known, (xx * yw - xy * xw) / safe, 0.0)
    rays = np.stack([x[rows, columns], y[rows, columns], np.ones(len(rows))], axis=-1)
    here = mw + a * (dx[rows, columns] - mx) + b * (dy[rows, columns] - my)
    c = here - a * rays[:, 0] - b * rays[:, 1]
    normal = np.where(known[:, None], -np.stack([a, b, c], axis=-1), -rays)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)
