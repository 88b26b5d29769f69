"""``optsc grasps validate``: trials of grasps, on a surface from a file, the store or the catalogue."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from optsc.cli.progress import counted_progress
from optsc.errors import InvalidValue, Mismatch
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.grasps import GraspLibrary, GraspSet
from optsc.grasps.storage import load_surface, surface_hash
from optsc.sim import OBJECT_NAMES, ObjectModel, object_model
from optsc.sim.objects.model import added_thickness
from optsc.sim.validation import validate

LEANING = 0.2
"""An object that was seen turned by less than this off a side that it may rest on is tried on that side [rad]."""


class Surface(NamedTuple):
    """A surface from a file."""

    mesh: TriangleMesh
    """In O: the file's axes, the origin at the centre of the base."""
    X_OF: Pose
    """The file's frame F in O."""


class Place(NamedTuple):
    """What grasps are tried on."""

    model: ObjectModel
    X_WO: Pose | None
    """How it rests on the plane z = 0; None for upright."""
    words: str


def surface_from_file(path: Path, unit: float, name: str | None = None) -> Surface:
    """Return the surface in a mesh file.

    Raises:
        DamagedFile: there is no such file, or it is no mesh.
        InvalidValue: it encloses no volume, is inside out, or its size makes its unit suspicious.
    """
    from optsc.perception import template_from_file

    # A template asks of a surface all that grasps need: a volume, a sense, a size that can be meant in metres.
    mesh = template_from_file(path, name, unit=unit, keep_frame=True).mesh
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    base = np.array([*(0.5 * (low + high))[:2], low[2]])
    return Surface(TriangleMesh(mesh.vertices - base, mesh.faces), Pose.from_translation(-base))


def place_for(grasps: GraspSet, folder: Path, mesh: Path | None, unit: float) -> Place:
    """Return what grasps are tried on: the given surface, the stored one, or the catalogue's; and in words which.

    Raises:
        Mismatch: the surface that is given is not the one that the grasps were made on.
        InvalidValue: no surface is known, or it is not closed.
    """
    from optsc.sim.objects.model import model_from_mesh

    name = grasps.object_name
    if mesh is not None:
        surface, X_WO, words = _given(grasps, mesh, unit)
        return Place(model_from_mesh(name, surface), X_WO, words)
    model = _from_catalogue(grasps)
    if model is not None and surface_hash(grasps) is not None:  # its mass is known, and its pieces are exact
        return Place(model, _rest(grasps, model.mesh), f"the catalogue's {model.name}")
    stored = load_surface(grasps, folder)
    if stored is not None:
        words = "the surface that is stored with them"
        return Place(model_from_mesh(name, stored), _rest(grasps, stored), words)
    if model is None:
        valid = "one that is given: --mesh FILE, and --unit 0.001 for millimetres"
        raise InvalidValue(f"surface of {name}", "not stored, and not the catalogue's", valid)
    made = "imported" if grasps.provenance.get("source") == "imported" else "these"
    words = f"the {made} grasps name no surface, so nobody knows whether they are of this one"
    return Place(model, None, f"the catalogue's {model.name}: {words}")


def _given(grasps: GraspSet, path: Path, unit: float) -> tuple[TriangleMesh, Pose | None, str]:
    """Return the surface of a file in the frame of the grasps, how it rests, and what to say of it."""
    mesh, X_OF = surface_from_file(path, unit, grasps.object_name)
    as_it_is = TriangleMesh(mesh.vertices - X_OF.translation, mesh.faces)
    known, words = surface_hash(grasps), f"the surface in {path.name}"
    if known == mesh.hash:
        return mesh, _rest(grasps, mesh), words
    if known not in (None, as_it_is.hash):
        raise Mismatch(f"grasp set of {grasps.object_name}", known, f"{path.name} ({mesh.hash[:12]})")
    if known is None:
        words += ", in whose frame the grasps are taken to be"
    return as_it_is, Pose.from_translation([0.0, 0.0, X_OF.translation[2]]), words


def _from_catalogue(grasps: GraspSet) -> ObjectModel | None:
    """Return the catalogue's object that grasps may be of: that of their template, else that of their name."""
    name = grasps.provenance.get("template") or grasps.object_name
    if name not in OBJECT_NAMES:
        return None
    model = object_model(str(name))
    return model if surface_hash(grasps) in (None, model.mesh.hash) else None


def _rest(grasps: GraspSet, mesh: TriangleMesh) -> Pose | None:
    """Return how the object rested when it was seen, put flat onto the nearest side of its hull; None for upright."""
    from scipy.spatial import ConvexHull

    seen = grasps.provenance.get("up")
    if not isinstance(seen, list) or len(seen) != 3:
        return None
    up = np.asarray(seen, dtype=float)
    sides = -ConvexHull(mesh.vertices).equations[:, :3]  # up of W in O, for each side that it may rest on
    side = sides[np.argmax(sides @ up)]
    angle = float(np.arccos(min(1.0, side @ up)))
    if not angle < LEANING:
        raise InvalidValue(
            f"pose in which {grasps.object_name} was seen",
            f"{np.degrees(angle):.0f} degrees off the nearest side",
            f"at most {np.degrees(LEANING):.0f} degrees: it leant on something that is not there in a trial",
        )
    across = np.cross(side, np.eye(3)[np.argmin(np.abs(side))])
    across /= np.linalg.norm(across)
    R = np.stack([across, np.cross(side, across), side])
    return Pose(rotation.from_matrix(R), np.array([0.0, 0.0, -(mesh.vertices @ side).min()]))


def check_options(options: argparse.Namespace, library: GraspLibrary) -> None:
    """Raise `InvalidValue` for an impossible share, and for one surface for several objects."""
    if not 0.0 <= options.least <= 1.0:
        raise InvalidValue("--least", options.least, "0 to 1")
    if options.mesh is not None and len(library) != 1:
        raise InvalidValue("--mesh", f"given for {', '.join(sorted(library))}", "one object: --objects NAME")
    if options.unit is not None and options.mesh is None:
        raise InvalidValue("--unit", options.unit, "only with --mesh")


def tried(grasps: GraspSet, options: argparse.Namespace, workers: int) -> GraspSet:
    """Return a set with the outcome of trying it; say on which surface, and keep that in the provenance.

    Raises:
        InvalidValue, Mismatch: as `place_for` and `optsc.sim.validation.validate`.
    """
    unit = 1.0 if options.unit is None else options.unit
    model, X_WO, words = place_for(grasps, options.directory, options.mesh, unit)
    changed = {"mass": options.mass, "friction": options.friction}
    model = replace(model, **{key: value for key, value in changed.items() if value is not None})
    pieces = f"{len(model.parts)} convex piece{'s' if len(model.parts) > 1 else ''}"
    if len(model.parts) > 1:
        pieces += f" that add {1e3 * added_thickness(model):.2f} mm all over"
    about = f"{pieces}, {model.mass:.3g} kg, friction {model.friction:g}"
    print(f"{grasps.object_name}: tried on {words} ({about})", flush=True)
    outcome = validate(model, grasps, X_WO=X_WO, workers=workers, progress=counted_progress())
    place = {"on": words, "surface_hash": model.mesh.hash, "mass": model.mass, "friction": model.friction}
    before = outcome.provenance["validation"]
    facts = {**before, **place} if isinstance(before, Mapping) else place
    return replace(outcome, provenance={**outcome.provenance, "validation": facts})
