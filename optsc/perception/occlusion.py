"""Occlusion by the arm: whether it hides an object, from its own geometry at the measured configuration.

The arm is the capsules that hold all of its links' surfaces, the fingers in every position of the jaws. A ray from
the camera meets a capsule where it meets one of its end spheres or the cylinder between them; all of that has
closed forms. Whatever is rounded is rounded so that the arm seems larger and nearer than it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import Below, NonNegative, require
from optsc.collision.capsules import link_capsules
from optsc.collision.kernels.capsules import capsule_ends
from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PinholeCamera, Pose
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel

MARGIN = 0.01
"""Capsules are this much thicker [m]: for links that look larger than they collide, and errors of calibration."""
HALO = 0.01
"""The view is clear if the arm stays this far from the silhouette, measured at the object [m]."""
BEHIND = 0.01
"""The arm counts as behind an object if it is this far behind the farthest that was seen of it [m]."""
CELLS = 20_000
"""At most so many rays are cast: in a larger image, square cells of pixels share one."""
_NEAREST = 0.01


class Occlusion(NamedTuple):
    """Whether the view of an object is clear of the arm.

    Attributes:
        clear: nothing of the arm is in front of the object, nor close beside it in the image.
        hidden_fraction: share of the silhouette that the arm is in front of, 0 to 1.
    """

    clear: bool
    hidden_fraction: float


class _Hit(NamedTuple):
    """Where the rays of some cells are inside a capsule: depths [m], entry = inf where they miss it."""

    rows: slice
    columns: slice
    entry: Array
    exit: Array


def robot_depth(robot: RobotModel, q: ArrayLike, camera: PinholeCamera, X_WC: Pose, *, margin: float = MARGIN) -> Array:
    """Return the depth of the arm in an image (H, W) [m], infinite where it is not; 0 around the camera.

    The arm is never farther than said nor in a pixel that is said to be free of it.

    Args:
        q: its measured configuration (n,) [rad].
        margin: by which the arm is thickened [m].

    Raises:
        InvalidValue: no single configuration or pose, or a negative margin.
        DamagedFile: the arm's collision geometry cannot be read.
    """
    stride, grid = _grid(camera)
    depth = np.full(grid, np.inf)
    for hit in _hits(robot, q, camera, X_WC, margin):
        part = depth[hit.rows, hit.columns]
        np.minimum(part, hit.entry, out=part)
    return _upsampled(depth, stride, (camera.height, camera.width))


def robot_mask(robot: RobotModel, q: ArrayLike, image: DepthImage, *, margin: float = MARGIN) -> np.ndarray:
    """Return which pixels show the arm (H, W) bool: what they measured lies within one of its capsules.

    Pixels behind the arm's capsules or in front of them measured something else and are not among these.

    Args:
        q: its measured configuration at the image's time (n,) [rad].
        margin: by which the arm is thickened [m].

    Raises:
        InvalidValue: no single configuration, or a negative margin.
        DamagedFile: the arm's collision geometry cannot be read.
    """
    camera = image.camera
    stride, _ = _grid(camera)
    mask = np.zeros(image.depth.shape, dtype=bool)
    for hit in _hits(robot, q, camera, image.X_WC, margin):
        where = (
            slice(hit.rows.start * stride, hit.rows.stop * stride),
            slice(hit.columns.start * stride, hit.columns.stop * stride),
        )
        depth = image.depth[where]
        entry, leaving = (_upsampled(a, stride, depth.shape) for a in (hit.entry, hit.exit))
        mask[where] |= (depth >= entry) & (depth <= leaving)
    return mask


def view_is_clear(
    silhouette: np.ndarray,
    robot_depth: Array,
    image: DepthImage,
    *,
    halo: float = HALO,
    behind: float = BEHIND,
) -> Occlusion:
    """Return whether the arm leaves the view of an object clear.

    Args:
        silhouette: where the object was in ``image`` (H, W) bool, such as `Segment.pixels`.
        robot_depth: depth of the arm now, seen from the same place, see `robot_depth`.
        image: where the object was last seen; its depths say what the arm may be behind of.
        halo: how far the arm has to stay from the silhouette, measured at the object [m].
        behind: how far behind the farthest point of the object the arm has to be to count as behind it [m].

    Returns:
        Not clear, with a hidden fraction of 1, for a silhouette without a pixel: nothing is known about it.

    Raises:
        InvalidValue: a silhouette or depth of another size than the image, or a negative distance.
    """
    size = image.depth.shape
    for field, array in (("silhouette", silhouette), ("robot_depth", robot_depth)):
        if array.shape != size:
            raise InvalidValue(field, array.shape, f"shape {size}, the size of the image")
    require("halo", halo, NonNegative, Below(1.0))
    require("behind", behind, NonNegative, Below(1.0))
    rows, columns = np.flatnonzero(silhouette.any(axis=1)), np.flatnonzero(silhouette.any(axis=0))
    if len(rows) == 0:
        return Occlusion(False, 1.0)
    known = image.depth[silhouette]
    known = known[~np.isnan(known)]
    # Of an object without any measured depth nothing says that the arm is behind it.
    nearest, farthest = (float(known.min()), float(known.max())) if len(known) else (0.1, np.inf)
    reach = int(np.ceil(halo * max(image.camera.fx, image.camera.fy) / nearest))
    window = (
        slice(max(rows[0] - reach, 0), rows[-1] + reach + 1),
        slice(max(columns[0] - reach, 0), columns[-1] + reach + 1),
    )
    in_front = robot_depth[window] < farthest + behind
    hidden = float(in_front[silhouette[window]].mean())
    return Occlusion(not (in_front & _grown(silhouette[window], reach)).any(), hidden)


def _grown(mask: np.ndarray, reach: int) -> np.ndarray:
    """Return the mask grown by ``reach`` pixels in both directions: a square, which holds the disc."""
    if reach == 0:
        return mask
    for axis in (0, 1):
        count = np.cumsum(mask, axis=axis, dtype=np.int32)
        last = mask.shape[axis] - 1
        index = np.arange(last + 1)
        low = np.take(count, np.maximum(index - reach - 1, 0), axis)
        below = np.expand_dims(index - reach - 1 < 0, 1 - axis)
        mask = np.take(count, np.minimum(index + reach, last), axis) > np.where(below, 0, low)
    return mask


def _grid(camera: PinholeCamera) -> tuple[int, tuple[int, int]]:
    """Return the edge of a cell in pixels and the numbers of rows and columns of cells."""
    stride = max(1, int(np.ceil(np.sqrt(camera.width * camera.height / CELLS))))
    return stride, (-(-camera.height // stride), -(-camera.width // stride))


def _upsampled(cells: np.ndarray, stride: int, shape: tuple[int, ...]) -> np.ndarray:
    """Return the value of its cell for each pixel, cut to ``shape``: cells at the border may be larger."""
    return np.repeat(np.repeat(cells, stride, axis=0), stride, axis=1)[: shape[0], : shape[1]]


def _hits(robot: RobotModel, q: ArrayLike, camera: PinholeCamera, X_WC: Pose, margin: float) -> Iterator[_Hit]:
    """Yield what the rays through the cells' middles meet of each capsule that is in the image."""
    q = robot.checked(q)
    if q.ndim != 1:
        raise InvalidValue("q", q.shape, f"a single configuration, shape ({robot.n},)")
    if X_WC.shape != ():
        raise InvalidValue("X_WC", X_WC.shape, "a single pose")
    require("margin", margin, NonNegative, Below(1.0))
    ends_W, radii = capsules_at(robot, q)
    ends = X_WC.inverse().apply(ends_W)
    stride, (height, width) = _grid(camera)
    middle = 0.5 * (stride - 1)
    right = (stride * np.arange(width) + middle - camera.cx) / camera.fx
    down = (stride * np.arange(height) + middle - camera.cy) / camera.fy
    # No point of a cell is farther from its middle than this, per unit of depth.
    spread = 0.5 * stride * np.hypot(1.0 / camera.fx, 1.0 / camera.fy) if stride > 1 else 0.0
    for k, radius in enumerate((radii + margin).tolist()):
        a, b = ends[k]
        # Points of a capsule that is thickened by a cell's size are inside it where the cell's middle is.
        r = radius + spread * max(float(max(a[2], b[2])) + radius, 0.0)
        columns, rows = (_range(values, a, b, axis, r) for axis, values in ((0, right), (1, down)))
        if columns.stop > columns.start and rows.stop > rows.start:
            yield _Hit(rows, columns, *_inside(right[columns], down[rows], a, b, r))


