"""Tracking of known objects: still in place, hidden, gone, or carried by the hand.

Whether an object is still in its place is decided from single pixels: what is measured where its points were? An
object that was between the jaws and whose place is empty now is in the hand, and moves as the hand does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from optsc.geometry import DepthImage, Pose
from optsc.geometry.rotation import Array
from optsc.perception.occlusion import view_is_clear
from optsc.perception.scene_state import Grip, KnownObject, SceneEvent, SceneEventKind, SceneState
from optsc.perception.segments import Segment
from optsc.perception.templates import Template
from optsc.robot import Gripper

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


class ExpectedVisibility(Enum):
    """What a view says about an object that is known."""

    THERE = "still there"
    HIDDEN = "hidden"
    GONE = "seen through"


def presence(known: KnownObject, image: DepthImage, robot_depth: Array) -> ExpectedVisibility:
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
        return ExpectedVisibility.HIDDEN
    expected, measured = _depths(_few(known.seen), image)
    judged = np.isfinite(measured)
    if judged.mean() < FEWEST:
        return ExpectedVisibility.HIDDEN
    farther = measured[judged] - expected[judged]
    if np.mean(farther > TOLERANCE) > SEEN_THROUGH:
        return ExpectedVisibility.GONE
    return ExpectedVisibility.HIDDEN if np.mean(farther < -TOLERANCE) > IN_FRONT else ExpectedVisibility.THERE


def presence_at(known: KnownObject, X_WO: Pose, image: DepthImage) -> ExpectedVisibility:
    """Return whether ``known`` may be at another pose, such as where the hand would have carried it.

    There: nothing speaks against it. Gone: the camera sees through most of it. Hidden: too little can be judged.
    """
    expected, measured = _depths(_few(X_WO.apply(known.cloud.points)), image)
    judged = np.isfinite(measured)
    if judged.mean() < FEWEST:
        return ExpectedVisibility.HIDDEN
    farther = measured[judged] - expected[judged]
    return ExpectedVisibility.GONE if np.mean(farther > CARRIED) > MOSTLY else ExpectedVisibility.THERE


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


LEAST = 0.002
"""Of an object between the jaws, at least this share of its points is [-]: a pad's print on a box of 15 cm."""


def share_between_jaws(points_T: np.ndarray, gripper: Gripper) -> float:
    """Return the share of points (N, 3) in T that lie between the open jaws, from the palm to the finger tips."""
    half = 0.5 * np.array([gripper.pad_size[0], gripper.max_opening])
    palm, tips = float(gripper.body[:, 1, 2].max()), float(gripper.finger[:, 1, 2].max())
    beside = np.all(np.abs(points_T[:, :2]) <= half, axis=1)
    inside = beside & (points_T[:, 2] >= palm) & (points_T[:, 2] <= tips)
    return float(np.mean(inside)) if len(points_T) else 0.0


def with_grips(
    memory: SceneState, found: Mapping[str, ExpectedVisibility], X_WT: Pose, gripper: Gripper
) -> SceneState:
    """Return the memory in which what is between the jaws is noted, at the hand's deepest reach for it.

    Later the hand may have carried it away unseen. What is seen where it was is in no hand.
    """
    grips = {
        name: grip for name, grip in memory.grips.items() if found.get(name) is not ExpectedVisibility.THERE
    }
    for name, state in found.items():
        if state is not ExpectedVisibility.HIDDEN:
            continue
        X_TO = X_WT.inverse() @ memory.objects[name].X_WO
        share = share_between_jaws(X_TO.apply(memory.objects[name].cloud.points), gripper)
        if share >= LEAST and (name not in grips or share >= grips[name].share):
            grips[name] = Grip(X_TO, share)
    return replace(memory, grips=grips)


class TrackingResult(NamedTuple):
    """What the hand has to do with what is known.

    Attributes:
        memory: with what it has taken.
        lost: names of objects that are neither in their place nor in the hand.
        unsure: names of objects that the hand took, where it cannot be seen whether it still has them.
        events: what it has taken just now.
    """

    memory: SceneState
    lost: frozenset[str]
    unsure: frozenset[str]
    events: tuple[SceneEvent, ...]


def hand(memory: SceneState, gone: frozenset[str], X_WT: Pose, image: DepthImage) -> TrackingResult:
    """Return what the hand has taken, and what is lost then.

    Args:
        memory: with grips.
        gone: names of objects whose place is seen to be empty.
        X_WT: pose of the tool.
        image: what is measured.
    """
    events: list[SceneEvent] = []
    lost, unsure = set(gone), set()
    for name in sorted(memory.held | (gone & memory.grips.keys())):
        X_WO = X_WT @ memory.grips[name].X_TO
        there = presence_at(memory.objects[name], X_WO, image)
        if there is ExpectedVisibility.GONE:
            lost.add(name)
            continue
        if there is ExpectedVisibility.HIDDEN:
            unsure.add(name)
        if name not in memory.held:
            events.append(
                SceneEvent(SceneEventKind.TAKEN, name, "its place is empty, and it was between the jaws")
            )
        memory = memory.with_held(name, X_WO)
        lost.discard(name)
    return TrackingResult(memory, frozenset(lost), frozenset(unsure), tuple(events))
