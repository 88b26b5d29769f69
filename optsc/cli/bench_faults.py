"""``optsc bench faults``: every fault in every control mode, every answer checked."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from optsc.cli.options import add_output, add_seed, checked_seed
from optsc.cli.progress import counted_progress

_EXAMPLE = "example: optsc bench faults --arms panda --modes manual close --faults solver jaws --output faults-output"
SHOWN = 30
"""Failures that are printed; all are in summary.json."""


def add_parser(actions: Any) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "faults",
        help="faults of clocks, samples, readings, jaws, users' parts and people, every answer checked",
        description="Drives the shared controller into every mode, does one thing wrong, and holds its answer to the "
        "one that was expected: no exception, all limits kept, no untrue status, and an arm that can be led on. "
        "Exit code 0 when all runs pass.",
        epilog=_EXAMPLE,
    )
    parser.add_argument("--arms", nargs="+", metavar="NAME", help="arms (default: panda ur5 j2s6s200)")
    parser.add_argument("--modes", nargs="+", metavar="NAME", help="control modes (default: all)")
    parser.add_argument(
        "--faults", nargs="+", metavar="WORDS", help="faults by name, kind, or words of their name (default: all)"
    )
    parser.add_argument("--rate", type=float, default=250.0, help="control rate in Hz (default 250)")
    parser.add_argument("--workers", type=int, default=0, help="processes (default 0: this one)")
    parser.add_argument(
        "--page", type=Path, metavar="FILE", help="write the table of faults and answers, and run nothing"
    )
    add_seed(parser, "everything random")
    add_output(parser, None, "where summary.json goes")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    from optsc.study.faults.arms import DEFAULT_ARMS
    from optsc.study.faults.bench import MODES, bench
    from optsc.study.faults.catalogue import chosen
    from optsc.study.faults.page import page

    if options.page is not None:
        options.page.write_text(page(), encoding="utf-8")
        return 0
    count = counted_progress()
    test = bench(
        chosen(options.faults),
        arms=options.arms or DEFAULT_ARMS,
        modes=options.modes or MODES,
        seed=checked_seed(options),
        rate=options.rate,
        workers=options.workers,
        progress=lambda done, of: count("runs", done, of),
    )
    summary = {"seed": options.seed, "rate": options.rate, **test.summary()}
    if options.output is not None:
        options.output.mkdir(parents=True, exist_ok=True)
        (options.output / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    _print(summary, MODES)
    return 0 if test.passed else 1


def _print(summary: dict[str, Any], modes: tuple[str, ...]) -> None:
    shown = [mode for mode in modes if mode in summary["modes"]]
    print(f"{'failed/runs':12}" + "".join(f"{mode:>10}" for mode in shown))
    for kind, row in summary["table"].items():
        cells = (f"{row[mode]['failed']}/{row[mode]['runs']}" if mode in row else "-" for mode in shown)
        print(f"{kind:12}" + "".join(f"{cell:>10}" for cell in cells))
    print(
        f"{summary['faults']} faults, {len(shown)} modes, {len(summary['arms'])} arms, seed {summary['seed']}: "
        f"{summary['runs']} runs, {summary['failed']} failed, {summary['exceptions']} with an exception, "
        f"{summary['untrue']} with an untrue status"
    )
    for failure in summary["failures"][:SHOWN]:
        print(f"  {failure['fault']}, {failure['mode']}, {failure['arm']}: expected {failure['expected']}")
        for problem in failure["problems"]:
            print(f"    {problem}")
        print(f"    again: {failure['again']}")
    if len(summary["failures"]) > SHOWN:
        print(f"  and {len(summary['failures']) - SHOWN} more")
