"""Command-line options that several subcommands share, and how settings are made of them."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar, cast

from optsc.errors import InvalidValue

T = TypeVar("T")


def command_line() -> str:
    """Return the command that runs now, to be kept with its results."""
    return shlex.join(["optsc", *sys.argv[1:]])


def add_output(parser: Any, default: str | None, what: str = "where results go", *, otherwise: str = "nowhere") -> None:
    """Add ``--output DIR``; without a default it is None unless it is given, which means ``otherwise``."""
    shown = f"{what} (default {default})" if default else f"{what} (default: {otherwise})"
    parser.add_argument("--output", type=Path, default=default and Path(default), metavar="DIR", help=shown)


def add_seed(parser: Any, of: str) -> None:
    """Add ``--seed``, of whatever ``of`` says."""
    parser.add_argument("--seed", type=int, default=0, help=f"of {of} (default 0)")


def checked_seed(options: argparse.Namespace) -> int:
    """Return the seed that was given; raise `InvalidValue` below 0."""
    if options.seed < 0:
        raise InvalidValue("--seed", options.seed, "0 or more")
    return int(options.seed)


def add_objects(parser: Any, everything: str = "all") -> None:
    """Add ``--objects NAME ...``, by default ``everything``."""
    parser.add_argument("--objects", nargs="+", metavar="NAME", help=f"only these (default: {everything})")


def add_gripper(parser: Any) -> None:
    """Add ``--gripper``."""
    parser.add_argument("--gripper", default="panda_hand", help="for which gripper (default panda_hand)")


def add_setting(parser: Any, *, level: str) -> None:
    """Add what scenes and runs of a study are like: objects, difficulty, follower, rate."""
    parser.add_argument("--objects", type=int, default=3, help="objects in a scene (default 3)")
    parser.add_argument(
        "--level",
        default=level,
        help=f"difficulty: random, easy, medium, hard, far, cluttered or near-limits (default {level})",
    )
    parser.add_argument("--follower", default="ideal", help="ideal (default) or pybullet")
    parser.add_argument("--rate", type=float, default=250.0, help="control rate in Hz (default 250)")


def from_options(cls: type[T], options: argparse.Namespace, **given: Any) -> T:
    """Return the dataclass ``cls`` with the options that are called like its fields, and what else is ``given``."""
    from optsc.checks import from_mapping

    named = {field.name for field in fields(cast(Any, cls))}
    return from_mapping(cls, {n: x for n, x in vars(options).items() if n in named} | given)


def actions_of(parser: Any, metavar: str = "ACTION", dest: str = "action") -> Any:
    """Return what the actions of a subcommand are added to."""
    return parser.add_subparsers(dest=dest, required=True, metavar=metavar)


def check_display(options: argparse.Namespace) -> None:
    """Raise `InvalidValue` where a window is asked for and there is nowhere to show it."""
    if options.gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise InvalidValue("--gui", "no display", "a machine with a display; without --gui it runs headless")
