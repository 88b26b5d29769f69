"""Which poses are sound grasps: reachable in a straight line, and held by enough of both pads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps.clearance import approach_boxes, closing_boxes, in_tool_frame, lowest_point, touched
from optsc.grasps.contacts import DENT, PadContacts, pad_contacts
from optsc.grasps.proposals import cone_cosine
from optsc.grasps.settings import AntipodalSettings
from optsc.grasps.surface import Surface
from optsc.robot.gripper import Gripper

_COARSE = 8  # the first look is at every eighth point
_CHUNK = 150_000  # points in tool frames worked on at once: they stay in the processor's cache
_CENTRED = 0.001  # [m] between the middle of the jaws and the middle of what they meet first
_ROOM = 0.015  # [m] on either side of the object that earns full marks
_COVERED = 0.5  # share of a pad that earns full marks


class Workpiece(NamedTuple):
    """An object that stands on the plane z = 0 of its frame, the gripper, and what is asked of a grasp."""

    surface: Surface
    centre_of_mass: Array
    gripper: Gripper
    settings: AntipodalSettings


class Sound(NamedTuple):
    """The poses that passed all checks."""

    X_OG: Pose
    width: Array
    """Distance between the pads when they hold the object (K,) [m]."""
    quality: Array
    """(K,) in [0, 1]."""


def sound_grasps(work: Workpiece, X_OG: Pose, funnel: Counter[str]) -> Sound:
    """Return those of the poses X_OG that are sound; ``funnel`` counts how many are left after each check.

    The cheap checks come first, then a look at a few surface points, then all checks at all points.
    """
    coarse, settings = work.surface.every(_COARSE), work.settings
    checks: tuple[tuple[str, Callable[[Pose], np.ndarray]], ...] = (
        ("antipodal", lambda X: np.ones(len(X), dtype=bool)),
        ("comes from above", lambda X: -X.rotation_matrix()[:, 2, 2] >= np.sin(settings.lowest_elevation)),
        ("clear of the table", lambda X: _above_table(work, X)),
        ("small lever", lambda X: lever(X, work.centre_of_mass) <= settings.max_lever),
        ("no obvious collision", lambda X: _reachable(work, X, coarse)),
    )
    for name, passes in checks:
        X_OG = X_OG[passes(X_OG)]
        funnel[name] += len(X_OG)
    step = max(1, _CHUNK // len(work.surface.points))
    # One empty chunk at the least, so that there is something to concatenate.
    chunks = [
        _check_at_all_points(work, X_OG[i : i + step], funnel) for i in range(0, max(len(X_OG), 1), step)
    ]
    return concatenate(chunks)


def concatenate(parts: list[Sound]) -> Sound:
    """Return all the poses of ``parts``, at least one, in one."""
    X_OG, width, quality = zip(*parts, strict=True)
    return Sound(Pose.concatenate(X_OG), np.concatenate(width), np.concatenate(quality))


def grasp_quality(
    alignment: Array, coverage: Array, lever: Array, spare: Array, settings: AntipodalSettings
) -> Array:
    """Return (a b c d)^(1/4), in [0, 1], higher is better; each factor is clipped to [0, 1].

    a: how far inside the friction cone the normals are, (alignment - k) / (1 - k) with the cone's cosine k.
    b: share of a pad's area that carries load, coverage / 0.5.
    c: what gravity leaves of the hold, 1 - lever / (2 max_lever).
    d: room between an open jaw and the object, (spare / 2) / 15 mm.

    Args:
        alignment: cosine between closing axis and normal (...).
        coverage: share of the pad that carries load (...).
        lever: of gravity about the closing axis (...) [m].
        spare: opening of the open jaws less the object's width (...) [m].
        settings: friction and the lever that is still allowed.
    """
    cone = cone_cosine(settings.friction)
    factors = [
        (alignment - cone) / (1.0 - cone),
        coverage / _COVERED,
        1.0 - lever / (2.0 * settings.max_lever),
        0.5 * spare / _ROOM,
    ]
    return np.prod(np.clip(factors, 0.0, 1.0), axis=0) ** 0.25


def lever(X_OG: Pose, centre_of_mass: Array) -> Array:
    """Return the lever (K,) [m] with which gravity turns an upright object about the closing axis."""
    arm, closing = centre_of_mass - X_OG.translation, X_OG.rotation_matrix()[:, :, 1]
    return np.abs(arm[:, 0] * closing[:, 1] - arm[:, 1] * closing[:, 0])  # (arm x z) . closing


def _check_at_all_points(work: Workpiece, X_OG: Pose, funnel: Counter[str]) -> Sound:
    settings, gripper, margin = work.settings, work.gripper, work.settings.clearance
    points_T = in_tool_frame(X_OG, work.surface.points)
    pads = pad_contacts(points_T, work.surface, X_OG, gripper, settings.friction)
    left = _narrow(funnel, {
        "meets the two contacts first": (abs(pads.offset) <= _CENTRED) & (pads.width > 0.0),
        "fits between the jaws": pads.width <= gripper.max_opening - 2 * margin,
        "enough of the pads loaded": pads.coverage >= settings.min_coverage,
        "pads lie flat": pads.alignment >= settings.min_alignment,
        "load near the pads' middle": pads.eccentricity <= settings.max_eccentricity,
    })  # fmt: skip
    X_OG, points_T = X_OG[left], points_T[:, left]
    pads = PadContacts(*(values[left] for values in pads))
    jaws_way = closing_boxes(gripper, pads.width + 2 * DENT)
    left = _narrow(funnel, {
        "way in is free": ~touched(points_T, approach_boxes(gripper, settings.standoff), (margin,) * 3),
        "closing is free": ~touched(points_T, jaws_way, (DENT, 0.0, DENT)),
    })  # fmt: skip
    spare, arm = gripper.max_opening - pads.width, lever(X_OG, work.centre_of_mass)
    quality = grasp_quality(pads.alignment, pads.coverage, arm, spare, settings)
    return Sound(X_OG[left], pads.width[left].astype(float), quality[left])


def _narrow(funnel: Counter[str], checks: dict[str, np.ndarray]) -> np.ndarray:
    """Return the indices of what passes all checks, counting how many are left after each."""
    left = np.ones(len(next(iter(checks.values()))), dtype=bool)
    for name, passes in checks.items():
        left &= passes
        funnel[name] += int(left.sum())
    return np.nonzero(left)[0]


def _reachable(work: Workpiece, X_OG: Pose, surface: Surface) -> np.ndarray:
    boxes, margin = approach_boxes(work.gripper, work.settings.standoff), work.settings.clearance
    step = max(1, _CHUNK // len(surface.points))
    free = [
        ~touched(in_tool_frame(X_OG[i : i + step], surface.points), boxes, (margin,) * 3)
        for i in range(0, len(X_OG), step)
    ]
    return np.concatenate([np.zeros(0, dtype=bool), *free])


def _above_table(work: Workpiece, X_OG: Pose) -> np.ndarray:
    boxes = approach_boxes(work.gripper, work.settings.standoff)
    return lowest_point(X_OG, boxes) >= work.settings.table_clearance
