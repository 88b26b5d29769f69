"""Feasibility of grasps: the approach is free in a straight line, and enough of both pads carries load."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.robot.gripper import Gripper
from optsc.sampling.contacts import (
    DENT,
    PadContacts,
    approach_boxes,
    closing_boxes,
    collides,
    in_tool_frame,
    lowest_point,
    pad_contacts,
)
from optsc.sampling.settings import AntipodalSettings
from optsc.sampling.surface import SurfacePoints

_COARSE = (64, 8)  # the first collision checks take every so many points
_CHUNK = 150_000  # points in tool frames worked on at once: they stay in the processor's cache
_CENTRED = 0.001  # [m] between the middle of the jaws and the middle of what they meet first

Funnel = Counter[str]
"""How many poses are left after each check, in the order of the checks."""
Witness = dict[str, list[Pose]]
"""The poses that are left after each check, as they come."""


class Workpiece(NamedTuple):
    """An object with its surroundings in its frame, z up, the gripper, and what is asked of a grasp."""

    surface: SurfacePoints
    centre_of_mass: Array
    gripper: Gripper
    settings: AntipodalSettings
    support: float | None = 0.0
    """Height of the table in the object's frame [m]; None where there is none."""
    obstacles: Array = np.zeros((0, 3))
    """Points of whatever stands around (M, 3) [m]."""


class FeasibleGrasps(NamedTuple):
    """The poses that passed all checks."""

    X_OG: Pose
    contacts: PadContacts
    """Of each of them."""

    def select(self, index: np.ndarray) -> FeasibleGrasps:
        """Return some of them."""
        return FeasibleGrasps(self.X_OG[index], PadContacts(*(values[index] for values in self.contacts)))


class Tally:
    """Counts what is left after each check, and keeps it where asked to."""

    def __init__(self, keep: bool = False) -> None:
        self.funnel: Funnel = Counter()
        self.poses: Witness | None = {} if keep else None

    def note(self, check: str, X_OG: Pose) -> None:
        """Add poses that are left after a check."""
        self.funnel[check] += len(X_OG)
        if self.poses is not None:
            self.poses.setdefault(check, []).append(X_OG)

    def moved(self, X_NO: Pose) -> Tally:
        """Return the same tally with its poses in another frame N, given the old frame's pose in it."""
        tally = Tally()
        tally.funnel = self.funnel
        if self.poses is not None:
            tally.poses = {check: [X_NO @ X_OG for X_OG in poses] for check, poses in self.poses.items()}
        return tally

    def add(self, other: Tally) -> None:
        """Take over what another tally noted."""
        self.funnel.update(other.funnel)
        if self.poses is not None:
            for check, poses in (other.poses or {}).items():
                self.poses.setdefault(check, []).extend(poses)


