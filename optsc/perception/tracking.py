"""Tracking of known objects: visible where expected, hidden, moved away, or carried by the hand.

Whether an object is where it is expected is decided from single pixels: what is measured where its points were? An
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
from optsc.perception.known_objects import KnownObject
from optsc.perception.occlusion import view_is_clear
from optsc.perception.scene_registration import Observation
from optsc.perception.scene_state import Grip, SceneEvent, SceneEventKind, SceneState
from optsc.perception.segments import Segment
from optsc.perception.templates import Template
from optsc.robot import Gripper

TOLERANCE = 0.006
"""A pixel still shows the object where the depth differs by less [m]: the camera's noise, and motion that matters."""
SEEN_THROUGH = 0.15
"""The place of an object is empty where the camera sees through more than this share of its points [-]."""
IN_FRONT = 0.15
"""It is hidden where something stands in front of more than this share of them [-]."""
FEWEST = 0.3
"""Where fewer than this share of its points can be judged, the view says nothing [-]."""
CARRIED = 0.02
"""How far an object in the hand may be from where the hand's motion takes it [m]: jaws shift what they close on."""
MOSTLY = 0.5
"""It is not in the hand where the camera sees through more than this share of its points [-]."""
ON_IT = 0.010
"""A point belongs to a known object that is this close [m]."""
POINTS = 600
"""Points that are looked up at most."""
LEAST = 0.002
"""Of an object between the jaws, at least this share of its points is [-]: a pad's print on a box of 15 cm."""


class ExpectedVisibility(Enum):
    """What a view says about an object that is expected at a pose."""

    VISIBLE = "seen where it is expected"
    HIDDEN = "hidden, or too little can be judged"
    SEEN_THROUGH = "seen through: it is not there"


class TrackingResult(NamedTuple):
    """What is left of a scene state where it is compared with an image.

    Attributes:
        state: with what the hand has taken.
        lost: names of objects that are neither in their place nor in the hand.
        unsure: names of objects that the hand took, where it cannot be seen whether it still has them.
        events: what the hand has taken just now.
    """

    state: SceneState
    lost: frozenset[str]
    unsure: frozenset[str]
    events: tuple[SceneEvent, ...]


def track(state: SceneState, observation: Observation, X_WT: Pose, gripper: Gripper) -> TrackingResult:
    """Return what is left of ``state`` in an observation, and what the hand has taken.

    Args:
        X_WT: pose of the tool now.
    """
    image = observation.image
    found = {
        name: visibility_in_place(known, image, observation.robot_depth)
        for name, known in state.objects.items()
        if name not in state.held
    }
    # Of an object that is still there only the time changes: pose, points and grasps stay those of its observation.
    objects = {
        name: replace(known, stamp=image.stamp) if found.get(name) is ExpectedVisibility.VISIBLE else known
        for name, known in state.objects.items()
    }
    state = _with_grips(replace(state, objects=objects), found, X_WT, gripper)
    empty = frozenset(name for name, seen in found.items() if seen is ExpectedVisibility.SEEN_THROUGH)
    return _with_carried(state, empty, X_WT, image)


def visibility_in_place(known: KnownObject, image: DepthImage, robot_depth: Array) -> ExpectedVisibility:
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
    farther = _farther(known.seen, image)
    if farther is None:
        return ExpectedVisibility.HIDDEN
    if np.mean(farther > TOLERANCE) > SEEN_THROUGH:
        return ExpectedVisibility.SEEN_THROUGH
    in_front = np.mean(farther < -TOLERANCE) > IN_FRONT
    return ExpectedVisibility.HIDDEN if in_front else ExpectedVisibility.VISIBLE


def visibility_at(known: KnownObject, X_WO: Pose, image: DepthImage) -> ExpectedVisibility:
    """Return whether ``known`` may be at another pose, such as where the hand would have carried it.

    Visible: nothing speaks against it. Seen through: most of it is. Hidden: too little can be judged.
    """
    farther = _farther(X_WO.apply(known.cloud.points), image)
    if farther is None:
        return ExpectedVisibility.HIDDEN
    through = np.mean(farther > CARRIED) > MOSTLY
    return ExpectedVisibility.SEEN_THROUGH if through else ExpectedVisibility.VISIBLE


def explained_share(
    segment: Segment, image: DepthImage, known: KnownObject, template: Template | None, *, moved: bool
) -> float:
    """Return the share of a segment's points that a known object explains.

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


def share_between_jaws(points_T: np.ndarray, gripper: Gripper) -> float:
    """Return the share of points (N, 3) in T that lie between the open jaws, from the palm to the finger tips."""
    half = 0.5 * np.array([gripper.pad_size[0], gripper.max_opening])
    palm, tips = float(gripper.body[:, 1, 2].max()), float(gripper.finger[:, 1, 2].max())
    beside = np.all(np.abs(points_T[:, :2]) <= half, axis=1)
    inside = beside & (points_T[:, 2] >= palm) & (points_T[:, 2] <= tips)
    return float(np.mean(inside)) if len(points_T) else 0.0


def _with_grips(state: SceneState, found: Mapping[str, ExpectedVisibility], X_WT: Pose, gripper: Gripper) -> SceneState:
    """Return the state in which what is between the jaws is noted, at the hand's deepest reach for it.

    Later the hand may have carried it away unseen. What is seen where it was is in no hand.
    """
    grips = {n: grip for n, grip in state.grips.items() if found.get(n) is not ExpectedVisibility.VISIBLE}
    for name, seen in found.items():
        if seen is not ExpectedVisibility.HIDDEN:
            continue
        X_TO = X_WT.inverse() @ state.objects[name].X_WO
        share = share_between_jaws(X_TO.apply(state.objects[name].cloud.points), gripper)
        if share >= LEAST and (name not in grips or share >= grips[name].share):
            grips[name] = Grip(X_TO, share)
    return replace(state, grips=grips)


def _with_carried(state: SceneState, empty: frozenset[str], X_WT: Pose, image: DepthImage) -> TrackingResult:
    """Return what the hand carries, of the objects whose place is seen to be ``empty``, and what is lost."""
    events: list[SceneEvent] = []
    lost, unsure = set(empty), set()
    for name in sorted(state.held | (empty & state.grips.keys())):
        X_WO = X_WT @ state.grips[name].X_TO
        seen = visibility_at(state.objects[name], X_WO, image)
        if seen is ExpectedVisibility.SEEN_THROUGH:
            lost.add(name)
            continue
        if seen is ExpectedVisibility.HIDDEN:
            unsure.add(name)
        if name not in state.held:
            words = "its place is empty, and it was between the jaws"
            events.append(SceneEvent(SceneEventKind.TAKEN, name, words))
        state = state.with_held(name, X_WO)
        lost.discard(name)
    return TrackingResult(state, frozenset(lost), frozenset(unsure), tuple(events))


def _few(points: Array) -> Array:
    return points[:: max(1, len(points) // POINTS)]


def _farther(points: Array, image: DepthImage) -> Array | None:
    """Return by how much what is measured is farther away than points (N, 3) in W [m], where something is measured.

    None where too few of the points can be judged: most are outside the image, or nothing was measured there.
    """
    u, v, z = image.camera.project(image.X_WC.inverse().apply(_few(points)))
    height, width = image.depth.shape
    measured = np.full(len(z), np.nan)
    inside = (z > 0.0) & (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    rows, columns = np.rint(v[inside]).astype(int), np.rint(u[inside]).astype(int)
    measured[inside] = image.depth[rows, columns]
    judged = np.isfinite(measured)
    return None if judged.mean() < FEWEST else measured[judged] - z[judged]
