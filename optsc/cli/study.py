"""``optsc study``: experiments with an answer: the paper's comparison, and the arbitration policies."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import Any

from optsc.cli.progress import shown_progress


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "study",
        help="repeat the paper's experiment, compare arbitration policies",
        epilog="example: optsc study approach --scenes 200 --seed 1 --output study-output",
    )
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    approach = actions.add_parser(
        "approach",
        help="the paper's strategy against manipulability only, from the same ready pose",
        description="In every scene a simulated person leads the arm to a ready pose and hands over; from there the "
        "robot goes to the grasp of either strategy. Paired differences with intervals, for each definition of M, and "
        "the cases where the claim fails. Finished rows are kept and skipped when started again.",
        epilog="example: optsc study approach --scenes 200 --seed 1 --output study-output",
    )
    add_case_options(approach, robots=["panda", "ur5"], scenes=200)
    approach.add_argument("--measures", nargs="+", metavar="NAME", help="definitions of M (default: all)")
    approach.set_defaults(run=_approach)
    policies = actions.add_parser(
        "arbitration",
        help="all arbitration policies on the same scenes and people",
        description="Plain runs from the first sample to the object that is carried: success, time, effort, jumps.",
        epilog="example: optsc study arbitration --scenes 100 --seed 1 --output arbitration-output",
    )
    add_case_options(policies, robots=["panda"], scenes=100)
    policies.add_argument("--policies", nargs="+", metavar="NAME", help="which (default: all)")
    policies.set_defaults(run=_arbitration)


def add_case_options(parser: Any, *, robots: list[str], scenes: int) -> None:
    """Add what every study asks: arms, scenes, people, follower, workers, output."""
    parser.add_argument(
        "--robots", nargs="+", default=robots, metavar="NAME", help=f"arms (default {robots})"
    )
    parser.add_argument("--scenes", type=int, default=scenes, help=f"scenes for each arm (default {scenes})")
    parser.add_argument("--objects", type=int, default=3, help="objects in a scene (default 3)")
    parser.add_argument("--level", default="random", help="difficulty: random, easy, medium, hard, far, ...")
    parser.add_argument("--people", nargs="+", default=["typical"], metavar="KIND", help="kinds of operators")
    parser.add_argument(
        "--repetitions", type=int, default=1, help="people of each kind in a scene (default 1)"
    )
    parser.add_argument("--follower", default="ideal", help="ideal (default) or pybullet")
    parser.add_argument("--rate", type=float, default=250.0, help="control rate in Hz (default 250)")
    parser.add_argument("--seed", type=int, default=0, help="of scenes and people (default 0)")
    parser.add_argument("--workers", type=int, help="processes (default: one for each core; 0: this one)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a Dask scheduler that computes instead")
    parser.add_argument(
        "--output", type=Path, default=Path("study-output"), metavar="DIR", help="where results go"
    )


def cases_of(options: argparse.Namespace) -> Any:
    """Return the cases that the options of `add_case_options` ask for."""
    from optsc.study.staging import Settings
    from optsc.study.sweep.plan import Cases

    return Cases(
        tuple(options.robots),
        options.scenes,
        options.seed,
        options.level,
        options.objects,
        tuple(options.people),
        options.repetitions,
        Settings(rate=options.rate, follower=options.follower),
    )


def compute(options: argparse.Namespace, jobs: Any, work: Any = None) -> Any:
    """Return the rows of ``jobs``, computed where the options say, kept below the output folder."""
    from contextlib import nullcontext

    from optsc.study.outcomes import do
    from optsc.study.sweep.runner import dask_executor, run_jobs
    from optsc.study.sweep.store import RowStore

    store = RowStore(options.output / "rows")
    place: Any = dask_executor(options.scheduler) if options.scheduler else nullcontext()
    with place as executor:
        return run_jobs(
            jobs,
            store,
            executor=executor,
            workers=options.workers,
            on_progress=shown_progress(),
            work=work or do,
        )


def command_line() -> str:
    """Return the command that runs now, to be kept with its results."""
    return shlex.join(["optsc", *sys.argv[1:]])


def _approach(options: argparse.Namespace) -> int:
    from optsc.study.approach import approach_conditions, compare, failures
    from optsc.study.approach_report import build, summary_of
    from optsc.study.output import save_rows, save_summary

    cases = cases_of(options)
    jobs = cases.jobs(approach_conditions(options.measures))
    rows = compute(options, jobs)
    comparisons, failed = compare(rows, options.seed), failures(rows)
    save_rows(rows, options.output)
    if failed:
        save_rows([failure.row() for failure in failed], options.output, "failures")
    scenes = {job.scene.hash: job.scene for job in jobs}
    page = build(rows, comparisons, failed, scenes, cases.settings, command_line()).save(options.output)
    facts = {
        "command": command_line(),
        "seed": options.seed,
        "rows": len(rows),
        **summary_of(comparisons, failed),
    }
    save_summary({**facts, "scenes": [scene.to_json() for scene in scenes.values()]}, options.output)
    for c in comparisons:
        path, time = c.differences["path_length_m"], c.differences["duration_s"]
        print(
            f"{c.robot:<6} {c.measure:<28} {path.pairs:>4} pairs: path {100 * path.relative:+6.1f} % "
            f"({path.mean.low:+.3f} to {path.mean.high:+.3f} m), time {time.mean.value:+.2f} s, d_z {path.d_z:+.2f}"
        )
    print(f"{len(failed)} cases in which some part of the claim fails\nreport: {page}")
    return 0


def _arbitration(options: argparse.Namespace) -> int:
    from optsc.study.arbitration import do_policies, policy_conditions, policy_jobs
    from optsc.study.arbitration_report import build, summary_of, text_table
    from optsc.study.output import save_rows, save_summary

    cases = cases_of(options)
    rows = compute(options, policy_jobs(cases, policy_conditions(options.policies)), do_policies)
    save_rows(rows, options.output)
    page = build(rows, command_line(), options.seed).save(options.output)
    facts = {"command": command_line(), "seed": options.seed, "rows": len(rows)}
    save_summary({**facts, **summary_of(rows, options.seed)}, options.output)
    print(f"{text_table(rows)}\nreport: {page}")
    return 0
