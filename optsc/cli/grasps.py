"""``optsc grasps``: build grasp libraries, and look at stored ones."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "grasps",
        help="build grasp libraries, and look at stored ones",
        epilog="example: optsc grasps build --objects mug can --output grasps && optsc grasps show grasps",
    )
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    build = actions.add_parser("build", help="sample grasps of objects and store them")
    build.add_argument(
        "--objects", nargs="+", metavar="NAME", help="which objects (default: all that come along)"
    )
    build.add_argument("--gripper", default="panda_hand", help="for which gripper (default panda_hand)")
    build.add_argument("--seed", type=int, default=0, help="of the sampling (default 0)")
    build.add_argument("--output", type=Path, default=Path("grasps"), metavar="DIR", help="where they go")
    build.set_defaults(run=_build)
    show = actions.add_parser("show", help="list what a folder of grasps holds")
    show.add_argument("directory", type=Path)
    show.set_defaults(run=_show)


def _build(options: argparse.Namespace) -> int:
    from optsc.grasps import build_library
    from optsc.robot import gripper
    from optsc.sim import OBJECT_NAMES, object_model

    meshes = {name: object_model(name).mesh for name in options.objects or OBJECT_NAMES}
    library = build_library(
        meshes,
        gripper(options.gripper),
        seed=options.seed,
        directory=options.output,
        progress=lambda name, done, total: print(f"\r{name}: {done} of {total}   ", end="", flush=True),
    )
    print()
    return _describe(library)


def _show(options: argparse.Namespace) -> int:
    from optsc.grasps import GraspLibrary

    return _describe(GraspLibrary.load(options.directory))


def _describe(library: Any) -> int:
    for name in sorted(library):
        grasps = library[name]
        print(
            f"{name}: {len(grasps.opening)} grasps for {grasps.gripper}, "
            f"opening {1e3 * grasps.opening.min():.0f} to {1e3 * grasps.opening.max():.0f} mm, "
            f"quality {grasps.quality.min():.2f} to {grasps.quality.max():.2f}"
        )
        for key, value in sorted(grasps.provenance.items()):
            print(f"  {key}: {value}")
    return 0