def feasible_grasps(work: Workpiece, X_OG: Pose, tally: Tally) -> FeasibleGrasps:
    """Return those of the poses X_OG that are feasible; ``tally`` notes what is left after each check.

    The cheap checks come first, then collisions with a few surface points, then all checks at all points.
    """
    settings, points = work.settings, work.surface.points
    checks: tuple[tuple[str, Callable[[Pose], np.ndarray]], ...] = (
        ("antipodal", lambda X: np.ones(len(X), dtype=bool)),
        ("comes from above", lambda X: _from_above(work, X)),
        ("clear of the table", lambda X: _above_table(work, X)),
        ("small lever", lambda X: lever(X, work.centre_of_mass) <= settings.max_lever),
        ("clear of the neighbours", lambda X: _free(work, X, work.obstacles)),
        ("no gross collision", lambda X: _free(work, X, points[:: _COARSE[0]])),
        ("no obvious collision", lambda X: _free(work, X, points[:: _COARSE[1]])),
    )
    for name, passes in checks:
        X_OG = X_OG[passes(X_OG)]
        tally.note(name, X_OG)
    step = max(1, _CHUNK // len(work.surface.points))
    # One empty chunk at the least, so that there is something to concatenate.
    chunks = [_check_at_all_points(work, X_OG[i : i + step], tally) for i in range(0, max(len(X_OG), 1), step)]
    return concatenate(chunks)


def concatenate(parts: list[FeasibleGrasps]) -> FeasibleGrasps:
    """Return all the poses of ``parts``, at least one, in one."""
    contacts = zip(*(part.contacts for part in parts), strict=True)
    return FeasibleGrasps(
        Pose.concatenate([part.X_OG for part in parts]),
        PadContacts(*(np.concatenate(values) for values in contacts)),
    )


def lever(X_OG: Pose, centre_of_mass: Array) -> Array:
    """Return the lever (K,) [m] with which gravity turns an upright object about the closing axis."""
    arm, closing = centre_of_mass - X_OG.translation, X_OG.rotation_matrix()[:, :, 1]
    return np.abs(arm[:, 0] * closing[:, 1] - arm[:, 1] * closing[:, 0])  # (arm x z) . closing


def dent(settings: AntipodalSettings) -> float:
    """Return the depth [m] within which measured points carry load: the rubber's and twice their error."""
    return DENT + 2.0 * settings.noise


def _check_at_all_points(work: Workpiece, X_OG: Pose, tally: Tally) -> FeasibleGrasps:
    settings, gripper, margin = work.settings, work.gripper, work.settings.clearance
    deep, centred = dent(settings), _CENTRED + 2.0 * settings.noise
    points_T = in_tool_frame(X_OG, work.surface.points)
    pads = pad_contacts(points_T, work.surface, X_OG, gripper, settings.friction, deep)
    left = _narrow(tally, X_OG, {
        "meets the two contacts first": (abs(pads.offset) <= centred) & (pads.width > 0.0),
        "fits between the jaws": pads.width <= gripper.max_opening - 2 * margin,
        "enough of the pads loaded": pads.coverage >= settings.min_coverage,
        "pads lie flat": pads.alignment >= settings.min_alignment,
        "load near the pads' middle": pads.eccentricity <= settings.max_eccentricity,
    })  # fmt: skip
    X_OG, points_T = X_OG[left], points_T[:, left]
    pads = PadContacts(*(values[left] for values in pads))
    closing = closing_boxes(gripper, np.minimum(pads.width + 2 * deep, gripper.max_opening))
    left = _narrow(tally, X_OG, {
        "way in is free": ~collides(points_T, approach_boxes(gripper, settings.standoff), (margin,) * 3),
        "closing is free": ~collides(points_T, closing, (DENT, 0.0, DENT)),
    })  # fmt: skip
    return FeasibleGrasps(X_OG, pads).select(left)


def _narrow(tally: Tally, X_OG: Pose, checks: dict[str, np.ndarray]) -> np.ndarray:
    """Return the indices of what passes all checks, noting what is left after each."""
    left = np.ones(len(X_OG), dtype=bool)
    for name, passes in checks.items():
        left &= passes
        tally.note(name, X_OG[left])
    return np.nonzero(left)[0]


def _free(work: Workpiece, X_OG: Pose, points: Array) -> np.ndarray:
    """Tell whether the approach of each pose (K,) is free of points (N, 3)."""
    if len(points) == 0:
        return np.ones(len(X_OG), dtype=bool)
    boxes, margin = approach_boxes(work.gripper, work.settings.standoff), work.settings.clearance
    step = max(1, _CHUNK // len(points))
    free = [
        ~collides(in_tool_frame(X_OG[i : i + step], points), boxes, (margin,) * 3) for i in range(0, len(X_OG), step)
    ]
    return np.concatenate([np.zeros(0, dtype=bool), *free])


def _from_above(work: Workpiece, X_OG: Pose) -> np.ndarray:
    if work.support is None:
        return np.ones(len(X_OG), dtype=bool)
    return -X_OG.rotation_matrix()[:, 2, 2] >= np.sin(work.settings.lowest_elevation)


def _above_table(work: Workpiece, X_OG: Pose) -> np.ndarray:
    if work.support is None:
        return np.ones(len(X_OG), dtype=bool)
    boxes = approach_boxes(work.gripper, work.settings.standoff)
    return lowest_point(X_OG, boxes) >= work.support + work.settings.table_clearance
