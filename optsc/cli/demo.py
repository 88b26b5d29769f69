"""``optsc demo``: the paper's system at work on a simulated arm."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from optsc.cli.options import add_output, add_seed, check_display, checked_seed

DEFAULT_OBJECTS = ("mug", "can", "box")


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "demo",
        help="see the paper's system at work on a simulated arm",
        description="A simulated operator moves towards three objects, the robot takes over and grasps them; "
        "then once more with the grasp of best manipulability only. Prints both and saves a picture.",
        epilog="example: optsc demo --robot ur5 --seed 3 --output demo-output",
    )
    parser.add_argument("--robot", default="panda", help="panda (default), ur5, iiwa or xarm7")
    parser.add_argument("--objects", nargs="+", default=list(DEFAULT_OBJECTS), metavar="NAME", help="what lies there")
    add_seed(parser, "the scene and the operator")
    parser.add_argument("--rate", type=float, default=500.0, help="control rate in Hz (default 500)")
    add_output(parser, "demo-output")
    parser.add_argument("--library", type=Path, metavar="DIR", help="where grasps are kept (default: the user's cache)")
    parser.add_argument(
        "--perception",
        action="store_true",
        help="grasps from a simulated depth camera alone, instead of from known objects",
    )
    window = parser.add_mutually_exclusive_group()
    window.add_argument("--headless", action="store_true", help="no window (the default)")
    window.add_argument("--gui", action="store_true", help="show PyBullet's window; needs a display")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the demonstration; a failed lift is a result, not an error."""
    from optsc.demo.demonstration import run_demo
    from optsc.demo.summary import save, table
    from optsc.robot import load_robot

    check_display(options)
    checked_seed(options)
    print(f"scene {options.seed}: {options.robot} with {', '.join(options.objects)}")
    demo = run_demo(
        load_robot(options.robot),
        objects=options.objects,
        seed=options.seed,
        rate=options.rate,
        library=options.library,
        gui=options.gui,
        say=lambda text: print(text, flush=True),
        perception=options.perception,
    )
    facts = save(demo, options.output)
    print(f"\nfrom the switch to the grasp:\n{table(demo)}\n")
    kinds = ", ".join(f"{kind} {count}" for kind, count in facts["limit_violations"].items())
    print(f"{facts['ticks']} ticks, median {facts['tick_p50_us']:.0f} us, p99 {facts['tick_p99_us']:.0f} us")
    print(f"limit violations: {kinds}; interventions: {facts['interventions']}")
    if options.perception:
        print(f"camera observation: {options.output / 'seen.png'}")
    print(f"picture: {options.output / 'approach.png'}\nnumbers: {options.output / 'summary.json'}")
    return 0
