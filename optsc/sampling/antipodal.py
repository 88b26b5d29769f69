"""Antipodal grasp sampling: two opposite contacts, a free approach, enough pad on the object, spread over the object.

The idea follows V.-D. Nguyen, "Constructing force-closure grasps", 1988: two soft contacts hold an object
when the line between them lies in both friction cones.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from importlib import metadata
from typing import NamedTuple

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.geometry.rotation import Array
from optsc.grasps.grasp_set import GraspSet
from optsc.robot.gripper import Gripper
from optsc.sampling.checks import FeasibleGrasps, Tally, Workpiece, concatenate, feasible_grasps
from optsc.sampling.proposals import Propose, propose
from optsc.sampling.quality import grasp_quality, hold_of, resisted_share, robustness
from optsc.sampling.settings import AntipodalSettings
from optsc.sampling.surface import centre_of_mass, sample_surface

METHOD = "antipodal-2"
"""Name of the sampling method; the number rises with every change that gives other grasps."""
SMALLEST, LARGEST = 0.002, 2.0
"""Longest side of an object [m]; what lies outside was most likely not given in metres."""
LENGTH = 0.15
"""Distance [m] that counts as much as one radian in `pose_distance`."""
_PATIENCE = 10  # rounds without a single feasible grasp after which sampling ends without a result
_SPARE = 1.3  # grasps to measure in full for each one wanted
Progress = Callable[[str, int, int], None]
"""Called with the object's name, the steps done and the steps in all."""


def sample_grasps(
    mesh: TriangleMesh,
    gripper: Gripper,
    *,
    name: str,
    seed: int,
    settings: AntipodalSettings | None = None,
    progress: Progress | None = None,
    tally: Tally | None = None,
) -> GraspSet:
    """Return ``settings.count`` grasps of an object that stands on the plane z = 0 of its frame.

    Every grasp has: both contacts in the friction cone; pads that lie flat on the object; a straight approach
    with fully open jaws that touches neither object nor table; jaws that on closing meet nothing else first;
    a hold that bears small errors of the pose and resists a wrench in every direction. They are spread over
    positions and directions, with no grasp twice (a half turn of symmetric jaws is the same grasp). Where fewer
    are found, ``provenance["reason"]`` says why; ``provenance["funnel"]`` counts the poses left after each
    check, and ``tally`` keeps them where they are of interest. The quality is `optsc.sampling.quality.grasp_quality`.

    The same mesh, gripper, seed and settings give the same grasps. Raises `InvalidValue` for a negative seed
    and for a mesh that is implausible in metres.
    """
    settings = settings or AntipodalSettings()
    check_request(name, mesh.extents, seed)
    rng = np.random.default_rng(seed)
    surface = sample_surface(mesh, settings.spacing, rng)
    work = Workpiece(surface, centre_of_mass(mesh), gripper, settings)
    kept = gather(work, partial(propose, mesh, gripper, settings), rng, name, progress, tally)
    return grasp_set(work, kept, name=name, object_hash=mesh.hash, seed=seed, facts={"source": "mesh"})


def check_request(name: str, extents: Array, seed: int) -> None:
    """Raise `InvalidValue` for a negative seed and for a size that is implausible in metres."""
    size = float(np.max(extents))
    if seed < 0:
        raise InvalidValue("seed", seed, "0 or above")
    if size > LARGEST:
        raise InvalidValue(f"longest side of {name}", size, f"{SMALLEST} to {LARGEST} m; is it in millimetres?")
    if size < SMALLEST:
        raise InvalidValue(f"longest side of {name}", size, f"{SMALLEST} to {LARGEST} m; is it in metres?")


class Kept(NamedTuple):
    """The grasps that are kept, spread over positions and directions, the best first among equals."""

    X_OG: Pose
    opening: Array
    """Distance between the pads when they hold the object (N,) [m]."""
    quality: Array
    """(N,) in [0, 1], `grasp_quality`."""
    rounds: int
    """Of sampling."""
    tally: Tally


def gather(
    work: Workpiece,
    propose: Propose,
    rng: np.random.Generator,
    name: str,
    progress: Progress | None = None,
    tally: Tally | None = None,
) -> Kept:
    """Return up to ``settings.count`` grasps of an object out of as many rounds of proposals as that takes."""
    settings, tally = work.settings, tally or Tally()
    wanted, found = settings.pool * settings.count, 0
    rounds: list[FeasibleGrasps] = []
    hopeless = min(_PATIENCE, settings.max_rounds)
    while found < wanted and len(rounds) < (settings.max_rounds if found else hopeless):
        rounds.append(feasible_grasps(work, propose(rng), tally))
        found += len(rounds[-1].X_OG)
        last = len(rounds) >= (settings.max_rounds if found else hopeless)
        if progress is not None:
            progress(name, wanted if last else min(found, wanted), wanted)
    pool, quality = _measured(work, concatenate(rounds), rng, tally)
    chosen = spread_out(pool.X_OG, quality, settings.count, work.gripper.jaw_symmetric)
    tally.note("kept", pool.X_OG[chosen])
    return Kept(pool.X_OG[chosen], pool.contacts.width[chosen].astype(float), quality[chosen], len(rounds), tally)


