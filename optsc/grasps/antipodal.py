"""Antipodal sampling: two opposite contacts, a free way in, and enough pad on the object.

The idea follows V.-D. Nguyen, "Constructing force-closure grasps", 1988: two soft contacts hold an object
when the line between them lies in both friction cones.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from importlib import metadata

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import TriangleMesh
from optsc.grasps.checks import Sound, Workpiece, concatenate, sound_grasps
from optsc.grasps.grasp_set import GraspSet
from optsc.grasps.identity import METHOD, gripper_fingerprint
from optsc.grasps.proposals import propose
from optsc.grasps.settings import AntipodalSettings
from optsc.grasps.spread import spread_out
from optsc.grasps.surface import centre_of_mass, sample_surface
from optsc.robot.gripper import Gripper

Progress = Callable[[str, int, int], None]
"""Called with the object's name, the steps done and the steps in all."""

SMALLEST, LARGEST = 0.002, 2.0
"""Longest side of an object [m]; what lies outside was most likely not given in metres."""


def sample_grasps(
    mesh: TriangleMesh,
    gripper: Gripper,
    *,
    name: str,
    seed: int,
    settings: AntipodalSettings | None = None,
    progress: Progress | None = None,
) -> GraspSet:
    """Return ``settings.count`` grasps of an object that stands on the plane z = 0 of its frame.

    Every grasp has: both contacts in the friction cone; pads that lie flat on the object; a straight approach
    with fully open jaws that touches neither object nor table; jaws that on closing meet nothing else first.
    They are spread over positions and directions, with no grasp twice (a half turn of symmetric jaws is the
    same grasp). Where fewer are found, ``provenance["reason"]`` says why; ``provenance["funnel"]`` counts the
    poses left after each check. The quality is `optsc.grasps.checks.grasp_quality`.

    The same mesh, gripper, seed and settings give the same grasps. Raises `InvalidValue` for a negative seed
    and for a mesh that cannot have been meant in metres.
    """
    settings, size = settings or AntipodalSettings(), float(mesh.extents.max())
    if seed < 0:
        raise InvalidValue("seed", seed, "0 or above")
    if not SMALLEST <= size <= LARGEST:
        raise InvalidValue(f"longest side of {name}", size, f"{SMALLEST} to {LARGEST} m; is it in metres?")
    rng = np.random.default_rng(seed)
    surface = sample_surface(mesh, settings.spacing, rng)
    work = Workpiece(surface, centre_of_mass(mesh), gripper, settings)
    wanted, found = settings.pool * settings.count, 0
    rounds: list[Sound] = []
    funnel: Counter[str] = Counter()
    while found < wanted and len(rounds) < settings.max_rounds:
        rounds.append(sound_grasps(work, propose(mesh, gripper, settings, rng), funnel))
        found += len(rounds[-1].X_OG)
        if progress is not None:
            progress(name, wanted if len(rounds) == settings.max_rounds else min(found, wanted), wanted)
    pool = concatenate(rounds)
    chosen = spread_out(pool.X_OG, pool.quality, settings.count, gripper.jaw_symmetric)
    return GraspSet(
        object_name=name,
        object_hash=mesh.hash,
        gripper=gripper.name,
        X_OG=pool.X_OG[chosen],
        opening=pool.width[chosen],
        quality=pool.quality[chosen],
        provenance=_provenance(work, seed, len(rounds), len(chosen), funnel),
        jaw_symmetric=gripper.jaw_symmetric,
    )


def _provenance(
    work: Workpiece, seed: int, rounds: int, count: int, funnel: Counter[str]
) -> dict[str, object]:
    facts: dict[str, object] = {
        "method": METHOD,
        "seed": seed,
        "settings": asdict(work.settings),
        "gripper_fingerprint": gripper_fingerprint(work.gripper),
        "library_version": _version(),
        "rounds": rounds,
        "funnel": dict(funnel),
    }
    if count < work.settings.count:
        steps = ", ".join(f"{check}: {left}" for check, left in funnel.items())
        facts["reason"] = (
            f"{count} of {work.settings.count} found in {rounds} rounds; poses left after {steps}"
        )
    return facts


def _version() -> str:
    try:
        return metadata.version("optsc")
    except metadata.PackageNotFoundError:  # run from a source tree
        return "source"
