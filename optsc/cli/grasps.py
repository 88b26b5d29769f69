"""``optsc grasps``: build grasp libraries, look at stored ones, try them, and bring in others' grasps."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from optsc.cli.options import actions_of, add_gripper, add_objects, add_output, add_seed, checked_seed

_EXAMPLE = "example: optsc grasps build --objects mug can --output grasps && optsc grasps show grasps"


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "grasps",
        help="build grasp libraries, look at them, try them, import others",
        epilog=_EXAMPLE,
    )
    actions = actions_of(parser)
    for add in (_add_build, _add_show, _add_validate, _add_import):
        add(actions)


def _add_build(actions: Any) -> None:
    build = actions.add_parser(
        "build",
        help="sample grasps of objects and store them",
        description="Sample grasps on the exact surfaces of objects and store one file for each, with a "
        "summary.json. What is stored already and still agrees is kept.",
        epilog="example: optsc grasps build --objects mug can --seed 1 --output grasps",
    )
    add_objects(build, "all that come along")
    add_gripper(build)
    build.add_argument("--count", type=int, default=150, help="grasps wanted of each object (default 150)")
    add_seed(build, "the sampling")
    add_output(build, "grasps", "where they go")
    build.set_defaults(run=_build)


def _add_show(actions: Any) -> None:
    show = actions.add_parser(
        "show",
        help="list what a folder of grasps holds, and draw it",
        description="List what a folder of grasps holds; with --output, also draw each object's grasps coloured "
        "by quality and write a summary.json.",
        epilog="example: optsc grasps show grasps --output pictures",
    )
    show.add_argument("directory", type=Path)
    add_objects(show)
    add_seed(show, "the drawn surface points")
    add_output(show, None, "where pictures go")
    show.set_defaults(run=_show)


def _add_validate(actions: Any) -> None:
    validate = actions.add_parser(
        "validate",
        help="try stored grasps in the simulator and store the outcome",
        description="Close, lift and shake: every stored grasp of the objects that come along is tried in a "
        "simulation of its own, and whether it held is stored with it. Exit code 0 when all were tried and at "
        "least the share --least held.",
        epilog="example: optsc grasps validate grasps --objects mug --workers 2",
    )
    validate.add_argument("directory", type=Path)
    add_objects(validate)
    validate.add_argument("--workers", type=int, help="processes that share the work (default: all cores)")
    validate.add_argument(
        "--least", type=float, default=0.0, help="share that has to hold for exit code 0 (default 0)"
    )
    add_seed(validate, "nothing: trials have no chance in them")
    add_output(validate, None, "where the sets with outcomes go", otherwise="in place")
    validate.set_defaults(run=_validate)


def _add_import(actions: Any) -> None:
    importer = actions.add_parser(
        "import",
        help="bring in grasps from ACRONYM's HDF5 files or tables of poses",
        description="Store the grasps of a file: .h5 laid out as ACRONYM's, or .csv with a header "
        "x,y,z,qw,qx,qy,qz and, if wanted, opening,quality; metres and unit quaternions.",
        epilog="example: optsc grasps import my_poses.csv --name mug --output grasps",
    )
    importer.add_argument("file", type=Path)
    importer.add_argument("--name", required=True, help="of the object")
    add_gripper(importer)
    add_seed(importer, "nothing: importing has no chance in it")
    add_output(importer, "grasps", "where they go")
    importer.set_defaults(run=_import)


def _build(options: argparse.Namespace) -> int:
    from optsc.cli.grasp_output import progress, report
    from optsc.grasps import AntipodalSettings, build_library
    from optsc.robot import gripper
    from optsc.sim import OBJECT_NAMES, object_model

    library = build_library(
        {name: object_model(name).mesh for name in options.objects or OBJECT_NAMES},
        gripper(options.gripper),
        seed=checked_seed(options),
        directory=options.output,
        settings=AntipodalSettings(count=options.count),
        progress=progress(),
    )
    report(library, options.output, {"seed": options.seed})
    return 0 if all(len(grasps) for grasps in library.values()) else 1


def _show(options: argparse.Namespace) -> int:
    from optsc.cli.grasp_output import chosen, pictures, report
    from optsc.grasps import GraspLibrary

    library = chosen(GraspLibrary.load(options.directory), options.objects)
    facts = {} if options.output is None else {"pictures": pictures(library, options.output, options.seed)}
    report(library, options.output, facts, everything=True)
    return 0


def _validate(options: argparse.Namespace) -> int:
    from optsc.cli.grasp_output import chosen, progress, report
    from optsc.errors import InvalidValue
    from optsc.grasps import GraspLibrary
    from optsc.grasps.storage import save_set
    from optsc.sim import object_model
    from optsc.sim.validation import usable_cores, validate

    if not 0.0 <= options.least <= 1.0:
        raise InvalidValue("--least", options.least, "0 to 1")
    library = chosen(GraspLibrary.load(options.directory), options.objects)
    workers = usable_cores() if options.workers is None else options.workers
    output = options.output or options.directory
    for name in sorted(library):
        tried = validate(object_model(name), library[name], workers=workers, progress=progress())
        save_set(tried, output)
        library = library.with_set(tried)
    report(library, output, {"workers": workers})
    enough = (s.reliable.mean() >= options.least for s in library.values() if len(s))
    return 0 if all(enough) else 1


def _import(options: argparse.Namespace) -> int:
    from optsc.cli.grasp_output import report
    from optsc.grasps import GraspLibrary, import_grasps
    from optsc.grasps.storage import save_set
    from optsc.robot import gripper

    grasps = import_grasps(options.file, gripper(options.gripper), name=options.name)
    save_set(grasps, options.output)
    report(GraspLibrary({grasps.object_name: grasps}), options.output, {"file": str(options.file)})
    return 0
