"""``optsc study people``: plan and run a study with participants, rate workload, report."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from optsc.cli.options import (
    actions_of,
    add_output,
    add_seed,
    add_setting,
    checked_seed,
    command_line,
    from_options,
)

_DESCRIPTION = """\
A study in which every participant meets every way to share control (an arbitration policy), in counterbalanced
order and in the same scenes. Everything is kept in one folder:

  plan     writes plan.json: who does which trials in which scenes, practice included
  run      lets a participant do the trials of the next condition; started again it goes on with
           whatever is not done, and a trial that was interrupted is done again
  rate     keeps what a participant answered to the six questions of the raw NASA-TLX
  status   tells who has done what, and what comes next
  report   tables, differences within participants, and a page with figures

Each trial leaves subject_XX_cond_YY_run_ZZ_run.npz (the run) and ..._measures.json (numbers), named by the
pattern of the EUROBENCH project; each condition leaves subject_XX_cond_YY_tlx.csv."""
_EXAMPLE = """\
example: a rehearsal with simulated people, then the same with a device of your own
  optsc study people plan pilot --conditions alternating manual --participants 2 --trials 1 --practice 0
  optsc study people run pilot --participant 1 --operator typical --all
  optsc study people run pilot --participant 2 --operator typical --all
  optsc study people rate pilot --participant 1 --condition manual --answers 40 20 30 10 35 15
  optsc study people report pilot
  optsc study people run real --participant 1 --operator my_device.py:hand --ask"""
_OPERATORS = (
    "whose hand: a kind of simulated person (typical, patient, hasty, biased, mind-changing) for rehearsals; FILE.csv, "
    "a recorded hand (t,x,y,z,qw,qx,qy,qz and clutch,trigger); FOLDER of such files named "
    "subject_XX_cond_YY_run_ZZ_hand.csv; or FILE.py:FUNCTION, your device, see docs/people.md"
)


def add_people(actions: Any) -> None:
    """Add the action to those of ``optsc study``."""
    people = actions.add_parser(
        "people",
        help="a study with people: plan it, run it, ask them, compare",
        description=_DESCRIPTION,
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    steps = actions_of(people, "STEP", "step")
    for add in (_add_plan, _add_run, _add_rate, _add_status, _add_report):
        add(steps)


def _add_step(steps: Any, name: str, run: Any, *, words: str, about: str, example: str) -> Any:
    parser = steps.add_parser(name, help=words, description=about, epilog=f"example: {example}")
    parser.add_argument("study", type=Path, metavar="STUDY", help="folder of the study")
    parser.set_defaults(run=run)
    return parser


def _add_plan(steps: Any) -> None:
    plan = _add_step(
        steps,
        "plan",
        _plan,
        words="write what everybody will do",
        about="Writes STUDY/plan.json: the order of conditions for each participant (a Williams design), the trials of "
        "each condition, the seed of each scene. Trials that count have the same scenes under every condition. Later "
        "only participants can be added.",
        example="optsc study people plan pilot --conditions alternating automatic manual --participants 12 --seed 1",
    )
    plan.add_argument(
        "--conditions", nargs="+", required=True, metavar="POLICY", help="arbitration policies to compare"
    )
    plan.add_argument("--participants", type=int, required=True, metavar="N", help="how many people")
    plan.add_argument("--trials", type=int, default=6, help="that count, of each condition (default 6)")
    plan.add_argument("--practice", type=int, default=2, help="trials before those (default 2)")
    plan.add_argument("--time-limit", type=float, default=60.0, help="of a trial in seconds (default 60)")
    plan.add_argument("--robot", default="panda", help="arm (default panda)")
    add_setting(plan, level="easy")
    add_seed(plan, "scenes and orders")
    plan.add_argument("--name", help="of the study (default: that of the folder)")


def _add_run(steps: Any) -> None:
    run = _add_step(
        steps,
        "run",
        _run,
        words="let a participant do the next trials",
        about="Runs the participant's trials that are not done, up to the end of the next condition; then the "
        "person rates it. Ctrl-C stops; the trial that was interrupted is done again the next time.",
        example="optsc study people run pilot --participant 3 --operator my_device.py:hand --ask",
    )
    _add_participant(run)
    run.add_argument("--operator", required=True, metavar="HAND", help=_OPERATORS)
    run.add_argument("--all", action="store_true", help="all conditions, one after another")
    run.add_argument("--trials", type=int, metavar="N", help="at most this many trials")
    run.add_argument("--ask", action="store_true", help="ask the six questions here after each condition")
    run.add_argument("--real-time", action="store_true", help="at the pace of the clock; always so with a device")
    run.add_argument("--gui", action="store_true", help="PyBullet's window, where the plan has that follower")


def _add_rate(steps: Any) -> None:
    rate = _add_step(
        steps,
        "rate",
        _rate,
        words="keep the answers about a condition (raw NASA-TLX)",
        about="Six numbers from 0 to 100, in this order: mental, physical and temporal demand, performance (0 is "
        "perfect, 100 failure), effort, frustration. Without --answers they are asked here, one by one.",
        example="optsc study people rate pilot --participant 3 --condition manual --answers 40 20 30 10 35 15",
    )
    _add_participant(rate)
    rate.add_argument("--condition", required=True, metavar="POLICY", help="which was just done")
    rate.add_argument("--answers", nargs="+", metavar="0..100", help="the six numbers")
    rate.add_argument("--replace", action="store_true", help="put them in place of earlier answers")


def _add_status(steps: Any) -> None:
    _add_step(
        steps,
        "status",
        _status,
        words="who has done what, and what comes next",
        about="One line for each participant: trials done, the next condition, and conditions not rated yet.",
        example="optsc study people status pilot",
    )


def _add_report(steps: Any) -> None:
    report = _add_step(
        steps,
        "report",
        _report,
        words="tables, differences within participants, a page with figures",
        about="Writes trials, participants and differences as CSV and Parquet, summary.json and report.html. Practice "
        "is in the first table only. Works at any time on what is done so far.",
        example="optsc study people report pilot --reference manual",
    )
    report.add_argument("--reference", metavar="POLICY", help="compare with this (default: the plan's first)")
    add_seed(report, "the bootstrap")
    add_output(report, None, "where the report goes", otherwise="STUDY/report")


def _add_participant(parser: Any) -> None:
    parser.add_argument("--participant", type=int, required=True, metavar="N", help="who, from 1")


def _plan(options: argparse.Namespace) -> int:
    from optsc.study.participants.design import StudyDesign
    from optsc.study.participants.plan import StudyPlan

    options.name = options.name or options.study.resolve().name
    design = from_options(StudyDesign, options)
    plan = from_options(StudyPlan, options, design=design)
    # Made now, so that impossible scenes are found before people come.
    scene = plan.scene(design.blocks(1)[0].trials[0])
    path = plan.save(options.study)
    each = len(design.conditions) * (design.trials + design.practice)
    print(f"{plan.participants} participants, {len(design.conditions)} conditions, {each} trials each: {path}")
    print(f"the first scene has {', '.join(scene.objects)}; to be grasped: {scene.goal}")
    if plan.participants % design.group:
        print(f"note: the orders are balanced with a multiple of {design.group} participants")
    print(f"next: optsc study people run {options.study} --participant 1 --operator typical")
    return 0


def _run(options: argparse.Namespace) -> int:
    from optsc.cli.people_running import run_trials
    from optsc.study.participants.hand_sources import hand_source
    from optsc.study.participants.plan import StudyPlan

    plan = StudyPlan.load(options.study)
    session = plan.session(options.participant, options.study)
    return run_trials(plan, session, hand_source(options.operator), options)


def _rate(options: argparse.Namespace) -> int:
    from optsc.cli.people_running import asked
    from optsc.study.participants.plan import StudyPlan
    from optsc.study.participants.workload import Workload

    session = StudyPlan.load(options.study).session(options.participant, options.study)
    session.check_rating(options.condition, replace=options.replace)
    answers = asked(options.condition) if options.answers is None else Workload.parse(options.answers)
    path = session.rate(options.condition, answers, replace=options.replace)
    print(f"participant {options.participant}, {options.condition}: raw NASA-TLX {answers.raw:.1f}, {path}")
    return 0


def _status(options: argparse.Namespace) -> int:
    from optsc.study.participants.plan import StudyPlan

    plan = StudyPlan.load(options.study)
    for participant in range(1, plan.participants + 1):
        session = plan.session(participant, options.study)
        remaining, unrated = session.remaining, [block.condition for block in session.unrated]
        planned = sum(len(block.trials) for block in session.blocks)
        words = [f"next {session.announce(remaining[0])}" if remaining else "all trials are done"]
        words += [f"not rated yet: {', '.join(unrated)}"] if unrated else []
        print(f"participant {participant}: {planned - len(remaining)} of {planned} trials; {'; '.join(words)}")
    return 0


def _report(options: argparse.Namespace) -> int:
    from optsc.study.participants.plan import StudyPlan
    from optsc.study.participants.report import save_report

    plan, output = StudyPlan.load(options.study), options.output or options.study / "report"
    page, found = save_report(
        plan,
        options.study,
        output,
        command_line(),
        reference=options.reference,
        seed=checked_seed(options),
    )
    for one in found:
        if one.found.pairs and one.measure in ("success", "grasp_s", "tlx_raw"):
            mean = one.found.mean
            print(
                f"{one.condition} minus {one.reference}, {one.measure}: {mean.value:+.3g} "
                f"({mean.low:+.3g} to {mean.high:+.3g}), {one.found.pairs} participants"
            )
    print(f"report: {page}")
    return 0
