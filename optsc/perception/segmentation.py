"""Segmentation: objects on a table apart from the table, the arm and each other, from depth alone.

What stands out of the table's plane is split where neighbouring pixels are too far apart in space. An object that
hides a part of itself, as a drill's barrel hides its grip from above, comes in two pieces: a piece that would hang
in the air is given to the one below it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from optsc.checks import AtLeast, Between, Checked, Positive, Share, Where
from optsc.errors import InvalidValue
from optsc.geometry import DepthImage
from optsc.geometry.rotation import Array
from optsc.perception.segments import Segment, points_at, segment_from_pixels
from optsc.perception.table import TablePlane, find_table

RIM = 0.025
"""The inner side of a hollow object comes this close to the outer one at its rim [m]."""
SAME_RIM = 0.008
"""And the two end at heights that differ by no more than this [m]."""
_ODD = Where("odd", lambda n: n % 2 == 1)
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0), (0, 3), (3, 0))  # rows, columns to a neighbour
_OCCLUSION_STEPS = ((0, 1), (1, 0), (0, 3), (3, 0), (0, 5), (5, 0))


@dataclass(frozen=True)
class SegmentationSettings(Checked):
    """What counts as an object.

    Attributes:
        lowest: points are an object's from this height above the table on [m]: five deviations of a height.
        highest: and up to this height [m].
        gap: neighbouring pixels of an object are at most so far apart [m], or `pixels` times the size of a pixel
            there if that is more.
        pixels: see `gap` [-].
        reach: pixels further apart are neighbours as well; the gap grows by this share for each [-].
        smallest: a cluster of fewer pixels is dropped.
        largest: a cluster longer than this is dropped [m].
        overhang: a cluster hangs in the air from this height above the table on [m].
        normal_window: side of the square of pixels that a normal is fitted to, odd.
    """

    lowest: Annotated[float, Positive] = 0.008
    highest: Annotated[float, Positive] = 0.6
    gap: Annotated[float, Positive] = 0.008
    pixels: Annotated[float, Between(0.0, 100.0)] = 4.0
    reach: Annotated[float, Share] = 0.6
    smallest: Annotated[int, AtLeast(1)] = 60
    largest: Annotated[float, Positive] = 0.5
    overhang: Annotated[float, Positive] = 0.025
    normal_window: Annotated[int, AtLeast(3), _ODD] = 7


class DroppedCluster(NamedTuple):
    """A cluster that was not taken for an object: how many pixels it had, and why."""

    pixels: int
    reason: str


@dataclass(frozen=True, eq=False)
class Segmentation:
    """The objects in an image, and what was left out.

    Attributes:
        segments: the objects, the largest in the image first.
        dropped: what was left out; it says so, too, if nothing was measured at all.
        table: the plane that heights were measured from.
    """

    segments: tuple[Segment, ...]
    dropped: tuple[DroppedCluster, ...]
    table: TablePlane


def segment_image(
    image: DepthImage,
    *,
    table_height: float | None = 0.0,
    robot_mask: np.ndarray | None = None,
    settings: SegmentationSettings | None = None,
) -> Segmentation:
    """Return the objects in an image and what was left out.

    Args:
        table_height: where the table is expected in W [m]; None to take the height that most points have.
        robot_mask: pixels of the arm (H, W) bool, see `optsc.perception.robot_mask`; none by default.

    Raises:
        InvalidValue: a mask of another size, or no height given and no level plane in the image.
    """
    settings = settings or SegmentationSettings()
    arm = np.zeros(image.depth.shape, dtype=bool) if robot_mask is None else np.asarray(robot_mask)
    if arm.shape != image.depth.shape or arm.dtype != np.bool_:
        raise InvalidValue("robot_mask", f"{arm.dtype}{arm.shape}", f"bool, shape {image.depth.shape}")
    if not image.measured.any():
        level = TablePlane(np.array([0.0, 0.0, 1.0]), float(table_height or 0.0), False)
        return Segmentation((), (DroppedCluster(0, "nothing was measured in the whole image"),), level)
    table = find_table(image, table_height)
    height = table.heights(image)
    above = (height > settings.lowest) & (height < settings.highest) & ~arm
    if not above.any():
        return Segmentation((), (), table)
    foreground = _Foreground(image, height, above)
    labels, dropped = _without_small(foreground.clusters(settings), settings)
    labels = foreground.with_overhangs(labels, settings)
    segments = []
    for label in range(int(labels.max()) + 1):
        found = segment_from_pixels(
            image, foreground.whole(labels == label), robot_mask=arm, normal_window=settings.normal_window
        )
        size = float(np.linalg.norm(np.ptp(found.cloud.points, axis=0))) if len(found.cloud) else 0.0
        if size > settings.largest:
            dropped.append(DroppedCluster(len(found.cloud), f"{size:.2f} m long, more than {settings.largest} m"))
        elif len(found.cloud):
            segments.append(found)
    segments.sort(key=lambda s: -len(s.cloud))
    return Segmentation(tuple(segments), tuple(dropped), table)


def _without_small(labels: np.ndarray, settings: SegmentationSettings) -> tuple[np.ndarray, list[DroppedCluster]]:
    """Return the labels with small clusters taken out and the others numbered from 0, -1 for none."""
    counts = np.bincount(labels[labels >= 0])
    kept = counts >= settings.smallest
    dropped = [DroppedCluster(int(count), f"fewer than {settings.smallest} pixels") for count in counts[~kept].tolist()]
    number = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
    return number[labels], sorted(dropped, key=lambda d: -d.pixels)


class _Foreground:
    """The rectangle of an image that holds everything above the table."""

    def __init__(self, image: DepthImage, height: Array, above: np.ndarray) -> None:
        rows, columns = np.flatnonzero(above.any(axis=1)), np.flatnonzero(above.any(axis=0))
        self.corner = np.array([[rows[0]], [columns[0]]])
        self.window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        self.image, self.above = image, above[self.window]
        self.depth, self.height = image.depth[self.window], height[self.window]

    def points_C(self, mask: np.ndarray) -> Array:
        """Return the points in C (N, 3) [m] of some pixels (h, w) bool."""
        return points_at(self.image, *(np.array(np.nonzero(mask)) + self.corner))

    def clusters(self, settings: SegmentationSettings) -> np.ndarray:
        """Return the number of the connected cluster of every pixel (h, w), -1 for none."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        points = self.points_C(self.above)
        index = np.full(self.above.shape, -1)
        index[self.above] = np.arange(len(points))
        pixel = 0.5 * (1.0 / self.image.camera.fx + 1.0 / self.image.camera.fy)
        limit = np.maximum(settings.gap, settings.pixels * pixel * points[:, 2])
        starts, ends = [], []
        for down, right in _STEPS:
            i, j = _pairs(index, down, right)
            both = (i >= 0) & (j >= 0)
            i, j = i[both], j[both]
            growth = max(1.0, settings.reach * (abs(down) + abs(right)))
            square = np.einsum("ij,ij->i", points[i] - points[j], points[i] - points[j])
            near = square <= (growth * limit[i]) ** 2
            starts.append(i[near])
            ends.append(j[near])
        i, j = np.concatenate(starts), np.concatenate(ends)
        graph = coo_array((np.ones(len(i), dtype=bool), (i, j)), shape=(len(points),) * 2)
        labels = np.full(self.above.shape, -1)
        labels[self.above] = connected_components(graph, directed=False)[1]
        return labels

    def with_overhangs(self, labels: np.ndarray, settings: SegmentationSettings) -> np.ndarray:
        """Return the labels with every cluster that hangs in the air joined to the one that is below it.

        It hangs if all of it is high above the table although nothing hides what is below: then it hides the rest
        of its object, and belongs to what is seen below its own outline and beyond it. The inner side of a
        mug hangs as well, behind the outer one: both end at the rim.
        """
        count = int(labels.max()) + 1
        lowest = [float(np.percentile(self.height[labels == k], 2)) for k in range(count)]
        hanging = [k for k in np.argsort(lowest)[::-1].tolist() if lowest[k] > settings.overhang]
        if not hanging or count < 2:
            return labels
        hides = self._hides(labels, count)
        owner = np.arange(count)
        for k in hanging:
            if hides[:, k].sum() > 0.3 * hides[k].sum():
                # What hides its lower part may be the front of the same hollow object.
                other = int(np.argmax(hides[:, k]))
                partner = other if self._lines(labels, k, other) else None
            else:
                partner = self._below(labels, k, np.flatnonzero(hides[k]))
            if partner is not None:
                owner[k] = partner
        for k in reversed(hanging):  # from low to high, so that the owner of an owner is known
            owner[k] = owner[owner[k]]
        _, number = np.unique(owner, return_inverse=True)
        return np.append(number, -1)[labels]

    def _hides(self, labels: np.ndarray, count: int) -> np.ndarray:
        """Return how often a pixel of cluster i is in front of one of cluster j close by (count, count)."""
        hides = np.zeros((count, count), dtype=int)
        for down, right in _OCCLUSION_STEPS:
            a, b = _pairs(labels, down, right)
            edge = (a >= 0) & (b >= 0) & (a != b)
            za, zb = (z[edge] for z in _pairs(self.depth, down, right))
            first, second = a[edge], b[edge]
            nearer, farther = np.where(za < zb, first, second), np.where(za < zb, second, first)
            np.add.at(hides, (nearer, farther), 1)
        return hides

    def _below(self, labels: np.ndarray, k: int, candidates: np.ndarray) -> int | None:
        """Return the candidate of which the largest share lies straight below cluster k; None if it is little."""
        from scipy.spatial import cKDTree

        top = self.image.X_WC.apply(self.points_C(labels == k)[::3])
        tree, middle = cKDTree(top[:, :2]), float(np.median(self.height[labels == k]))
        best, best_share = None, 0.15
        for j in candidates.tolist():
            if np.percentile(self.height[labels == j], 95) > middle:
                continue
            points = self.image.X_WC.apply(self.points_C(labels == j)[::3])
            distance, _ = tree.query(points[:, :2], distance_upper_bound=0.01)
            share = float(np.isfinite(distance).mean())
            if share > best_share:
                best, best_share = j, share
        return best

    def _lines(self, labels: np.ndarray, k: int, other: int) -> bool:
        """Tell whether cluster k is the inner side of the other one: they meet, and at the same height they end."""
        from scipy.spatial import cKDTree

        tops = [float(np.percentile(self.height[labels == j], 98)) for j in (k, other)]
        if abs(tops[0] - tops[1]) > SAME_RIM:
            return False
        tree = cKDTree(self.points_C(labels == other))
        distance, _ = tree.query(self.points_C(labels == k)[::2])
        return bool(np.percentile(distance, 2) < RIM)

    def whole(self, mask: np.ndarray) -> np.ndarray:
        """Return a mask of this rectangle (h, w) as one of the whole image (H, W)."""
        pixels = np.zeros(self.image.depth.shape, dtype=bool)
        pixels[self.window] = mask
        return pixels


def _pairs(values: np.ndarray, down: int, right: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of all pixels that have a neighbour ``down`` rows and ``right`` columns on, and its."""
    height, width = values.shape
    first = values[: max(height - down, 0), max(0, -right) : width - max(0, right)]
    second = values[down:, max(0, right) : width + min(0, right)]
    return first, second
