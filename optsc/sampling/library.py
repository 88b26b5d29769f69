"""A library of sampled grasps: stored ones are taken, missing ones are sampled."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from optsc.geometry import TriangleMesh
from optsc.grasps.grasp_set import GraspSet
from optsc.grasps.library import GraspLibrary
from optsc.grasps.storage import save_set
from optsc.robot.gripper import Gripper
from optsc.sampling.antipodal import sample_grasps
from optsc.sampling.gathering import Progress
from optsc.sampling.keeping import differences, expendable, refuse, stored_set
from optsc.sampling.settings import AntipodalSettings


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
