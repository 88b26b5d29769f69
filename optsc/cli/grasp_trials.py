"""``optsc grasps validate``: what grasps are tried on, and what is said of it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace

from optsc.cli.grasp_surfaces import place_for
from optsc.cli.progress import counted_progress
from optsc.errors import InvalidValue
from optsc.grasps import GraspLibrary, GraspSet
from optsc.sim.objects.model import added_thickness
from optsc.sim.validation import validate


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
