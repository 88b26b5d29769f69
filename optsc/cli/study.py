"""``optsc study``: the paper's comparison of grasp choices, the arbitration policies, human participants."""

from __future__ import annotations

import argparse
from typing import Any

from optsc.cli.cases import add_case_options, cases_of, compute, kept_rows
from optsc.cli.options import actions_of, command_line
from optsc.cli.people import add_people

BUILT_IN = (
    *("alternating", "automatic", "continuous", "hindsight optimisation"),
    *("linear blending", "manual", "product of experts", "virtual fixture"),
)
"""Names of `optsc.control.policies.POLICIES`, here so that help needs no library."""


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "study",
        help="repeat the paper's experiment, compare arbitration policies, run studies with human participants",
        epilog="example: optsc study approach --scenes 200 --seed 1 --output study-output",
    )
    actions = actions_of(parser)
    approach = actions.add_parser(
        "approach",
        help="the paper's strategy against manipulability only, from the same ready pose",
        description="In every scene a simulated operator moves the arm to a ready pose and hands over; from there the "
        "robot goes to the grasp of either strategy. Paired differences with intervals, for each definition of M, and "
        "the cases where the claim fails. Finished rows are kept and skipped when started again.",
        epilog="example: optsc study approach --scenes 200 --seed 1 --output study-output",
    )
    add_case_options(approach, robots=["panda", "ur5"], scenes=200, output="study-output")
    approach.add_argument("--measures", nargs="+", metavar="NAME", help="definitions of M (default: all)")
    approach.set_defaults(run=_approach)
    policies = actions.add_parser(
        "arbitration",
        help="all arbitration policies on the same scenes and people",
        description="Plain runs from the first sample to the object that is carried: success, time, effort, jumps. "
        f"Built in are {', '.join(BUILT_IN)}; a user-defined policy is named by where it is, see docs/arbitration.md.",
        epilog="example: optsc study arbitration --scenes 100 --seed 1 --output arbitration-output",
    )
    add_case_options(policies, robots=["panda"], scenes=100, output="study-output", longest=60.0)
    policies.add_argument(
        "--policies",
        nargs="+",
        metavar="POLICY",
        help="names of built-in ones, or user-defined ones as FILE.py:NAME or MODULE:NAME, a class or a function "
        "without arguments (default: all that are built in)",
    )
    policies.set_defaults(run=_arbitration)
    add_people(actions)


def _approach(options: argparse.Namespace) -> int:
    from optsc.study.approach import approach_conditions, compare, failures
    from optsc.study.approach_report import build, summary_of
    from optsc.study.results_folder import save_rows, save_summary

    cases = cases_of(options)
    jobs = cases.jobs(approach_conditions(options.measures))
    with kept_rows(options):
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
    from optsc.study.arbitration import do_policies, policy_conditions
    from optsc.study.arbitration_report import build, summary_of, text_table
    from optsc.study.results_folder import save_rows, save_summary

    cases = cases_of(options)
    jobs = cases.policy_jobs(policy_conditions(options.policies))
    with kept_rows(options):
        rows = compute(options, jobs, work=do_policies)
    save_rows(rows, options.output)
    page = build(rows, command_line(), options.seed, jobs).save(options.output)
    facts = {"command": command_line(), "seed": options.seed, "rows": len(rows)}
    save_summary({**facts, **summary_of(rows, options.seed)}, options.output)
    print(f"{text_table(rows)}\nreport: {page}")
    return 0
