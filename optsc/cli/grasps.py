"""``optsc grasps``: build grasp libraries (`grasp_build`), look at stored ones, try them, bring in others' grasps."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from optsc.cli.grasp_build import add_build, add_replace, add_unit
from optsc.cli.options import actions_of, add_gripper, add_objects, add_output, add_seed

_EXAMPLE = "example: optsc grasps build --objects mug can --output grasps && optsc grasps show grasps"


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "grasps",
        help="build grasp libraries, look at them, try them, import others",
        epilog=_EXAMPLE,
    )
    actions = actions_of(parser)
    for add in (add_build, _add_show, _add_validate, _add_import):
        add(actions)


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
        description="Close, lift and shake: every stored grasp is tried in a simulation of its own, and whether it "
        "held is stored with it. It is tried on the surface in --mesh, on the one that is stored with it, or on the "
        "object of its name that comes along; which one is printed. Exit code 0 when all were tried and at "
        "least the share --least held.",
        epilog="example: optsc grasps validate grasps --objects mug --workers 2; "
        "optsc grasps validate grasps --objects part --mesh part.stl --unit 0.001",
    )
    validate.add_argument("directory", type=Path)
    add_objects(validate)
    validate.add_argument("--mesh", type=Path, metavar="FILE", help="the surface of the one object that is tried")
    add_unit(validate, "it")
    validate.add_argument("--mass", type=float, metavar="KG", help="of the objects (default: at 1000 kg/m3)")
    validate.add_argument("--friction", type=float, help="of the objects (default 0.6)")
    validate.add_argument("--workers", type=int, help="processes that share the work (default: all cores)")
    validate.add_argument("--least", type=float, default=0.0, help="share that has to hold for exit code 0 (default 0)")
    add_seed(validate, "nothing: trials have no chance in them")
    add_replace(validate)
    add_output(validate, None, "where the sets with outcomes go", otherwise="in place")
    validate.set_defaults(run=_validate)


def _add_import(actions: Any) -> None:
    importer = actions.add_parser(
        "import",
        help="bring in grasps from ACRONYM's HDF5 files or tables of poses",
        description="Store the grasps of a file: .h5 laid out as ACRONYM's, or .csv with a header "
        "x,y,z,qw,qx,qy,qz and, if wanted, opening,quality; metres and unit quaternions. With --mesh, the surface "
        "that they are of is stored with them, and they can be tried on it; the origin is then moved to the centre "
        "of its base. Other grasps are not written over without --replace.",
        epilog="example: optsc grasps import my_poses.csv --name part --mesh part.stl --unit 0.001 --frame panda_hand",
    )
    importer.add_argument("file", type=Path)
    importer.add_argument("--name", required=True, help="of the object")
    importer.add_argument(
        "--mesh", type=Path, metavar="FILE", help="the object's surface, in the frame that the poses are in"
    )
    add_unit(importer, "that surface; object/scale of an ACRONYM file by default")
    importer.add_argument(
        "--frame",
        nargs="+",
        metavar="F",
        help="of what the file gives the poses: tool (between the pads, z forward, closing along y; default of .csv), "
        "panda_hand (at the flange, closing along y), acronym (at the flange, closing along x; default of .h5), or "
        "the tool frame in it as seven numbers x y z qw qx qy qz",
    )
    add_gripper(importer)
    add_seed(importer, "nothing: importing has no chance in it")
    add_replace(importer)
    add_output(importer, "grasps", "where they go")
    importer.set_defaults(run=_import)


def _show(options: argparse.Namespace) -> int:
    from optsc.cli.grasp_output import chosen, pictures, report
    from optsc.grasps import GraspLibrary

    library = chosen(GraspLibrary.load(options.directory), options.objects)
    facts = (
        {}
        if options.output is None
        else {"pictures": pictures(library, options.directory, options.output, options.seed)}
    )
    report(library, options.output, facts, everything=True)
    return 0


def _validate(options: argparse.Namespace) -> int:
    from optsc.cli.grasp_output import chosen, report
    from optsc.cli.grasp_trials import check_options, tried
    from optsc.grasps import GraspLibrary
    from optsc.grasps.storage import load_surface, save_surface
    from optsc.processes import usable_cores
    from optsc.sampling.library import keep_set

    library = chosen(GraspLibrary.load(options.directory), options.objects)
    check_options(options, library)
    workers = usable_cores() if options.workers is None else options.workers
    output = options.output or options.directory
    for name in sorted(library):
        outcome = tried(library[name], options, workers)
        keep_set(outcome, output, replace=options.replace)
        surface = load_surface(library[name], options.directory)
        if surface is not None and output != options.directory:
            save_surface(name, surface, output)
        library = library.with_set(outcome)
    report(library, output, {"workers": workers})
    enough = (s.reliable.mean() >= options.least for s in library.values() if len(s))
    return 0 if all(enough) else 1


def _import(options: argparse.Namespace) -> int:
    from optsc.cli.grasp_import import imported
    from optsc.cli.grasp_output import report
    from optsc.grasps import GraspLibrary
    from optsc.grasps.storage import save_surface
    from optsc.sampling.library import keep_set

    grasps, mesh = imported(options)
    keep_set(grasps, options.output, replace=options.replace)
    if mesh is not None:
        save_surface(grasps.object_name, mesh, options.output)
    report(GraspLibrary({grasps.object_name: grasps}), options.output, {"file": str(options.file)})
    return 0
