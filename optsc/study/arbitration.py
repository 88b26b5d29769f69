"""All arbitration policies on the same scenes and people: who gets there, how fast, with what effort, and how smoothly.

Other than in the comparison of grasp choices, the hand has a say all the way here, so every episode is a plain run of
its own, from the first sample to the object that is carried or the end of patience.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import nan
from typing import Any

import numpy as np

from optsc.control.arbitration import POLICIES, Arbitration, Trigger, make_policy
from optsc.control.modes import Mode
from optsc.followers import Follower
from optsc.metrics import Motion, summarise
from optsc.metrics.summary import worst_jumps
from optsc.operators import Operator
from optsc.operators.simulated import R_WS_DEFAULT
from optsc.records import Run, Tick
from optsc.session import run
from optsc.study.conditions import Person
from optsc.study.keys import key, plain
from optsc.study.lifting import is_lifted
from optsc.study.outcomes import Row, case_labels, nearest_to
from optsc.study.scenes import Scene
from optsc.study.staging import Settings, Stage, episode_key
from optsc.study.sweep.plan import Cases

VERSION = 2
"""Version of what a row means; part of every key."""
REPORTED = (
    *("grasp_s", "effort_m", "intervention", "agreement", "disagreement", "switches", "path_length_m"),
    *("rotation_rad", "ldlj_tool", "ldlj_joint", "sparc_tool", "clearance_m", "limit_margin_share"),
    *("jump_position_m", "jump_rotation_rad", "jump_velocity_m_s", "jump_angular_velocity_rad_s"),
    *("jump_acceleration_m_s2", "jump_jerk_m_s3", "jump_joint_rad", "jump_branch_flip"),
)
"""Numbers of a row, taken up to the moment at which the jaws begin to close for the last time."""


@dataclass(frozen=True)
class PolicyCondition:
    """A policy under test, by its name in tables."""

    name: str
    policy: Arbitration

    @cached_property
    def key(self) -> str:
        """Hash of the policy and its settings."""
        return key([VERSION, type(self.policy).__name__, plain(self.policy)])


@dataclass(frozen=True)
class PolicyJob:
    """All policies in one scene with one person."""

    scene: Scene
    person: Person
    settings: Settings
    conditions: tuple[PolicyCondition, ...]

    def keys(self) -> list[str]:
        """Return the key of each condition's row."""
        episode = episode_key(self.scene, self.person, self.settings)
        return [key([episode, condition.key]) for condition in self.conditions]

    def labels(self, condition: PolicyCondition) -> Row:
        """Return what a table says about a row besides its outcome."""
        return {**case_labels(self.scene, self.person, self.settings), "condition": condition.name}


def policy_conditions(names: Sequence[str] | None = None) -> tuple[PolicyCondition, ...]:
    """Return the built-in policies of these names, by default all; raise `UnknownName`."""
    return tuple(PolicyCondition(name, make_policy(name)) for name in names or sorted(POLICIES))


def policy_jobs(cases: Cases, conditions: Sequence[PolicyCondition]) -> list[PolicyJob]:
    """Return the jobs that try all policies on all cases."""
    return [PolicyJob(scene, person, cases.settings, tuple(conditions)) for scene, person in cases.pairs()]


def do_policies(job: PolicyJob) -> list[Row]:
    """Return one row for each policy of ``job``."""
    stage = Stage(job.scene, job.settings)
    rows = []
    for condition, row_key in zip(job.conditions, job.keys(), strict=True):
        rows.append({"key": row_key, **outcome(stage, simulated(stage, job.person, condition.policy))})
    return rows


def simulated(stage: Stage, person: Person, policy: Arbitration) -> Run:
    """Return the run of one episode of a simulated person under ``policy``; who has to grasp by hand does."""
    by_hand = policy.trigger is Trigger.GRASPS
    operator = person.operator(stage.scene.goal, stage.scene.objects, by_hand=by_hand)
    with stage.follower() as follower:
        return play(stage, policy, operator, follower, duration=stage.settings.longest)


def play(
    stage: Stage,
    policy: Arbitration,
    operator: Operator,
    follower: Follower,
    *,
    duration: float,
    about: Mapping[str, Any] | None = None,
    on_tick: Callable[[Tick], None] | None = None,
) -> Run:
    """Return the run of one episode under ``policy``, the grasp chosen as the paper does; see `optsc.session.run`."""
    return run(
        stage.controller(stage.paper, arbitration=policy),
        operator=operator,
        follower=follower,
        candidates=stage.candidates,
        clear=stage.clear,
        rate=stage.settings.rate,
        duration=duration,
        about={"policy": policy.name, "goal": stage.scene.goal, **(about or {})},
        on_tick=on_tick,
    )


def outcome(stage: Stage, ticks: Run) -> Row:
    """Return what became of an episode: numbers of `REPORTED`, and whether the wanted object was grasped.

    With an ideal follower, success means that the jaws closed at a grasp of the wanted object and the arm went on to
    carry it; in a simulated world, that the object was really lifted.
    """
    motion = Motion.of_run(ticks, stage.robot)
    closings = [i for i in ticks.switches() if ticks.modes[i] is Mode.CLOSE]
    end = closings[-1] if closings else len(motion)
    part = motion.part(0, end)
    measured = summarise(part, stage.robot, R_WS=R_WS_DEFAULT, nearest=nearest_to(stage))
    target = ticks[end].step.target if closings else None
    carried = ticks.modes[-1] is Mode.CARRY
    success = carried and target is not None and target.object_name == stage.scene.goal
    if stage.settings.follower == "pybullet":
        heights = np.array([tick.objects[stage.scene.goal].translation[2] for tick in ticks])
        success = is_lifted(heights, ticks.rate)
    # Closing the jaws is a change of mode, too.
    measured.update(worst_jumps(motion))
    row: dict[str, Any] = {name: measured.get(name, nan) for name in REPORTED if name != "grasp_s"}
    return {
        "success": bool(success),
        "ended": ticks.modes[-1].value,
        "object": "" if target is None else target.object_name,
        "whole_s": len(motion) / motion.rate,
        "grasp_s": end / motion.rate if success else nan,
        "manual_s": measured.get("time_manual_s", 0.0),
        **row,
    }
