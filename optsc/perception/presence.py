"""Is an object still where it was seen? From single pixels: what is measured where its points were?"""

from __future__ import annotations

from enum import Enum

import numpy as np

from optsc.geometry import DepthImage, Pose
from optsc.geometry.rotation import Array
from optsc.perception.memory import KnownObject
from optsc.perception.occlusion import view_is_clear
from optsc.perception.segments import Segment
from optsc.perception.templates import Template

TOLERANCE = 0.006
"""A pixel still shows the object where the depth differs by less [m]: the camera's noise, and motion that matters."""
SEEN_THROUGH = 0.15
"""An object is gone where the camera sees through more than this share of its points [-]."""
IN_FRONT = 0.15
"""It is hidden where something stands in front of more than this share of them [-]."""
FEWEST = 0.3
"""Where fewer than this share of its points can be judged, the view says nothing [-]."""
CARRIED = 0.02
"""How far what is in the hand may be from where the hand's motion has taken it [m]: jaws shift what they close on."""
MOSTLY = 0.5
"""It is not in the hand where the camera sees through more than this share of its points [-]."""
ON_IT = 0.010
"""A point belongs to a known object that is this close [m]."""
POINTS = 600
"""Points that are looked up at most."""


class Presence(Enum):
    """What a view says about an object that is known."""

    THERE = "still there"
    HIDDEN = "hidden"
    GONE = "seen through"


def presence(known: KnownObject, image: DepthImage, robot_depth: Array) -> Presence:
    """Return whether ``known`` is where it was seen last, as far as ``image`` tells.

    Hidden comes first: an object that the arm is in front of, or close beside in the image, is not judged at all.

    Args:
        known: with the points that were seen of it.
        image: what is measured now, from the same place.
        robot_depth: of the arm now (H, W) [m], see `optsc.perception.robot_depth`.

    Raises:
        InvalidValue: images of different sizes.
    """
    if not view_is_clear(known.pixels, robot_depth, known.image).clear:
        return Presence.HIDDEN
    expected, measured = _depths(_few(known.seen), image)
    judged = np.isfinite(measured)
    if judged.mean() < FEWEST:
        return Presence.HIDDEN
    farther = measured[judged] - expected[judged]
    if np.mean(farther > TOLERANCE) > SEEN_THROUGH:
        return Presence.GONE
    return Presence.HIDDEN if np.mean(farther < -TOLERANCE) > IN_FRONT else Presence.THERE


def presence_at(known: KnownObject, X_WO: Pose, image: DepthImage) -> Presence:
    """Return whether ``known`` may be at another pose, such as where the hand would have carried it.

    There: nothing speaks against it. Gone: the camera sees through most of it. Hidden: too little can be judged.
    """
    expected, measured = _depths(_few(X_WO.apply(known.cloud.points)), image)
    judged = np.isfinite(measured)
    if judged.mean() < FEWEST:
        return Presence.HIDDEN
    farther = measured[judged] - expected[judged]
    return Presence.GONE if np.mean(farther > CARRIED) > MOSTLY else Presence.THERE


def share_shown(
    segment: Segment, image: DepthImage, known: KnownObject, template: Template | None, *, moved: bool
) -> float:
    """Return the share of a segment's points that show an object.

    Those at pixels and depths where it was seen before, if it has not ``moved``, or those on its surface: more of
    it may have come into view.
    """
    points = segment.cloud.points
    if len(points) == 0:
        return 0.0
    same = 0.0
    if not moved:
        depth_error = np.abs(image.depth - known.image.depth)[segment.pixels & known.pixels]
        same = float(np.sum(depth_error < ON_IT)) / int(segment.pixels.sum())
    if template is None:
        from scipy.spatial import cKDTree

        near, _ = cKDTree(known.cloud.points).query(known.X_WO.inverse().apply(_few(points)))
        return max(same, float(np.mean(near < ON_IT)))
    explained = [
        np.mean(np.abs(template.field.lookup(X.inverse().apply(_few(points)))[0]) < ON_IT)
        for name, X in known.explanations
        if name == template.name
    ]
    return max(same, *map(float, explained))


def _few(points: Array) -> Array:
    return points[:: max(1, len(points) // POINTS)]


def _depths(points: Array, image: DepthImage) -> tuple[Array, Array]:
    """Return the depths of points (N, 3) in W, and what is measured there (N,), NaN outside and where nothing is."""
    u, v, z = image.camera.project(image.X_WC.inverse().apply(points))
    height, width = image.depth.shape
    measured = np.full(len(points), np.nan)
    inside = (z > 0.0) & (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    rows, columns = np.rint(v[inside]).astype(int), np.rint(u[inside]).astype(int)
    measured[inside] = image.depth[rows, columns]
    return z, measured
