"""``optsc grasps build``: grasps on the catalogue's objects, on a mesh file, or on what a depth image shows."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

from optsc.cli.options import add_gripper, add_objects, add_output, add_seed, checked_seed
from optsc.errors import InvalidValue

_ONLY_WITH = {
    "image": ("templates", "unknown", "table_height", "robot", "posture"),
    "mesh": ("name",),
}


def add_build(actions: Any) -> None:
    """Add the action."""
    build = actions.add_parser(
        "build",
        help="find grasps of objects, of a mesh file or of what a camera saw, and store them",
        description="Find grasps and store one file for each object, with a summary.json: on the exact surfaces of "
        "objects that come along (--objects), on that of a mesh file (--mesh), or on what a recorded depth image "
        "shows (--image). What is stored already and still agrees is kept; other grasps are not written over "
        "without --replace. Exit code 0 when every object that grasps were looked for has some.",
        epilog="example: optsc grasps build --objects mug can --seed 1 --output grasps; "
        "optsc grasps build --mesh part.stl --unit 0.001; "
        "optsc grasps build --image view.npz --templates mug part.stl --unknown",
    )
    source = build.add_mutually_exclusive_group()
    add_objects(source, "all that come along")
    source.add_argument("--mesh", type=Path, metavar="FILE", help="a surface: STL, OBJ, PLY")
    source.add_argument("--image", type=Path, metavar="VIEW", help="a depth image: .npz, or .png with .json beside it")
    build.add_argument("--name", help="of the object of --mesh (default: the file's name)")
    add_unit(build, "mesh files")
    _add_view(build)
    add_gripper(build)
    build.add_argument("--count", type=int, default=150, help="grasps wanted of each object (default 150)")
    add_seed(build, "the search for grasps")
    add_replace(build)
    add_output(build, "grasps", "where they go")
    build.set_defaults(run=build_grasps)


def add_unit(parser: Any, of: str) -> None:
    """Add ``--unit``, of whatever ``of`` says."""
    parser.add_argument(
        "--unit", type=float, metavar="METRES", help=f"length of the unit of {of}: 0.001 for millimetres"
    )


def add_replace(parser: Any) -> None:
    """Add ``--replace``."""
    parser.add_argument("--replace", action="store_true", help="write over other grasps that are stored there")


def _add_view(build: Any) -> None:
    view = build.add_argument_group("of a depth image")
    view.add_argument(
        "--templates",
        nargs="+",
        metavar="NAME|FILE",
        help="what may be there: names of the catalogue, mesh files",
    )
    view.add_argument(
        "--unknown",
        action="store_true",
        help="grasp what is not recognised by the points that were seen of it",
    )
    view.add_argument("--table-height", type=float, metavar="M", help="in the frame W of the image (default 0)")
    view.add_argument("--robot", help="the arm that is in the picture, at --posture; its base frame is W")
    view.add_argument("--posture", type=float, nargs="+", metavar="RAD", help="its joint angles")


def build_grasps(options: argparse.Namespace) -> int:
    """Find grasps of what the options name, print and store them."""
    _check_together(options)
    checked_seed(options)
    if options.image is not None:
        return _on_image(options)
    return _on_meshes(options)


def _check_together(options: argparse.Namespace) -> None:
    for source, names in _ONLY_WITH.items():
        for name in names:
            if getattr(options, source) is None and getattr(options, name) not in (None, False):
                raise InvalidValue(f"--{name.replace('_', '-')}", getattr(options, name), f"only with --{source}")
    if options.unit is not None and options.mesh is None and options.templates is None:
        raise InvalidValue("--unit", options.unit, "only with --mesh, or with files in --templates")
    if options.image is not None and not options.templates and not options.unknown:
        raise InvalidValue(
            "--templates",
            None,
            "what may be in the image; or --unknown, to grasp what is there as it was seen",
        )


def _on_meshes(options: argparse.Namespace) -> int:
    from optsc.cli.grasp_output import report
    from optsc.cli.grasp_trials import surface_from_file
    from optsc.cli.progress import counted_progress
    from optsc.grasps.storage import path_of, save_surface
    from optsc.robot import gripper
    from optsc.sampling import build_library
    from optsc.sampling.settings import AntipodalSettings
    from optsc.sim import OBJECT_NAMES, object_model

    facts: dict[str, Any] = {"seed": options.seed}
    hand = gripper(options.gripper)
    if options.mesh is None:
        meshes = {name: object_model(name).mesh for name in options.objects or OBJECT_NAMES}
    else:
        name = options.name or options.mesh.stem
        path_of(options.output, name)
        mesh = surface_from_file(options.mesh, 1.0 if options.unit is None else options.unit, name).mesh
        meshes, facts = {name: mesh}, {**facts, "mesh": str(options.mesh), "size": mesh.extents.tolist()}
        print(f"{name}: {' x '.join(f'{1e3 * side:.1f}' for side in mesh.extents)} mm, {options.mesh}")
    library = build_library(
        meshes,
        hand,
        seed=options.seed,
        directory=options.output,
        settings=AntipodalSettings(count=options.count),
        progress=counted_progress(),
        replace=options.replace,
    )
    if options.mesh is not None:
        save_surface(name, mesh, options.output)
    report(library, options.output, facts)
    return 0 if all(len(grasps) for grasps in library.values()) else 1


def _on_image(options: argparse.Namespace) -> int:
    from optsc.cli.grasp_output import report
    from optsc.cli.grasp_views import Wanted, objects_in, observation_of, templates_of
    from optsc.grasps import GraspLibrary
    from optsc.grasps.storage import path_of, save_surface
    from optsc.perception import load_depth_image
    from optsc.robot import gripper
    from optsc.sampling.library import check_keeping, keep_set
    from optsc.sampling.settings import AntipodalSettings

    image = load_depth_image(options.image)
    templates = templates_of(options.templates or (), 1.0 if options.unit is None else options.unit)
    for template in templates:
        path_of(options.output, template.name)
    wanted = Wanted(
        templates,
        options.unknown,
        gripper(options.gripper),
        AntipodalSettings.for_clouds(options.count),
        options.seed,
    )
    observation = observation_of(image, options.robot, options.posture, options.table_height or 0.0)
    seen, dropped = objects_in(observation, wanted), observation.segmentation.dropped
    for reason, count in Counter(one.reason for one in dropped).items():
        print(f"left out: {count} {'piece' if count == 1 else 'pieces'}, {reason}")
    for one in seen:
        print(f"{one.name}: {one.words}")
    kept = [one.grasps for one in seen if one.grasps is not None and len(one.grasps)]
    for grasps in kept:  # all of them before the first is written
        check_keeping(grasps, options.output, replace=options.replace)
    for grasps in kept:
        keep_set(grasps, options.output, replace=options.replace)
    for one in seen:
        if one.template is not None and one.grasps is not None and len(one.grasps):
            save_surface(one.name, one.template.mesh, options.output)
    library = GraspLibrary({one.name: one.grasps for one in seen if one.grasps is not None})
    view = {one.name: one.facts for one in seen}
    report(library, options.output, {"seed": options.seed, "image": str(options.image), "view": view})
    return 0 if kept and len(kept) == len(library) else 1
