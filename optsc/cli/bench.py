"""``optsc bench``: put the motion core to the test."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from typing import Any

from optsc.cli import bench_faults, bench_rest
from optsc.cli.options import actions_of, add_output, add_seed, checked_seed


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "bench",
        help="put the motion core to the test",
        epilog="example: optsc bench soak --ticks 200000 --seed 1 --output soak-output",
    )
    actions = actions_of(parser)
    soak = actions.add_parser(
        "soak",
        help="hostile input to the servo, every command checked",
        description="Random arms, rates, starts and hostile streams of targets; counts commands that break a "
        "position, velocity, acceleration or jerk limit, and exceptions. Exit code 0 when there are none.",
        epilog="example: optsc bench soak --ticks 200000 --seed 1 --output soak-output",
    )
    soak.add_argument("--ticks", type=int, default=1_000_000, help="how many at least (default 1000000)")
    add_seed(soak, "everything random")
    soak.add_argument("--robots", nargs="+", metavar="NAME", help="arms to draw from (default: all)")
    soak.add_argument("--streams", nargs="+", metavar="NAME", help="kinds of input to draw from (default: all)")
    soak.add_argument("--episode", type=int, metavar="N", help="run this one episode of the soak again, alone")
    add_output(soak, None, "where summary.json goes")
    soak.set_defaults(run=_soak)
    bench_faults.add_parser(actions)
    bench_rest.add_parser(actions)


def _soak(options: argparse.Namespace) -> int:
    from optsc.robot import ROBOT_NAMES
    from optsc.study.soak import STREAMS, Soak, run_episode, soak

    robots, streams = tuple(options.robots or ROBOT_NAMES), tuple(options.streams or STREAMS)
    checked_seed(options)
    if options.episode is None:
        show = _progress(options.ticks)
        result = soak(options.ticks, seed=options.seed, robots=robots, streams=streams, progress=show)
    else:
        result = Soak(options.seed)
        result.add(run_episode(options.seed, options.episode, robots, streams))
    summary = {**result.summary(), "robots": list(robots), "streams": list(streams)}
    if options.output is not None:
        options.output.mkdir(parents=True, exist_ok=True)
        (options.output / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    _print(summary)
    return 0 if result.passed else 1


def _progress(ticks: int) -> Any:
    if not sys.stderr.isatty():
        return None

    def show(result: Any) -> None:
        if result.episodes % 10 == 0 or result.ticks >= ticks:
            end = "\n" if result.ticks >= ticks else ""
            print(f"\r{result.ticks} of {ticks} ticks", end=end, file=sys.stderr, flush=True)

    return show


def _print(summary: dict[str, Any]) -> None:
    print(f"{summary['ticks']} ticks in {summary['episodes']} episodes, seed {summary['seed']}")
    print("violations: " + ", ".join(f"{kind} {n}" for kind, n in summary["violations"].items()))
    print(f"exceptions: {summary['exceptions']}")
    share = {status: 100.0 * n / max(summary["ticks"], 1) for status, n in summary["statuses"].items()}
    print("statuses: " + ", ".join(f"{status} {percent:.1f} %" for status, percent in share.items()))
    drawn = f"--robots {' '.join(summary['robots'])} --streams {shlex.join(summary['streams'])}"
    for failure in summary["failures"][:10]:
        broken = ", ".join(f"{kind} {n}" for kind, n in failure["violations"].items() if n)
        what = failure["exception"] or broken
        print(
            f"  episode {failure['episode']} ({failure['robot']}, {failure['rate']:.0f} Hz, started "
            f"{failure['started']}): {what}; again: --seed {summary['seed']} --episode {failure['episode']}"
        )
    if summary["failures"]:
        print(f"  an episode is the same again with the same {drawn}")
