"""Antipodal sampling: two opposite contacts, a free way in, and enough pad on the object.

The idea follows V.-D. Nguyen, "Constructing force-closure grasps", 1988: two soft contacts hold an object
when the line between them lies in both friction cones.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from importlib import metadata
from typing import NamedTuple

import numpy as np

from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.geometry.rotation import Array
from optsc.grasps.clearance import approach_boxes, closing_boxes, in_tool_frame, lowest_point, touched
from optsc.grasps.contacts import DENT, pad_contacts
from optsc.grasps.grasp_set import GraspSet
from optsc.grasps.identity import METHOD, gripper_fingerprint
from optsc.grasps.rays import exits
from optsc.grasps.settings import AntipodalSettings
from optsc.grasps.spread import spread_out
from optsc.grasps.surface import Surface, centre_of_mass, sample_surface
from optsc.robot.gripper import Gripper

Progress = Callable[[str, int, int], None]
"""Called with the object's name, the steps done and the steps in all."""

DEFAULTS = AntipodalSettings()

_POINTS_PER_ROUND = 300
_ANGLES = 8  # approach directions per pair of contacts, evenly about the closing axis
_DEPTH = 0.25  # the contacts lie within this share of the pad's length from its middle
_COARSE = 8  # the first look is at every eighth point
_CHUNK = 1_500_000  # points in tool frames held in memory at once
_CENTRED = 0.001  # [m] between the middle of the jaws and the middle of what they meet first


class _Task(NamedTuple):
    """What stays the same while one object is sampled."""

    mesh: TriangleMesh
    surface: Surface
    centre_of_mass: Array
    gripper: Gripper
    settings: AntipodalSettings
    funnel: Counter[str]


class _Pool(NamedTuple):
    X_OG: Pose
    opening: Array
    quality: Array


def sample_grasps(
    mesh: TriangleMesh,
    gripper: Gripper,
    *,
    name: str,
    seed: int,
    settings: AntipodalSettings = DEFAULTS,
    progress: Progress | None = None,
) -> GraspSet:
    """Return ``settings.count`` grasps of an object that stands on the plane z = 0 of its frame.

    Every grasp has: both contacts in the friction cone; pads that lie flat on the object; a straight approach
    with fully open jaws that touches neither object nor table; jaws that on closing meet nothing else first.
    They are spread over positions and directions, with no grasp twice (a half turn of symmetric jaws is the
    same grasp). Where fewer are found, ``provenance["reason"]`` says why.

    The quality is the geometric mean of four numbers in [0, 1], see `grasp_quality`.
    The same mesh, gripper, seed and settings give the same grasps.
    """
    rng = np.random.default_rng(seed)
    task = _Task(mesh, sample_surface(mesh, settings.spacing, rng), centre_of_mass(mesh), gripper, settings, Counter())
    wanted, pools, found = settings.pool * settings.count, [], 0
    for _ in range(settings.max_rounds):
        pool = _sound(task, _proposals(task, rng))
        pools.append(pool)
        found += len(pool.X_OG)
        if progress is not None:
            progress(name, min(found, wanted), wanted)
        if found >= wanted:
            break
    poses = Pose.concatenate([p.X_OG for p in pools])
    opening, quality = (np.concatenate([getattr(p, field) for p in pools]) for field in ("opening", "quality"))
    chosen = spread_out(poses, quality, settings.count, gripper.jaw_symmetric)
    return GraspSet(
        object_name=name,
        object_hash=mesh.hash,
        gripper=gripper.name,
        X_OG=poses[chosen],
        opening=opening[chosen],
        quality=quality[chosen],
        provenance=_provenance(task, seed, len(chosen)),
        jaw_symmetric=gripper.jaw_symmetric,
    )


