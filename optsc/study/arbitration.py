"""Arbitration study: all policies on the same scenes and operators; success, time, effort, smoothness.

Other than in the comparison of grasp choices, the hand matters during the whole episode, so every episode is a plain
run from the first sample to the object that is carried, or to the time limit.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from functools import cached_property
from itertools import pairwise
from math import nan
from typing import Any

import numpy as np

from optsc.control.arbitration import Arbitration, Trigger
from optsc.control.modes import Mode
from optsc.control.policies import POLICIES, make_policy
from optsc.errors import InvalidValue, Mismatch, UnknownName
from optsc.followers import Follower
from optsc.geometry import Pose
from optsc.metrics import (
    Motion,
    interaction_measures,
    is_lifted,
    motion_measures,
    stretch_smoothness,
    time_in_mode,
    worst_jumps,
)
from optsc.operators import Operator
from optsc.people.simulated import R_WS_DEFAULT
from optsc.real_time import RealTime
from optsc.records import Run, Tick
from optsc.session import run
from optsc.study.cases import Job
from optsc.study.conditions import OperatorSpec
from optsc.study.episode_setup import EpisodeSetup, nearest_distance
from optsc.study.fingerprint import fingerprint, plain
from optsc.study.loading import absolute, load_named
from optsc.study.outcomes import JUMPS, Row

VERSION = 3
"""Version of what a row means; part of every key."""
TIMES = tuple(f"time_{mode.value}_s" for mode in Mode)
"""Time in each mode of the whole episode [s]; they add up to ``whole_s``."""
REPORTED = (
    *("grasp_s", "effort_m", "intervention", "agreement", "disagreement", "switches", "path_length_m"),
    *("rotation_rad", "ldlj_tool", "ldlj_turn", "ldlj_joint", "sparc_tool", "sparc_turn", "sparc_joint"),
    *("stretches", "moving_s", "clearance_m", "limit_margin_share"),
    *JUMPS,
)
"""Numbers of a row, taken up to the moment at which the jaws begin to close for the last time.

Smoothness is of the stretches in which something moves, what the hand leads and what the robot does by itself apart,
weighted by their durations, with their number and their time beside it (`optsc.metrics.stretch_smoothness`): a
policy that waits, or has the operator wait, is no less smooth for it. Jumps are the worst of each part over all changes
of mode of the whole episode, closing the jaws included. The distances d_l and d_a are those at which the operator hands
over: from the tool to its target at the first tick of the new mode. Where the robot goes on by itself, to the grasp or
to lift, they are of its own making and do not count.
"""
_POLICY = ("name", "trigger", "assists", "aim", "blend", "begins")


@dataclass(frozen=True)
class PolicyCondition:
    """A policy under test, by its name in tables.

    Attributes:
        name: for tables.
        policy: with its settings.
        source: where it was loaded from, as `policy_condition` takes it, so that another process can do the same;
            empty for one that any process can import.
    """

    name: str
    policy: Arbitration
    source: str = ""

    @cached_property
    def key(self) -> str:
        """Hash of the policy and its settings, and of its code where it is not this library's own."""
        policy: Any = self.policy
        settings = plain(policy) if is_dataclass(policy) else plain([type(policy), vars(policy)])
        return fingerprint([VERSION, type(policy).__name__, settings])

    def labels(self) -> Row:
        """Return what tables say about it."""
        return {"condition": self.name}

    def __reduce__(self) -> tuple[Any, ...]:
        if self.source:
            return _loaded_again, (self.source, self.key)
        return PolicyCondition, (self.name, self.policy)


def policy_condition(text: str) -> PolicyCondition:
    """Return the policy that ``text`` names: a built-in one, or else ``FILE.py:NAME`` or ``MODULE:NAME``.

    ``NAME`` is a policy, its class, or a function without arguments that returns one.

    Raises:
        UnknownName: there is none of that name.
        DamagedFile: there is no such file or module, or it cannot be imported.
        InvalidValue: what it names is no policy.
    """
    if text in POLICIES:
        return PolicyCondition(text, make_policy(text))
    if ":" not in text:
        raise UnknownName("arbitration policy", text, [*POLICIES, "FILE.py:NAME", "MODULE:NAME"])
    policy = load_named(text)
    if callable(policy):
        try:
            inspect.signature(policy).bind()
        except (TypeError, ValueError) as error:
            raise InvalidValue(text, policy, f"something that can be called without arguments ({error})") from None
        policy = policy()
    missing = [name for name in _POLICY if not hasattr(policy, name)]
    if missing:
        raise InvalidValue(text, policy, f"an arbitration policy; it has no {', '.join(missing)}")
    return PolicyCondition(policy.name, policy, absolute(text))


