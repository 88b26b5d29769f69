"""``optsc grasps import``: the frame that a file's poses are of, and the surface that they are on."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from optsc.cli.grasp_trials import surface_from_file
from optsc.errors import InvalidValue
from optsc.geometry import Pose, TriangleMesh
from optsc.grasps import GraspSet
from optsc.grasps.storage import path_of
from optsc.robot import gripper
from optsc.sampling.importing import ACRONYM_X_HG, PANDA_X_HG, import_grasps

FRAMES = {"tool": Pose.identity(), "panda_hand": PANDA_X_HG, "acronym": ACRONYM_X_HG}
"""X_HG of the frames H that a file's poses may be of."""

NEAR = 0.03
"""A grasp is at the surface if its tool frame is within its box, grown by this [m]."""


def imported(options: argparse.Namespace) -> tuple[GraspSet, TriangleMesh | None]:
    """Return the grasps of a file, and their surface in O where it was given; say what was done.

    Raises:
        InvalidValue, DamagedFile, UnknownName: as `import_grasps` and `surface_from_file`.
    """
    path_of(options.output, options.name)
    if options.unit is not None and options.mesh is None:
        raise InvalidValue("--unit", options.unit, "only with --mesh: poses are in metres")
    X_HG = None if options.frame is None else frame(options.frame)
    grasps = import_grasps(options.file, gripper(options.gripper), name=options.name, X_HG=X_HG)
    if options.mesh is None:
        return grasps, None
    scale = grasps.provenance.get("object_scale")
    unit = options.unit if options.unit is not None else scale if isinstance(scale, float) else 1.0
    surface = surface_from_file(options.mesh, unit, options.name)
    moved = replace(
        grasps.moved(surface.X_OF),
        object_hash=surface.mesh.hash,
        provenance={
            **grasps.provenance,
            "surface": {
                "file": options.mesh.name,
                "unit": unit,
                "origin_moved": surface.X_OF.translation.tolist(),
            },
        },
    )
    _say(moved, surface.mesh, options, surface.X_OF)
    return moved, surface.mesh


def frame(words: Sequence[str]) -> Pose:
    """Return X_HG, the tool frame in the frame that poses are of, from a name or seven numbers."""
    valid = f"{', '.join(FRAMES)}, or seven numbers x y z qw qx qy qz [m]"
    if len(words) == 1 and words[0] in FRAMES:
        return FRAMES[words[0]]
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != 7 or not np.all(np.isfinite(numbers)):
        raise InvalidValue("--frame", " ".join(words), valid)
    if float(np.linalg.norm(numbers[:3])) > 1.0:
        raise InvalidValue("--frame", " ".join(words), f"{valid}, within 1 m; is it in millimetres?")
    return Pose.from_quaternion(numbers[3:], numbers[:3])


def _say(grasps: GraspSet, mesh: TriangleMesh, options: argparse.Namespace, X_OF: Pose) -> None:
    size = " x ".join(f"{1e3 * side:.1f}" for side in mesh.extents)
    shift = ", ".join(f"{1e3 * step:.1f}" for step in X_OF.translation)
    print(f"{grasps.object_name}: {options.mesh}, {size} mm; grasps moved by ({shift}) mm to its base's centre")
    low, high = mesh.vertices.min(axis=0) - NEAR, mesh.vertices.max(axis=0) + NEAR
    p = grasps.X_OG.translation
    far = int((~np.all((p >= low) & (p <= high), axis=1)).sum())
    if far:
        print(
            f"{grasps.object_name}: {far} of {len(grasps)} grasps are more than {1e3 * NEAR:.0f} mm away from it; are "
            "poses and surface in one frame, is --frame right, and --unit?"
        )
