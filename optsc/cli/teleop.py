"""``optsc teleop``: drive a simulated arm from a web page."""

from __future__ import annotations

import argparse
import webbrowser
from typing import Any

from optsc.cli.options import add_output, add_seed, checked_seed
from optsc.errors import InvalidValue


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "teleop",
        help="drive a simulated arm from a web page",
        description="Serves a page from which a person drives the arm: with the mouse, held keys, a gamepad or a "
        "headset. The page shows which grasp the robot would take; a press hands over to it, and whoever takes "
        "hold of the arm has it back. Ends with Ctrl-C.",
        epilog="example: optsc teleop --robot ur5 --objects mug bottle drill --seed 3",
    )
    parser.add_argument("--robot", default="panda", help="panda (default), ur5, iiwa or xarm7")
    parser.add_argument("--follower", default="pybullet", help="pybullet (default), a simulated world, or ideal")
    parser.add_argument("--objects", nargs="+", default=["mug", "can", "box"], metavar="NAME", help="what lies there")
    add_seed(parser, "the scene")
    add_output(parser, None, "folder that the run is recorded in")
    parser.add_argument("--rate", type=float, default=500.0, help="control rate in Hz (default 500)")
    parser.add_argument(
        "--timeout",
        type=float,
        default=0.1,
        metavar="SECONDS",
        help="after so long without a word from the page the arm holds (default 0.1); more for a slow network",
    )
    parser.add_argument(
        "--listen",
        metavar="ADDRESS",
        help="serve other machines too, such as a headset, at this address or 0.0.0.0: https, with a new token",
    )
    parser.add_argument("--port", type=int, default=0, help="port of the page (default: a free one)")
    parser.add_argument("--no-browser", action="store_true", help="only print the address")
    parser.add_argument("--light", action="store_true", help="coarse surfaces without shadows, for slow graphics")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Serve until interrupted."""
    from optsc.live.access import Access
    from optsc.live.live_session import LiveSession
    from optsc.live.scene import LiveScene, SceneChoice

    choice = SceneChoice(
        robot=options.robot,
        objects=tuple(options.objects),
        seed=checked_seed(options),
        follower=options.follower,
        rate=options.rate,
        timeout=options.timeout,
    )
    access = Access.network(options.listen, options.port) if options.listen else Access.local(options.port)
    if options.output and options.output.exists() and any(options.output.iterdir()):
        raise InvalidValue("--output", str(options.output), "a folder that is not there or empty")

    def say(text: str) -> None:
        print(text, flush=True)

    scene = LiveScene(choice)
    print(f"scene {choice.seed}: {choice.robot} with {', '.join(choice.objects)}", flush=True)
    with LiveSession(scene, access, options.light, options.output, say) as session:
        address = session.access.address + (("&light" if "?" in session.access.address else "?light") * options.light)
        print(f"\n  {address}\n", flush=True)
        if session.access.secure:
            print("The certificate was made on this machine: the browser asks once whether to trust it.")
            print(f"Also at: {', '.join(session.access.names[1:])}")
        if not options.no_browser:
            webbrowser.open(address)
        print("Ctrl-C ends the session.", flush=True)
        try:
            session.watch()
        except KeyboardInterrupt:
            print("\nending")
    if options.output:
        print(f"recorded in {options.output}; look at it again with: optsc replay {options.output}")
    return 0
