"""``optsc bench rest``: whether arms come to rest beyond reach and against obstacles, and say the truth."""

from __future__ import annotations

import argparse
import json
from typing import Any

from optsc.cli.options import add_output, add_seed, checked_seed
from optsc.cli.progress import counted_progress

_EXAMPLE = "example: optsc bench rest --arms xarm7 ur3 --rules slow --count 20 --output rest-output"
SHOWN = 20
"""Failures that are printed; all are in summary.json."""


def add_parser(actions: Any) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "rest",
        help="targets out of reach or inside obstacles: do the arms come to rest?",
        description="Targets come in and rest: beyond reach, turned at random, at the end of reach, inside obstacles. "
        "Two seconds later every joint has to be slower than 0.01 rad/s, for two seconds, and the status true. Exit "
        "code 0 when all are.",
        epilog=_EXAMPLE,
    )
    parser.add_argument("--count", type=int, default=20, help="episodes of each arm and rule of limits (default 20)")
    parser.add_argument("--arms", nargs="+", metavar="NAME", help="arms (default: all of the test)")
    parser.add_argument("--rules", nargs="+", metavar="NAME", help="limits: own, default, slow (default: all)")
    add_seed(parser, "everything random")
    add_output(parser, None, "where summary.json goes")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    from optsc.study.rest import ARMS, RULES, rest

    count = counted_progress()
    found = rest(
        options.count,
        seed=checked_seed(options),
        arms=options.arms or ARMS,
        rules=options.rules or RULES,
        progress=lambda done, of: count("episodes", done, of),
    )
    summary = found.summary()
    if options.output is not None:
        options.output.mkdir(parents=True, exist_ok=True)
        (options.output / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    print(
        f"{summary['episodes']} episodes, seed {summary['seed']}: {summary['moving']} moved after two seconds, "
        f"{summary['moving_at_end']} of them still at the end; {summary['untrue']} untrue"
    )
    print("statuses: " + ", ".join(f"{status} {n}" for status, n in summary["statuses"].items()))
    for failure in summary["failures"][:SHOWN]:
        print("  " + ", ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in failure.items()))
    return 0 if found.passed else 1
