"""The command line: one file per subcommand."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence

import optsc
from optsc.errors import OptscError

_COMMANDS = ("bench", "demo", "doctor", "grasps", "replay", "study", "sweep", "teleop")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``optsc`` and return its exit code: 0 done, 1 an error of the user's or the machine's, 2 wrong usage."""
    parser = argparse.ArgumentParser(
        prog="optsc",
        description="Optimization-based shared control.",
        epilog="example: optsc demo --seed 3 --output demo-output",
    )
    parser.add_argument("--version", action="version", version=f"optsc {optsc.__version__}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name in _COMMANDS:
        importlib.import_module(f"optsc.cli.{name}").add_parser(subparsers)
    options = parser.parse_args(arguments)
    try:
        return options.run(options)
    except OptscError as error:
        print(f"optsc {options.command}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"optsc {options.command}: stopped", file=sys.stderr)
        return 1
