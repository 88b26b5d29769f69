"""``optsc replay``: look at a recorded run again, or run it again."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "replay",
        help="look at a recorded run, or run it again",
        description="Makes one HTML file of a run that `optsc teleop --output` recorded: it shows what the page "
        "showed, with a scrubber, and asks for nothing else.",
        epilog="example: optsc replay teleop-output --again",
    )
    parser.add_argument("folder", type=Path, metavar="RUN", help="folder of the run")
    parser.add_argument("--html", type=Path, metavar="FILE", help="where the page goes (default: RUN/replay.html)")
    parser.add_argument(
        "--again", action="store_true", help="feed what came in to the controller again, and compare its commands"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Make the page, or run again; 1 where a command differs."""
    from optsc.live.run_folder import RunFolder

    folder = RunFolder(options.folder)
    if not options.again:
        from optsc.live.site import single_file

        path = options.html or options.folder / "replay.html"
        path.write_bytes(single_file(folder.frames()))
        print(f"page: {path} ({path.stat().st_size / 1e6:.1f} MB)")
        return 0
    from optsc.live.rerun import rerun

    outcome = rerun(folder)
    print(f"{outcome.ticks} ticks run again, {outcome.differing} with another command")
    if outcome.missing:
        print(f"{outcome.missing} ticks follow on some that were not recorded, and were left out")
    return 1 if outcome.differing else 0
