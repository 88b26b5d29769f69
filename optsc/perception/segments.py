"""Segments: the pixels taken for one object with points and normals, cut in two at a crease or joined to a neighbour.

Depth alone cannot tell two objects that touch from one that is made of parts, nor two objects from one whose middle
is hidden. So cutting and joining are proposals: a segment that is cut or joined has to fit a template better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optsc.checks import Above, AtMost, require
from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, PointCloud
from optsc.geometry.rotation import Array

BESIDE_ROBOT = 3
"""A segment is next to the arm if so many pixels or fewer are between them."""
CREASE = 0.5
"""Surfaces that turn towards each other by more than this within a crease's width are cut: sine of 30 degrees."""
CREASE_WIDTH = 0.010
"""Normals are compared over this distance [m]."""
SMALLEST_PART = 3e-4
"""A part has to show at least this area [m^2]: a square of 17 mm."""


@dataclass(frozen=True, eq=False)
class Segment:
    """What is taken for one object.

    Attributes:
        cloud: its points in W with normals, in the order of the pixels.
        pixels: (H, W) bool, where it is in the image.
        touches_border: whether it reaches the edge of the image, so that more of it may be outside.
        touches_robot: whether it is next to pixels of the arm, so that more of it may be hidden by it.
    """

    cloud: PointCloud
    pixels: np.ndarray
    touches_border: bool
    touches_robot: bool = False


def segment_from_pixels(
    image: DepthImage,
    pixels: np.ndarray,
    *,
    robot_mask: np.ndarray | None = None,
    normal_window: int = 7,
) -> Segment:
    """Return some pixels of an image (H, W) bool as a segment; those without a depth are left out.

    Args:
        pixels: which of it (H, W) bool; there may be none.
        robot_mask: pixels of the arm (H, W) bool, to tell whether it is next to them.
        normal_window: side of the square of pixels that a normal is fitted to, odd.

    Raises:
        InvalidValue: pixels or a mask of another size than the image.
    """
    for field, given in (("pixels", pixels), ("robot_mask", robot_mask)):
        if given is not None and (given.shape != image.depth.shape or given.dtype != np.bool_):
            raise InvalidValue(field, f"{given.dtype}{given.shape}", f"bool, shape {image.depth.shape}")
    pixels = pixels & image.measured
    if not pixels.any():
        return Segment(PointCloud(np.zeros((0, 3)), np.zeros((0, 3))), pixels, False)
    box, corner = _box(pixels)
    R = image.X_WC.rotation_matrix()
    points = points_at(image, *np.nonzero(pixels))
    normals = normals_in_image(image.depth[box], pixels[box], image.camera, corner, normal_window)
    cloud = PointCloud(points @ R.T + image.X_WC.translation, normals @ R.T)
    border = bool(pixels[[0, -1]].any() or pixels[:, [0, -1]].any())
    pixels.flags.writeable = False
    return Segment(cloud, pixels, border, robot_mask is not None and _beside(pixels, robot_mask, corner))


def points_at(image: DepthImage, rows: np.ndarray, columns: np.ndarray) -> Array:
    """Return the points in C (..., 3) [m] of the pixels at ``rows`` and ``columns`` (...) of an image."""
    camera, z = image.camera, image.depth[rows, columns]
    return np.stack([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z], axis=-1)


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


def joined_segments(image: DepthImage, segments: Sequence[Segment]) -> Segment:
    """Return several segments of an image as one; without any, one without pixels."""
    pixels = np.zeros(image.depth.shape, dtype=bool)
    for part in segments:
        pixels |= part.pixels
    found = segment_from_pixels(image, pixels)
    return Segment(found.cloud, found.pixels, found.touches_border, any(s.touches_robot for s in segments))


