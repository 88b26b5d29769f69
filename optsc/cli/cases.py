"""Options of studies with simulated people: which cases there are, and where their rows are computed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

from optsc.cli.options import add_output, add_seed, add_setting, command_line, from_options
from optsc.cli.progress import shown_progress

PEOPLE = "typical, patient, hasty, biased; in study arbitration also mind-changing"
"""`optsc.people.TYPES` in words, so that showing the help loads nothing."""


def add_case_options(parser: Any, *, robots: list[str], scenes: int, output: str, longest: float = 30.0) -> None:
    """Add what every study asks: arms, scenes, people, follower, workers, output."""
    arms = ", ".join(robots)
    parser.add_argument("--robots", nargs="+", default=robots, metavar="NAME", help=f"arms (default {arms})")
    parser.add_argument("--scenes", type=int, default=scenes, help=f"scenes for each arm (default {scenes})")
    add_setting(parser, level="random")
    parser.add_argument(
        "--people",
        nargs="+",
        default=["typical"],
        metavar="KIND",
        help=f"kinds of simulated operators: {PEOPLE} (default typical)",
    )
    parser.add_argument("--repetitions", type=int, default=1, help="people of each kind in a scene (default 1)")
    parser.add_argument(
        "--longest",
        type=float,
        default=longest,
        help=f"seconds before it counts as failed (default {longest:g})",
    )
    parser.add_argument(
        "--library", metavar="DIR", help="a stored grasp library to choose from (default: sampled grasps)"
    )
    add_seed(parser, "scenes and people")
    parser.add_argument("--workers", type=int, help="processes (default: one for each core; 0: this one)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a Dask scheduler that computes instead")
    add_output(parser, output)


def cases_of(options: argparse.Namespace) -> Any:
    """Return the cases that the options of `add_case_options` ask for."""
    from optsc.study.cases import Cases
    from optsc.study.episode_setup import EpisodeSettings

    return from_options(Cases, options, settings=from_options(EpisodeSettings, options))


@contextmanager
def kept_rows(options: argparse.Namespace) -> Iterator[None]:
    """Say on an interrupt what is kept and how to continue."""
    try:
        yield
    except KeyboardInterrupt:
        print(
            f"\nfinished rows are kept in {options.output / 'rows'}; to go on: {command_line()}",
            file=sys.stderr,
        )
        raise


@contextmanager
def computing(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Give the arguments of `optsc.study.run_jobs` that say where it computes, on a Dask cluster or this machine."""
    from optsc.study.sweep.runner import dask_executor

    with dask_executor(options.scheduler) if options.scheduler else nullcontext() as executor:
        yield {"executor": executor, "workers": options.workers, "on_progress": shown_progress()}


def compute(options: argparse.Namespace, jobs: Any, **work: Any) -> Any:
    """Return the rows of ``jobs``, computed where the options say, kept below the output folder."""
    from optsc.study.sweep.runner import run_jobs
    from optsc.study.sweep.store import RowStore

    store = RowStore(options.output / "rows")
    with computing(options) as where:
        return run_jobs(jobs, store, **where, **work)