def grasp_quality(alignment: Array, coverage: Array, lever: Array, spare: Array, settings: AntipodalSettings) -> Array:
    """Return (a b c d)^(1/4), in [0, 1], higher is better.

    a: how far inside the friction cone the contacts are, (cosine - cosine of the cone) / (1 - cosine of the cone).
    b: share of a pad's area that carries load, full marks from one half on.
    c: 1 - lever / (2 max_lever): what gravity leaves of the hold.
    d: room between the open jaws and the object on either side, full marks from 15 mm on.
    """
    edge = 1.0 / np.hypot(1.0, settings.friction)
    terms = [
        (alignment - edge) / (1.0 - edge),
        2.0 * coverage,
        1.0 - 0.5 * lever / max(settings.max_lever, 1e-9),
        0.5 * spare / 0.015,
    ]
    return np.prod(np.clip(terms, 0.0, 1.0), axis=0) ** 0.25


def _proposals(task: _Task, rng: np.random.Generator) -> Pose:
    """Return tool poses (K,) whose jaws close on two opposite points, with cheap reasons against them checked."""
    settings, gripper = task.settings, task.gripper
    points, normals = task.mesh.sample(rng, _POINTS_PER_ROUND)
    directions = _within_cone(-normals, np.arctan(settings.friction), rng)
    ray, width, far_normals = exits(task.mesh, points, directions, gripper.max_opening - 2 * settings.clearance)
    antipodal = np.einsum("ci,ci->c", far_normals, directions[ray]) >= 1.0 / np.hypot(1.0, settings.friction)
    ray, width = ray[antipodal], width[antipodal]
    y = np.repeat(directions[ray], _ANGLES, axis=0)
    middle = np.repeat(points[ray] + 0.5 * width[:, None] * directions[ray], _ANGLES, axis=0)
    angle = 2 * np.pi * (np.tile(np.arange(_ANGLES), len(ray)) + np.repeat(rng.random(len(ray)), _ANGLES)) / _ANGLES
    u, v = _perpendiculars(y)
    z = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
    depth = _DEPTH * gripper.pad_size[1] * rng.uniform(-1.0, 1.0, len(z))
    X_OG = Pose(
        rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=-1).reshape(-1, 3, 3)), middle + depth[:, None] * z
    )
    return _narrow(task, X_OG, "antipodal pairs", [
        ("comes from above", lambda X: -X.rotation_matrix()[:, 2, 2] >= np.sin(settings.lowest_elevation)),
        ("clear of the table", lambda X: _above_table(task, X)),
        ("small lever", lambda X: _lever(task, X) <= settings.max_lever),
    ])  # fmt: skip


def _narrow(task: _Task, X_OG: Pose, start: str, checks: list[tuple[str, Callable[[Pose], np.ndarray]]]) -> Pose:
    """Return the poses that pass all checks, counting how many are left after each."""
    task.funnel[start] += len(X_OG)
    for reason, passes in checks:
        X_OG = X_OG[passes(X_OG)]
        task.funnel[reason] += len(X_OG)
    return X_OG