def _loaded_again(source: str, expected: str) -> PolicyCondition:
    """Return a policy from its file once more, in another process; raise `Mismatch` when the file has changed."""
    condition = policy_condition(source)
    if condition.key != expected:
        raise Mismatch(f"the study with {source}", expected, condition.key)
    return condition


def policy_conditions(names: Sequence[str] | None = None) -> tuple[PolicyCondition, ...]:
    """Return the policies of these names, by default all built-in ones; see `policy_condition`.

    Raises `InvalidValue` besides when two go by the same name, as their rows could not be distinguished.
    """
    conditions = tuple(policy_condition(name) for name in names or sorted(POLICIES))
    called = [condition.name for condition in conditions]
    if len(set(called)) < len(called):
        raise InvalidValue("names of the policies", called, "each once")
    return conditions


def do_policies(job: Job[PolicyCondition]) -> list[Row]:
    """Return one row for each policy of ``job``."""
    setup = EpisodeSetup(job.scene, job.settings)
    rows = []
    for condition, row_key in zip(job.conditions, job.keys(), strict=True):
        rows.append({"key": row_key, **outcome(setup, simulated(setup, job.person, condition.policy))})
    return rows


def simulated(setup: EpisodeSetup, person: OperatorSpec, policy: Arbitration) -> Run:
    """Return the run of one episode of a simulated person under ``policy``; who has to grasp by hand does."""
    by_hand = policy.trigger is Trigger.GRASPS
    operator = person.operator(setup.scene.goal, setup.scene.objects, by_hand=by_hand)
    with setup.follower() as follower:
        return play(setup, policy, operator, follower, duration=setup.settings.longest)


def play(
    setup: EpisodeSetup,
    policy: Arbitration,
    operator: Operator,
    follower: Follower,
    *,
    duration: float,
    about: Mapping[str, Any] | None = None,
    on_tick: Callable[[Tick], None] | None = None,
    clock: RealTime | None = None,
) -> Run:
    """Return the run of one episode under ``policy``, the grasp chosen as the paper does; see `optsc.session.run`."""
    return run(
        setup.controller(setup.paper, arbitration=policy),
        operator=operator,
        follower=follower,
        candidates=setup.candidates,
        clear=setup.clear,
        rate=setup.settings.rate,
        duration=duration,
        about={"policy": policy.name, "goal": setup.scene.goal, **(about or {})},
        on_tick=on_tick,
        clock=clock,
    )


def outcome(setup: EpisodeSetup, ticks: Run) -> Row:
    """Return what became of an episode: numbers of `REPORTED` and `TIMES`, and whether the wanted object was grasped.

    With an ideal follower, success means that the jaws closed at a grasp of the wanted object and the arm went on to
    carry it; in a simulated world, that the object was really lifted.
    """
    motion = Motion.of_run(ticks, setup.robot)
    closings = [i for i in ticks.switches() if ticks.modes[i] is Mode.CLOSE]
    end = closings[-1] if closings else len(motion)
    target = ticks[end].step.target if closings else None
    carried = ticks.modes[-1] is Mode.CARRY
    success = carried and target is not None and target.object_name == setup.scene.goal
    if setup.settings.follower == "pybullet":
        heights = np.array([tick.objects[setup.scene.goal].translation[2] for tick in ticks])
        success = is_lifted(heights, ticks.rate)
    measured = _measured(setup, ticks, motion, end)
    row: dict[str, Any] = {name: measured.get(name, nan) for name in REPORTED if name != "grasp_s"}
    times = time_in_mode(motion.modes, motion.rate)
    return {
        "success": bool(success),
        "ended": ticks.modes[-1].value,
        "object": "" if target is None else target.object_name,
        "whole_s": len(motion) / motion.rate,
        "grasp_s": end / motion.rate if success else nan,
        "manual_s": measured.get("time_manual_s", 0.0),
        **row,
        **{name: times.get(mode.value, 0.0) for name, mode in zip(TIMES, Mode, strict=True)},
    }


def _measured(setup: EpisodeSetup, ticks: Run, motion: Motion, end: int) -> Row:
    """Return the measures of the first ``end`` ticks, and the worst jumps of all."""
    part = motion.part(0, end)
    relieved = [i for i, (a, b) in enumerate(pairwise(ticks.modes), 1) if a.automatic is not b.automatic]
    targets: list[Pose | None] = [None] * len(motion)
    for i in relieved:
        target = ticks[i].step.target
        if ticks.modes[i].automatic and target is not None:
            targets[i] = target.X_WG
    return {
        **motion_measures(part, setup.robot, nearest_distance(setup)),
        **interaction_measures(part, R_WS_DEFAULT),
        **stretch_smoothness(part, [i for i in relieved if i < end]),
        # Closing the jaws is a change of mode, too.
        **worst_jumps(motion, targets),
    }
