"""Trials of a study with participants: the hand, the policy under test, the scene, and the measures."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timezone
from functools import partial
from typing import Any

from optsc.control.arbitration import Arbitration, Trigger
from optsc.control.policies import make_policy
from optsc.errors import InvalidValue
from optsc.real_time import RealTime
from optsc.records import Tick
from optsc.study.arbitration import PolicyCondition, outcome, play
from optsc.study.episode_setup import EpisodeSetup
from optsc.study.participants.design import PlannedTrial
from optsc.study.participants.hand_sources import HandSource, TrialContext
from optsc.study.participants.participant_session import RunTrial, TrialResult
from optsc.study.participants.plan import StudyPlan


def trial_runner(
    plan: StudyPlan,
    hand: HandSource,
    *,
    real_time: bool = False,
    gui: bool = False,
    on_tick: Callable[[Tick], None] | None = None,
) -> RunTrial:
    """Return what executes the trials of ``plan``, for `optsc.study.participants.ParticipantSession`.

    Measures of a trial are those of the study of arbitration policies (`optsc.study.arbitration.REPORTED`): success is
    a grasp of the wanted object, and times and paths count up to the moment at which the jaws begin to close. Besides
    them the row says what it was: the plan, the scene and its goal, and whose hand it was.

    Args:
        plan: of the study.
        hand: where the hand comes from.
        real_time: go at the pace of the clock; always so with a live hand.
        gui: show PyBullet's window; the plan's follower has to be PyBullet.
        on_tick: called after every tick, for a live view.

    Raises:
        InvalidValue: a window without PyBullet.
    """
    if gui and plan.follower != "pybullet":
        raise InvalidValue("--gui", f"with the follower {plan.follower!r}", "with a plan whose follower is pybullet")
    paced = real_time or hand.live
    return partial(_execute, plan, hand, paced, gui, on_tick)


def _execute(
    plan: StudyPlan,
    hand: HandSource,
    paced: bool,
    gui: bool,
    on_tick: Callable[[Tick], None] | None,
    trial: PlannedTrial,
    time_limit: float,
) -> TrialResult:
    setup = EpisodeSetup(plan.scene(trial), plan.settings)
    policy = make_policy(trial.condition)
    context = TrialContext(trial, setup.scene, policy.trigger is Trigger.GRASPS)
    labels = _labels(plan, setup, policy, hand)
    about = {**trial._asdict(), "operator": hand.kind}
    clock = RealTime() if paced else None
    with setup.follower(gui=gui) as follower:
        operator = hand.operator(context)
        ticks = play(setup, policy, operator, follower, duration=time_limit, about=about, on_tick=on_tick, clock=clock)
    if clock is not None:
        labels["time_lost_s"] = clock.lost
    row = outcome(setup, ticks)
    return TrialResult(ticks, bool(row.pop("success")), {**labels, **row})


def _labels(plan: StudyPlan, setup: EpisodeSetup, policy: Arbitration, hand: HandSource) -> dict[str, Any]:
    facts = {
        "study": plan.design.name,
        "plan": plan.key,
        "policy": PolicyCondition(policy.name, policy).key,
        "robot": plan.robot,
        "level": plan.level,
        "follower": plan.follower,
        "scene": setup.scene.hash,
        "goal": setup.scene.goal,
        "operator": hand.kind,
    }
    if hand.live:  # rehearsals repeat to the byte
        facts["began"] = datetime.now(timezone.utc).isoformat(timespec="seconds")
    return facts
