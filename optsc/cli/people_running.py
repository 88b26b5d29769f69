"""Trials of a participant at the terminal."""

from __future__ import annotations

import argparse
import shlex
import sys

from optsc.cli.options import check_display
from optsc.errors import InvalidValue
from optsc.study.participants.design import PlannedTrial
from optsc.study.participants.hand_sources import HandSource
from optsc.study.participants.participant_session import ParticipantSession
from optsc.study.participants.plan import StudyPlan
from optsc.study.participants.trials import trial_runner
from optsc.study.participants.workload import Workload, ask_workload


def run_trials(plan: StudyPlan, session: ParticipantSession, hand: HandSource, options: argparse.Namespace) -> int:
    """Do what the options of ``optsc study people run`` ask for, and return the exit code."""
    remaining = session.remaining
    if options.trials is not None and options.trials < 1:
        raise InvalidValue("--trials", options.trials, "1 or more")
    _check_same_hand(session, hand)
    if not remaining:
        print(f"participant {session.participant}: all trials are done")
        _say_what_to_rate(session, options)
        return 0
    check_display(options)
    run_trial = trial_runner(plan, hand, real_time=options.real_time, gui=options.gui)
    for trial in remaining[: options.trials]:
        if not options.all and trial.condition != remaining[0].condition:
            break
        scene = plan.scene(trial)
        print(f"participant {session.participant}, {session.announce(trial)}: take the {scene.goal}", flush=True)
        if hand.live and sys.stdin.isatty():
            input("press Enter to begin ")
        result = session.execute(trial, run_trial)
        outcome = "done" if result.success else f"not done ({result.measures['ended']})"
        print(f"  {outcome} after {len(result.run) / result.run.rate:.1f} s: {trial.file_name('run', 'npz')}")
        if options.ask and _ends_block(session, trial):
            session.rate(trial.condition, asked(trial.condition))
    left = len(session.remaining)
    print(f"trials left: {left}" if left else f"participant {session.participant}: all trials are done")
    _say_what_to_rate(session, options)
    return 0


def asked(condition: str) -> Workload:
    """Return what the person at the terminal answers about a condition; raise `InvalidValue` without one."""
    print(f"about {condition}:")
    try:
        return ask_workload(input)
    except EOFError:
        raise InvalidValue(
            "answers",
            None,
            "six numbers after --answers of `optsc study people rate`, or a terminal to ask at",
        ) from None


def _ends_block(session: ParticipantSession, trial: PlannedTrial) -> bool:
    return any(block.condition == trial.condition for block in session.unrated)


def _check_same_hand(session: ParticipantSession, hand: HandSource) -> None:
    """Raise `InvalidValue` where the session was begun by another kind of hand: a rehearsal is no data."""
    for block in session.blocks:
        for trial in block.trials:
            row = session.row(trial)
            if row is not None and row.get("operator") != hand.kind:
                began = f"{row.get('operator')}, as in {trial.file_name('measures', 'json')}"
                raise InvalidValue("--operator", hand.kind, f"{began}; rehearse in a folder of its own")


def _say_what_to_rate(session: ParticipantSession, options: argparse.Namespace) -> None:
    for block in session.unrated:
        rest = ["--participant", str(session.participant), "--condition", block.condition]
        print("to be rated: " + shlex.join(["optsc", "study", "people", "rate", str(options.study), *rest]))
