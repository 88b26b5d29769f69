"""Outcomes of grasp choices: a row of measures for each condition in each case."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from optsc.control.modes import Mode
from optsc.geometry import rotation
from optsc.metrics import NearestDistance, interaction_measures, jump_measures, motion_measures
from optsc.people.simulated import R_WS_DEFAULT
from optsc.study.cases import Job
from optsc.study.conditions import DEFAULT_MEASURE, Condition, measure
from optsc.study.engine import Choice, Engine
from optsc.study.episode_setup import nearest_distance
from optsc.study.fingerprint import fingerprint
from optsc.study.manual_phase import ARRIVED
from optsc.study.motion_recorder import MotionRecorder

if TYPE_CHECKING:
    from pandas import DataFrame

Row: TypeAlias = dict[str, Any]

MEASURED = (
    *("duration_s", "path_length_m", "rotation_rad", "joint_path_rad", "straightness"),
    *("ldlj_tool", "ldlj_turn", "ldlj_joint", "sparc_tool", "sparc_turn", "sparc_joint"),
    *("limit_margin_rad", "limit_margin_share", "velocity_share", "clearance_m", "mean_clearance_m"),
)
"""Measures of the automatic motion from the hand-over to the grasp, see `optsc.metrics.motion_measures`."""
JUMPS = (
    *("jump_position_m", "jump_rotation_rad", "jump_velocity_m_s", "jump_angular_velocity_rad_s"),
    *("jump_acceleration_m_s2", "jump_jerk_m_s3", "jump_target_distance_m", "jump_target_chord"),
    *("jump_joint_rad", "jump_branch_flip"),
)
"""Parts of the jump at the hand-over, see `optsc.metrics.SwitchJump`."""
MANUAL = ("effort_m", "intervention", "manual_s")
"""What the operator did up to the hand-over, and for how long."""
CHOSEN = ("target_manipulability", "target_yoshikawa", "target_travel_rad")
"""The chosen grasp: M as the condition defines it, M by default, largest joint motion to it."""


def scene_means(
    rows: Sequence[Row] | DataFrame,
    columns: Sequence[str],
    by: Sequence[str] = ("robot", "measure", "condition"),
) -> DataFrame:
    """Return a line for each scene under each condition: means of ``columns`` over its people and repetitions.

    A scene is the unit of a study: however many people try it, it counts once in an interval. Rows belong together
    that have the same ``scene`` and the same in all of ``by`` that they have. Each mean is over what is finite, NaN
    where nothing is, and ``rows`` is how many there are; the order is that of the first of each.
    """
    from pandas import DataFrame

    table = DataFrame(rows)
    numbers = table[list(columns)].astype(float)
    table[list(columns)] = numbers.where(np.isfinite(numbers))
    groups = table.groupby([name for name in ("scene", *by) if name in table], sort=False, dropna=False)
    return groups[list(columns)].mean().assign(rows=groups.size()).reset_index()


def do(job: Job[Condition]) -> list[Row]:
    """Return one row for each condition of ``job``, in its order."""
    return rows(Engine(job.scene, job.person, job.settings), job.conditions)


def rows(engine: Engine, conditions: Sequence[Condition]) -> list[Row]:
    """Return one row for each condition."""
    measured: dict[tuple[int, int, bool], Row] = {}
    nearest = nearest_distance(engine.setup)
    result = []
    for condition, choice in zip(conditions, engine.choices(conditions), strict=True):
        row: Row = {"key": fingerprint([engine.key, condition.key])}
        if choice is None:
            row.update(_nothing("refused or never handed over"))
        else:
            target = choice.target
            place = (choice.hand_over, target.candidate, target.half_turn)
            if place not in measured:
                recorder, ended, lifted = engine.motion(condition, choice)
                measured[place] = _measured(engine, choice, recorder, ended, lifted, nearest)
            row.update(measured[place])
            row["target_manipulability"] = target.manipulability
            row["target_place"] = choice.place
        result.append(row)
    return result


def _nothing(why: str) -> Row:
    names = (*MEASURED, *JUMPS, *MANUAL, *CHOSEN)
    words = {"ended": why, "reason": "", "object": "", "half_turn": False, "arrived": False, "success": False}
    return {
        **words,
        "hand_over": -1,
        "grasp": -1,
        "candidate": -1,
        "target_place": -1,
        **dict.fromkeys(names, nan),
    }


def _measured(
    engine: Engine,
    choice: Choice,
    recorder: MotionRecorder,
    ended: str,
    lifted: bool | None,
    nearest: NearestDistance,
) -> Row:
    """Return what is the same for every condition that chose the same target."""
    target, robot, motion = choice.target, engine.setup.robot, recorder.motion()
    hand_over = engine.hand_over(choice.hand_over)
    begin = motion.modes.index(Mode.APPROACH.value) if Mode.APPROACH.value in motion.modes else len(motion)
    end = len(motion) - 1 if ended == ARRIVED else len(motion)
    row = _nothing(ended)
    row.update(
        reason=recorder.reason,
        object=target.object_name,
        half_turn=target.half_turn,
        arrived=ended == ARRIVED,
        success=ended == ARRIVED and target.object_name == engine.setup.scene.goal and lifted is not False,
        hand_over=choice.hand_over,
        grasp=target.grasp_index,
        candidate=target.candidate,
        target_yoshikawa=_yoshikawa(engine, choice),
    )
    manual = interaction_measures(motion.part(0, begin), R_WS_DEFAULT)
    row.update(effort_m=manual["effort_m"], intervention=manual["intervention"], manual_s=begin / motion.rate)
    row.update(jump_measures(motion, begin, target.X_WG))
    if hand_over is not None:
        row["target_travel_rad"] = float(np.abs(robot.difference(target.q, hand_over.q)).max())
        row["jump_target_distance_m"] = float(np.linalg.norm(target.X_WG.translation - hand_over.X_WT.translation))
        row["jump_target_chord"] = float(rotation.chord(target.X_WG.quaternion, hand_over.X_WT.quaternion))
    if ended == ARRIVED:
        row.update(motion_measures(motion.part(begin, end), robot, nearest))
    return row


def _yoshikawa(engine: Engine, choice: Choice) -> float:
    value = measure(DEFAULT_MEASURE).evaluate(engine.setup.robot, choice.target.q)
    return float(value)