def _range(values: np.ndarray, a: Array, b: Array, axis: int, r: float) -> slice:
    """Return which of the increasing slopes x/z of rays a capsule with ends a and b may be met by."""
    if max(a[2], b[2]) + r <= 0.0:
        return slice(0, 0)
    if min(a[2], b[2]) - r <= _NEAREST:
        return slice(0, len(values))
    low, high = np.inf, -np.inf
    for end in (a, b):  # a sphere is seen within the angle whose sine is radius over distance
        angle, half = np.arctan2(end[axis], end[2]), np.arcsin(r / np.hypot(end[axis], end[2]))
        low, high = min(low, np.tan(angle - half)), max(high, np.tan(angle + half))
    return slice(int(np.searchsorted(values, low)), int(np.searchsorted(values, high, side="right")))


def _inside(right: np.ndarray, down: np.ndarray, a: Array, b: Array, r: float) -> tuple[Array, Array]:
    """Return the depths (rows, columns) [m] between which the rays (right, down, 1) are inside a capsule.

    A capsule is convex, so that is from the first entry to the last exit of its three parts.
    """
    axis = b - a
    square = right**2 + (down**2)[:, None] + 1.0  # of the length of the ray per unit of depth
    along_a, along_b, along_axis = (right * v[0] + (down * v[1])[:, None] + v[2] for v in (a, b, axis))
    entry, leaving = np.full(square.shape, np.inf), np.full(square.shape, -np.inf)
    for along, end in ((along_a, a), (along_b, b)):
        root = along**2 - square * (end @ end - r * r)
        hit = root >= 0.0
        root = np.sqrt(np.where(hit, root, 0.0))
        entry = np.where(hit, np.minimum(entry, (along - root) / square), entry)
        leaving = np.where(hit, np.maximum(leaving, (along + root) / square), leaving)
    length, offset = float(axis @ axis), float(axis @ a)
    if length > 1e-12:
        A = length * square - along_axis**2
        B = offset * along_axis - length * along_a
        C = length * float(a @ a) - offset**2 - r * r * length
        root = B**2 - A * C
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (offset / along_axis, (offset + length) / along_axis)
            s = np.sqrt(np.maximum(root, 0.0))
            first = np.maximum((-B - s) / A, np.minimum(*ends))
            last = np.minimum((-B + s) / A, np.maximum(*ends))
            hit = (root >= 0.0) & (first <= last)
        entry = np.where(hit, np.minimum(entry, first), entry)
        leaving = np.where(hit, np.maximum(leaving, last), leaving)
    missed = leaving <= 0.0
    return np.where(missed, np.inf, np.maximum(entry, 0.0)), np.where(missed, -np.inf, leaving)


@lru_cache(maxsize=16)
def _capsules(robot: RobotModel) -> tuple[Callable[[Array], Any], Array]:
    """Return the function q (n,) -> ends (6, K) [m] and the radii (K,) [m] of the arm's capsules."""
    capsules = link_capsules(robot)
    return capsule_ends(robot.chain, capsules), capsules.radius


def capsules_at(robot: RobotModel, q: ArrayLike) -> tuple[Array, Array]:
    """Return the ends in W (K, 2, 3) [m] and the radii (K,) [m] of the arm's capsules at configuration q (n,) [rad].

    Raises:
        DamagedFile: the arm's collision geometry cannot be read.
    """
    place, radii = _capsules(robot)
    return place(np.asarray(q, dtype=float)).full().T.reshape(-1, 2, 3), radii