def _sound(task: _Task, X_OG: Pose) -> _Pool:
    """Return those of the proposals that can be reached and that hold."""
    settings, surface = task.settings, task.surface
    coarse = surface.every(_COARSE)
    X_OG = _narrow(task, X_OG, "proposals", [("no obvious collision", lambda X: _reachable(task, X, coarse))])
    step = max(1, _CHUNK // len(surface.points))
    # One empty chunk at the least, so that there is something to concatenate.
    chunks = [_sound_chunk(task, X_OG[i : i + step]) for i in range(0, max(len(X_OG), 1), step)]
    pose, width, quality = zip(*chunks, strict=True)
    task.funnel["sound"] += sum(map(len, pose))
    return _Pool(Pose.concatenate(pose), np.concatenate(width), np.concatenate(quality))


def _sound_chunk(task: _Task, X_OG: Pose) -> _Pool:
    settings, gripper, margin = task.settings, task.gripper, task.settings.clearance
    points_T = in_tool_frame(X_OG, task.surface.points)
    pads = pad_contacts(points_T, task.surface, X_OG, gripper, settings.friction)
    checks = {
        "meets the two contacts first": (abs(pads.offset) <= _CENTRED) & (pads.width > 0.0),
        "fits between the jaws": pads.width <= gripper.max_opening - 2 * margin,
        "pads lie flat": (pads.coverage >= settings.min_coverage) & (pads.alignment >= settings.min_alignment),
        "load near the pads' middle": pads.eccentricity <= settings.max_eccentricity,
        "way in is free": ~touched(points_T, approach_boxes(gripper, settings.standoff), (margin,) * 3),
        "closing is free": ~touched(points_T, closing_boxes(gripper, pads.width + 2 * DENT), (DENT, 0.0, DENT)),
    }
    sound = np.ones(len(X_OG), dtype=bool)
    for reason, passes in checks.items():
        sound &= passes
        task.funnel[reason] += int(sound.sum())
    spare = gripper.max_opening - pads.width
    quality = grasp_quality(pads.alignment, pads.coverage, _lever(task, X_OG), spare, settings)
    return _Pool(X_OG[sound], pads.width[sound].astype(float), quality[sound])


def _reachable(task: _Task, X_OG: Pose, surface: Surface) -> np.ndarray:
    boxes, margin = approach_boxes(task.gripper, task.settings.standoff), task.settings.clearance
    step = max(1, _CHUNK // len(surface.points))
    parts = [
        ~touched(in_tool_frame(X_OG[i : i + step], surface.points), boxes, (margin,) * 3)
        for i in range(0, len(X_OG), step)
    ]
    return np.concatenate([np.zeros(0, dtype=bool), *parts])


def _above_table(task: _Task, X_OG: Pose) -> np.ndarray:
    boxes = approach_boxes(task.gripper, task.settings.standoff)
    return lowest_point(X_OG, boxes) >= task.settings.table_clearance


def _lever(task: _Task, X_OG: Pose) -> Array:
    """Return the lever (K,) [m] with which gravity turns the object about the closing axis."""
    arm = task.centre_of_mass - X_OG.translation
    closing = X_OG.rotation_matrix()[:, :, 1]
    # (arm x down) . closing, with down = -z
    return np.abs(arm[:, 0] * closing[:, 1] - arm[:, 1] * closing[:, 0])


def _within_cone(axes: Array, half_angle: float, rng: np.random.Generator) -> Array:
    """Return unit vectors (N, 3) within ``half_angle`` [rad] of ``axes``, most of them near the axis."""
    u, v = _perpendiculars(axes)
    tilt, turn = half_angle * rng.random(len(axes)) ** 3, 2 * np.pi * rng.random(len(axes))
    sideways = np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v
    return np.cos(tilt)[:, None] * axes + np.sin(tilt)[:, None] * sideways


def _perpendiculars(axes: Array) -> tuple[Array, Array]:
    """Return two unit vectors (N, 3) each that make a right-handed frame with unit vectors ``axes``."""
    helper = np.eye(3)[np.argmin(np.abs(axes), axis=1)]
    u = np.cross(axes, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.cross(axes, u)


def _provenance(task: _Task, seed: int, count: int) -> dict[str, object]:
    facts: dict[str, object] = {
        "method": METHOD,
        "seed": seed,
        "settings": asdict(task.settings),
        "gripper_fingerprint": gripper_fingerprint(task.gripper),
        "library_version": _version(),
        "funnel": dict(task.funnel),
    }
    if count < task.settings.count:
        facts["reason"] = (
            f"{count} of {task.settings.count}: after {task.settings.max_rounds} rounds only {count} sound grasps "
            f"were found; left after each check: {dict(task.funnel)}"
        )
    return facts


def _version() -> str:
    try:
        return metadata.version("optsc")
    except metadata.PackageNotFoundError:  # run from a source tree
        return "source"