def split_at_creases(image: DepthImage, segment: Segment, *, crease: float = CREASE) -> tuple[Segment, ...]:
    """Return the parts of a segment between which its surface is creased, the largest first; () if it is not.

    Two convex objects that touch meet in a crease, where the surface turns towards the viewer. With n and p normals
    and points a crease's width apart, that is (n2 - n1) . (p2 - p1) < - crease |p2 - p1|. What remains connected
    without the creases is a part if it is large enough, and pixels of creases go to the nearest part.

    Args:
        image: that the segment is of.
        segment: what may be more than one object.
        crease: sine of the turn from which on a crease is one; smaller values cut more.

    Raises:
        InvalidValue: a crease that is no sine.
    """
    from scipy.ndimage import distance_transform_edt, label

    require("crease", crease, Above(0.0), AtMost(1.0))
    if len(segment.cloud) < 2:
        return ()
    box, corner = _box(segment.pixels)
    mask, points = segment.pixels[box], points_at(image, *np.mgrid[box])
    size = float(np.median(points[mask][:, 2])) * 0.5 * (1.0 / image.camera.fx + 1.0 / image.camera.fy)
    window = 2 * max(1, round(0.6 * CREASE_WIDTH / size)) + 1
    normals = np.full(points.shape, np.nan)
    normals[mask] = normals_in_image(image.depth[box], mask, image.camera, corner, window)
    smooth = mask & ~_creased(points, normals, max(1, round(0.5 * CREASE_WIDTH / size)), crease)
    numbers, count = label(smooth, np.ones((3, 3)))
    sizes = np.bincount(numbers.ravel(), minlength=count + 1)
    large = [k for k in np.argsort(-sizes).tolist() if k > 0 and sizes[k] * size**2 >= SMALLEST_PART]
    if len(large) < 2:
        return ()
    core = np.isin(numbers, large)
    nearest = distance_transform_edt(~core, return_distances=False, return_indices=True)
    owner = np.where(mask, numbers[tuple(nearest)], 0)
    parts = []
    for k in large:
        pixels = np.zeros_like(segment.pixels)
        pixels[box] = owner == k
        part = segment_from_pixels(image, pixels)
        parts.append(Segment(part.cloud, part.pixels, part.touches_border, segment.touches_robot))
    return tuple(sorted(parts, key=lambda s: -len(s.cloud)))


def _creased(points: Array, normals: Array, reach: int, crease: float) -> np.ndarray:
    """Return the pixels (h, w) about which the surface, ``reach`` to both sides, turns towards the viewer."""
    creased = np.zeros(points.shape[:2], dtype=bool)
    for axis in (0, 1):
        if points.shape[axis] <= 2 * reach:
            continue
        p, n, middle = (np.moveaxis(a, axis, 0) for a in (points, normals, creased))
        step, turn = p[2 * reach :] - p[: -2 * reach], n[2 * reach :] - n[: -2 * reach]
        with np.errstate(invalid="ignore"):
            towards = np.einsum("...i,...i->...", turn, step) < -crease * np.linalg.norm(step, axis=-1)
        middle[reach:-reach] |= towards
    return creased


def _box(pixels: np.ndarray) -> tuple[tuple[slice, slice], tuple[int, int]]:
    """Return the rectangle around pixels and its first row and column."""
    rows, columns = np.flatnonzero(pixels.any(axis=1)), np.flatnonzero(pixels.any(axis=0))
    box = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))
    return box, (box[0].start, box[1].start)


def _beside(pixels: np.ndarray, robot_mask: np.ndarray, corner: tuple[int, int]) -> bool:
    """Tell whether the arm is next to some pixels, of which the first row and column are given."""
    box, _ = _box(pixels)
    around = (
        slice(max(corner[0] - BESIDE_ROBOT, 0), box[0].stop + BESIDE_ROBOT),
        slice(max(corner[1] - BESIDE_ROBOT, 0), box[1].stop + BESIDE_ROBOT),
    )
    if not robot_mask[around].any():
        return False
    from scipy.ndimage import binary_dilation

    grown = binary_dilation(pixels[around], iterations=BESIDE_ROBOT)
    return bool((grown & robot_mask[around]).any())
