"""What ``optsc grasps`` prints, draws and writes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from optsc.errors import UnknownName
from optsc.geometry import PointCloud
from optsc.grasps import GraspLibrary, GraspSet
from optsc.grasps.storage import load_surface, surface_hash

_POINTS = 4000  # of a drawn surface


def chosen(library: GraspLibrary, names: Sequence[str] | None) -> GraspLibrary:
    """Return the part of a library with these names, all of it for None; raise `UnknownName`."""
    return library if names is None else GraspLibrary({name: library[name] for name in names})


def report(
    library: GraspLibrary, output: Path | None, facts: Mapping[str, object], *, everything: bool = False
) -> None:
    """Print what a library holds, and write it to ``summary.json`` in a folder if there is one."""
    objects = {name: described(library[name]) for name in sorted(library)}
    for name, about in objects.items():
        print(f"{name}: {_line(about)}")
        for key, value in sorted(about["provenance"].items()) if everything else ():
            print(f"  {key}: {value}")
        if "reason" in about["provenance"] and not everything:
            print(f"  {about['provenance']['reason']}")
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        text = json.dumps({**facts, "objects": objects}, indent=2)
        (output / "summary.json").write_text(text + "\n", encoding="utf-8")


def described(grasps: GraspSet) -> dict[str, Any]:
    """Return the facts about a set."""
    facts: dict[str, Any] = {"grasps": len(grasps), "gripper": grasps.gripper}
    if len(grasps):
        for field in ("opening", "quality"):
            values = getattr(grasps, field)
            facts[field] = [float(values.min()), float(np.median(values)), float(values.max())]
    if grasps.tried is not None:
        facts["tried"], facts["held"] = int(grasps.tried.sum()), int(grasps.reliable.sum())
    return {**facts, "provenance": dict(grasps.provenance)}


def _line(about: Mapping[str, Any]) -> str:
    words = [f"{about['grasps']} grasps for {about['gripper']}"]
    if "opening" in about:
        low, _, high = about["opening"]
        worst, _, best = about["quality"]
        numbers = {
            "opening": f"opening {1e3 * low:.0f} to {1e3 * high:.0f} mm",
            "quality": f"quality {worst:.2f} to {best:.2f}",
        }
        for field, text in numbers.items():
            known = about["provenance"].get(f"{field}_known", True)
            words.append(text if known else f"{field} not known")
    words.append(f"{about['held']} of {about['tried']} tried held" if "tried" in about else "not tried")
    return ", ".join(words)


def pictures(library: GraspLibrary, folder: Path, output: Path, seed: int) -> list[str]:
    """Draw each object's grasps and return the files; an object without a known surface has grasps alone."""
    from optsc.viewers.drawing import save_figure
    from optsc.viewers.figure_grasps import grasps_figure

    output.mkdir(parents=True, exist_ok=True)
    files = []
    for name in sorted(library):
        figure = grasps_figure(library[name], _surface(library[name], folder, seed))
        files.append(str(save_figure(figure, output / f"{name}.png")))
        print(f"{name}: {files[-1]}")
    return files


def _surface(grasps: GraspSet, folder: Path, seed: int) -> PointCloud | None:
    """Return points of the surface that is stored with grasps in a folder, or else of the object of their name."""
    from optsc.sim import object_model

    mesh = load_surface(grasps, folder)
    if mesh is None:
        try:
            mesh = object_model(grasps.object_name).mesh
        except UnknownName:
            return None
        if surface_hash(grasps) not in (None, mesh.hash):
            return None
    return PointCloud(*mesh.sample(np.random.default_rng(seed), _POINTS))
