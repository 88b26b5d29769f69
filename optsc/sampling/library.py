"""Libraries of sampled grasps: stored ones are taken, missing ones sampled, other ones never overwritten unasked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np

from optsc.cache import cache_directory
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import TriangleMesh
from optsc.grasps.grasp_set import GraspSet
from optsc.grasps.library import GraspLibrary
from optsc.grasps.storage import load_set, path_of, save_set
from optsc.robot.gripper import Gripper
from optsc.sampling.antipodal import METHOD, Progress, gripper_fingerprint, sample_grasps
from optsc.sampling.settings import AntipodalSettings

ADVICE = "the stored grasps are kept: choose another folder, or replace them (--replace of optsc grasps, replace=True)"


def build_library(
    objects: Mapping[str, TriangleMesh],
    gripper: Gripper,
    *,
    seed: int,
    directory: str | Path | None = None,
    settings: AntipodalSettings | None = None,
    progress: Progress | None = None,
    replace: bool = False,
) -> GraspLibrary:
    """Return the grasps of all ``objects``, taken from ``directory`` where they are stored already.

    A stored set is taken if everything agrees that decides about its content: the object's surface, the
    gripper's shape, the seed, the settings and the sampling method; an imported one if it is of this very surface
    and for this gripper. What is missing or damaged is sampled and stored. Other grasps are never written over
    unless ``replace`` says so, except, in the per-user cache, sampled ones that nobody tried.

    Raises:
        InvalidValue: other grasps of an object are stored, or a file is from a later version of the library. It
            is raised before anything is sampled.
    """
    settings = settings or AntipodalSettings()
    sets: dict[str, GraspSet] = {}
    for name, mesh in objects.items():
        stored = None if directory is None else stored_set(directory, name)
        if directory is None or stored is None:
            continue
        other = differences(stored, mesh, gripper, seed, settings)
        if not other:
            sets[name] = stored
        elif not replace and not expendable(stored, directory):
            refuse(directory, stored, f"grasps {other}")
    for name, mesh in objects.items():
        if name in sets:
            if progress is not None:
                progress(name, 1, 1)
            continue
        sets[name] = sample_grasps(mesh, gripper, name=name, seed=seed, settings=settings, progress=progress)
        if directory is not None:
            save_set(sets[name], directory)
    return GraspLibrary({name: sets[name] for name in objects})


def stored_set(directory: str | Path, name: str) -> GraspSet | None:
    """Return the stored grasps of an object; None where there are none or the file is damaged.

    Raises `InvalidValue` for a file from a later version of the library.
    """
    path = path_of(directory, name)
    try:
        return load_set(path) if path.exists() else None
    except DamagedFile:
        return None


def differences(stored: GraspSet, mesh: TriangleMesh, gripper: Gripper, seed: int, settings: AntipodalSettings) -> str:
    """Return in words what of stored grasps is not as asked for; empty where they are what is asked for.

    Sampled ones are if everything agrees that decides about their content, imported ones if they are of this very
    surface and for this gripper: no seed and no setting decided about those.
    """
    words = []
    if stored.object_hash != mesh.hash:
        words.append("of this surface")
    if (stored.gripper, stored.jaw_symmetric) != (gripper.name, gripper.jaw_symmetric):
        words.append(f"for {gripper.name}")
    if stored.provenance.get("source") != "imported":
        wanted = (
            ("method", METHOD, f"by the method {METHOD}"),
            ("seed", seed, f"with seed {seed}"),
            ("gripper_fingerprint", gripper_fingerprint(gripper), f"for the present shape of {gripper.name}"),
        )
        words += [text for key, value, text in wanted if stored.provenance.get(key) != value]
        words += _other_settings(stored.provenance.get("settings"), settings)
    return ", ".join(words)


def _other_settings(stored: object, settings: AntipodalSettings) -> list[str]:
    before = stored if isinstance(stored, Mapping) else {}
    return [f"with {key} {value}" for key, value in asdict(settings).items() if before.get(key) != value]


def expendable(stored: GraspSet, directory: str | Path) -> bool:
    """Tell whether grasps can be written over unasked: sampled ones that nobody tried, in the per-user cache.

    That folder is the library's own. What is there can be made again, and has to be after a change of the method.
    """
    sampled = stored.provenance.get("source") not in ("imported", "cloud") and stored.tried is None
    return sampled and Path(directory).resolve().is_relative_to(cache_directory().resolve())


def keep_set(grasps: GraspSet, directory: str | Path, *, replace: bool = False) -> Path:
    """Write a set as `save_set` does, but over other grasps only where ``replace`` says so; return the file.

    Raises:
        InvalidValue: see `check_keeping`.
    """
    check_keeping(grasps, directory, replace=replace)
    return save_set(grasps, directory)


def check_keeping(grasps: GraspSet, directory: str | Path, *, replace: bool = False) -> None:
    """Raise `InvalidValue` where a set is not to be stored over what is there.

    That is where other grasps of that object are and ``replace`` does not say so, or a file from a later version of
    the library. The same poses on the same surface are no other grasps: outcomes may be added, but not taken away.
    """
    stored = stored_set(directory, grasps.object_name)
    if stored is not None and not replace and not _continues(grasps, stored):
        refuse(directory, stored, f"what is to be stored, {origin(grasps)}")


def _continues(new: GraspSet, old: GraspSet) -> bool:
    """Tell whether a set is another one with the same outcomes or with new ones."""
    names = ("object_hash", "gripper", "jaw_symmetric")
    if any(getattr(new, name) != getattr(old, name) for name in names) or len(new) != len(old):
        return False
    arrays = [(new.X_OG.quaternion, old.X_OG.quaternion), (new.X_OG.translation, old.X_OG.translation)]
    arrays += [(new.opening, old.opening), (new.quality, old.quality)]
    return all(np.array_equal(a, b) for a, b in arrays) and (old.tried is None or new.tried is not None)


def refuse(directory: str | Path, stored: GraspSet, wanted: str) -> None:
    """Raise `InvalidValue` that says what is stored, what was ``wanted``, and what to do."""
    path = path_of(directory, stored.object_name)
    raise InvalidValue(f"content of {path}", origin(stored), f"nothing, or {wanted}; {ADVICE}")


def origin(grasps: GraspSet) -> str:
    """Return in words where grasps come from: imported, made from a view or sampled; and whether they were tried."""
    about, count = grasps.provenance, f"{len(grasps)} grasps for {grasps.gripper}"
    source = about.get("source")
    if source == "imported":
        words = f"imported from {about.get('file')}"
    elif source == "cloud":
        words = f"made from a view ({about.get('made_from', 'of a cloud')})"
    else:
        words = f"sampled with seed {about.get('seed')}"
    return f"{count}, {words}{', tried' if grasps.tried is not None else ''}"