def _measured(
    work: Workpiece, pool: FeasibleGrasps, rng: np.random.Generator, tally: Tally
) -> tuple[FeasibleGrasps, Array]:
    """Return grasps that bear errors and resist all wrenches, with their quality.

    Both take time, so they are measured only for as many as are needed, far apart and good ones first.
    """
    settings, hold = work.settings, hold_of(work, pool)
    order = spread_out(pool.X_OG, hold, len(hold), work.gripper.jaw_symmetric)
    kept: list[np.ndarray] = []
    qualities: list[Array] = []
    step = int(np.ceil(_SPARE * settings.count))
    for start in range(0, max(len(order), 1), step):
        index = order[start : start + step]
        robust = robustness(work, pool.X_OG[index], rng)
        index, robust = index[robust >= settings.min_robustness], robust[robust >= settings.min_robustness]
        tally.note("robust to errors of the pose", pool.X_OG[index])
        resisted = resisted_share(work, pool.select(index))
        index, robust, resisted = (values[resisted > 0.0] for values in (index, robust, resisted))
        tally.note("resists every wrench", pool.X_OG[index])
        kept.append(index)
        qualities.append(grasp_quality(resisted, robust, hold[index]))
        if sum(map(len, kept)) >= settings.count:
            break
    return pool.select(np.concatenate(kept)), np.concatenate(qualities)


def pose_distance(a: Pose, b: Pose, jaw_symmetric: bool) -> Array:
    """Return sqrt((translation / 0.15 m)^2 + angle^2) [rad]; batch shapes broadcast.

    With ``jaw_symmetric`` the angle is the smaller one of ``b`` and ``b`` after a half turn about its z axis.
    """
    angle = rotation.angle(a.quaternion, b.quaternion)
    if jaw_symmetric:
        half_turn = np.array([0.0, 0.0, 0.0, 1.0])
        angle = np.minimum(angle, rotation.angle(a.quaternion, rotation.multiply(b.quaternion, half_turn)))
    return np.hypot(np.linalg.norm(a.translation - b.translation, axis=-1) / LENGTH, angle)


def spread_out(poses: Pose, quality: Array, count: int, jaw_symmetric: bool) -> np.ndarray:
    """Return the indices of ``count`` poses (fewer if there are fewer), best first among equals.

    Farthest-point selection: start with the best pose, then take again and again the one with the greatest
    product of quality and distance to the nearest pose taken. Distance alone would pick the odd ones out.
    """
    chosen = [int(np.argmax(quality))] if len(quality) else []
    distance = np.full(len(quality), np.inf)
    for _ in range(min(count, len(quality)) - 1):
        distance = np.minimum(distance, pose_distance(poses, poses[chosen[-1]], jaw_symmetric))
        chosen.append(int(np.argmax(distance * quality)))
    return np.array(chosen, dtype=np.int64)


def grasp_set(
    work: Workpiece,
    kept: Kept,
    *,
    name: str,
    object_hash: str,
    seed: int,
    facts: Mapping[str, object] | None = None,
) -> GraspSet:
    """Return the grasps with how they came about; ``facts`` are added to that."""
    provenance: dict[str, object] = {
        "method": METHOD,
        "seed": seed,
        "settings": asdict(work.settings),
        "gripper_fingerprint": gripper_fingerprint(work.gripper),
        "library_version": _version(),
        "rounds": kept.rounds,
        "funnel": dict(kept.tally.funnel),
        **(facts or {}),
    }
    wanted = work.settings.count
    if len(kept.X_OG) < wanted:
        steps = ", ".join(f"{check}: {left}" for check, left in kept.tally.funnel.items())
        provenance["reason"] = f"{len(kept.X_OG)} of {wanted} found in {kept.rounds} rounds; poses left after {steps}"
    return GraspSet(
        object_name=name,
        object_hash=object_hash,
        gripper=work.gripper.name,
        X_OG=kept.X_OG,
        opening=kept.opening,
        quality=kept.quality,
        provenance=provenance,
        jaw_symmetric=work.gripper.jaw_symmetric,
    )


def gripper_fingerprint(gripper: Gripper) -> str:
    """Return a hash of everything about the gripper that grasps depend on, rounded to a micrometre."""
    numbers = [
        [gripper.max_opening, *gripper.pad_size, float(gripper.jaw_symmetric)],
        gripper.body,
        gripper.finger,
    ]
    digest = hashlib.sha256()
    for array in numbers:
        digest.update(np.round(np.asarray(array, dtype=float) * 1e6).astype("<i8").tobytes())
    return digest.hexdigest()[:16]


def _version() -> str:
    try:
        return metadata.version("optsc")
    except metadata.PackageNotFoundError:  # run from a source tree
        return "source"
