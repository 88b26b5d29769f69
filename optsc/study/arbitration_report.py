"""Report of the arbitration study: means, differences from the paper's policy, jumps, and one case in detail."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from optsc.control.modes import Mode
from optsc.metrics import Motion
from optsc.records import Run
from optsc.study.arbitration import TIMES, PolicyCondition, simulated
from optsc.study.cases import Job
from optsc.study.episode_setup import EpisodeSetup
from optsc.study.outcomes import Row, scene_means
from optsc.study.report_parts import bounds, estimate, path_picture, tool_path
from optsc.study.statistics import (
    Interval,
    PairedDifference,
    averages,
    bootstrap,
    mean_of,
    paired_difference,
    share_interval,
)
from optsc.viewers.report import Picture, Report, Table
from optsc.viewers.report_motion import ToolPath, timelines
from optsc.viewers.report_statistics import Estimate, bars

if TYPE_CHECKING:
    from pandas import DataFrame, Series

PATHS_DRAWN = 4
"""Tool paths in one figure."""
REFERENCE = "alternating"
"""The paper's policy, which the others are compared with."""
_HOW_SMOOTH = (
    "Of the stretches in which something moves, those of the hand and of the robot apart, weighted by their durations: "
    "a rest makes nobody less smooth. A motion "
    "in many pieces is judged by its pieces, so their number and time stand beside it. At constant speed LDLJ grows "
    "with the duration; it is never to be read alone."
)
_HOW_JUMPS = (
    "The worst of each part in an episode, over all its changes of mode, closing the jaws included. d_l and d_a are "
    "from the tool to what it heads for where the hand gives the motion away, to the robot or to the jaws."
)
MEASURE_TITLES = {
    "grasp_s": "time to the grasp [s]",
    "effort_m": "path of the hand [m]",
    "intervention": "share of time the hand moves",
    "agreement": "agreement (cosine)",
    "path_length_m": "path of the tool [m]",
    "ldlj_tool": "LDLJ of the tool, by stretch",
    "ldlj_joint": "LDLJ of the joints, by stretch",
    "clearance_m": "least clearance [m]",
}
SMOOTHNESS_TITLES = {
    "ldlj_tool": "LDLJ, tool",
    "ldlj_turn": "LDLJ, turning",
    "ldlj_joint": "LDLJ, joints",
    "sparc_tool": "SPARC, tool",
    "sparc_turn": "SPARC, turning",
    "sparc_joint": "SPARC, joints",
    "stretches": "stretches",
    "moving_s": "time in them [s]",
}
MODE_TITLES = {name: f"{mode.value} [s]" for name, mode in zip(TIMES, Mode, strict=True)}
JUMP_TITLES = {
    "jump_position_m": "position step [m]",
    "jump_rotation_rad": "rotation step [rad]",
    "jump_velocity_m_s": "velocity step [m/s]",
    "jump_angular_velocity_rad_s": "angular velocity step [rad/s]",
    "jump_acceleration_m_s2": "peak acceleration [m/s²]",
    "jump_jerk_m_s3": "peak jerk [m/s³]",
    "jump_target_distance_m": "d_l at a hand-over [m]",
    "jump_target_chord": "d_a at a hand-over",
    "jump_joint_rad": "joint step [rad]",
    "jump_branch_flip": "branch flips",
}
ALL_TITLES = MEASURE_TITLES | SMOOTHNESS_TITLES | MODE_TITLES | JUMP_TITLES


def summary_of(rows: Sequence[Row], seed: int = 0) -> dict[str, Any]:
    """Return the results for machines: for each arm shares, means, and paired differences from the paper's policy.

    They are under ``robots``; those of a study with one arm are under ``policies`` besides.
    """
    found = {robot: _summary_of_arm(arm, seed) for robot, arm in _arms(rows).items()}
    only = {"policies": next(iter(found.values()))} if len(found) == 1 else {}
    return {"robots": {robot: {"policies": policies} for robot, policies in found.items()}, **only}


def _summary_of_arm(arm: DataFrame, seed: int) -> dict[str, Any]:
    return {
        name: {
            "cases": len(rows),
            "scenes": rows["scene"].nunique(),
            "success": _success(rows, seed),
            **{
                column: _mean(rows, column, seed)
                for column in (MEASURE_TITLES | SMOOTHNESS_TITLES | MODE_TITLES | JUMP_TITLES)
            },
            "minus_alternating": {
                column: difference._asdict() for column, difference in _against(arm, name, seed).items()
            },
        }
        for name, rows in _policies(arm).items()
    }


def _arms(rows: Sequence[Row]) -> dict[str, DataFrame]:
    from pandas import DataFrame

    return dict(iter(DataFrame(rows).groupby("robot", sort=False)))


def _policies(arm: DataFrame) -> dict[str, DataFrame]:
    return dict(iter(arm.groupby("condition", sort=False)))


def _against(arm: DataFrame, name: str, seed: int) -> dict[str, PairedDifference]:
    """Return paired differences from the reference over the cases in which both succeed, a scene being the unit."""
    if name == REFERENCE or REFERENCE not in arm["condition"].unique():
        return {}
    succeeded = arm[arm["success"].astype(bool)]
    one, other = (succeeded[succeeded["condition"] == policy] for policy in (name, REFERENCE))
    pairs = one.merge(other, on=["scene", "person", "person_seed"], suffixes=("", "_reference"))
    found = {}
    for column in MEASURE_TITLES:
        a, b = averages(pairs["scene"].tolist(), pairs[column], pairs[f"{column}_reference"])
        found[column] = paired_difference(a, b, np.random.default_rng(seed))
    return found


def _of_scenes(rows: DataFrame, column: str) -> Series:
    """Return a mean for each scene that has one: people who share a scene are not independent of each other."""
    return scene_means(rows, [column])[column].dropna()


def _mean(rows: DataFrame, column: str, seed: int) -> Interval:
    return bootstrap(_of_scenes(rows, column), np.random.default_rng(seed))


def _success(rows: DataFrame, seed: int) -> Interval:
    """Return the share of successes: Wilson's interval where every scene either has it or not, else of scene means."""
    shares = _of_scenes(rows, "success")
    if shares.isin((0.0, 1.0)).all():
        return share_interval(round(shares.sum()), len(shares))
    return bootstrap(shares, np.random.default_rng(seed))


def text_table(rows: Sequence[Row]) -> str:
    """Return success, time, effort and jump of each policy on each arm, for people; means over scenes."""
    lines = []
    for robot, arm in _arms(rows).items():
        lines.append(f"{robot:<22} success  time s  hand m  speed step m/s  peak m/s²")
        for name, of_policy in _policies(arm).items():
            columns = ("success", "grasp_s", "effort_m", "jump_velocity_m_s", "jump_acceleration_m_s2")
            success, time, effort, jump, peak = (mean_of(_of_scenes(of_policy, c)) for c in columns)
            lines.append(f"{name:<22} {100.0 * success:5.0f} %  {time:6.2f}  {effort:6.2f}  {jump:14.4f}  {peak:9.2f}")
    return "\n".join(lines)


def build(rows: Sequence[Row], command: str, seed: int = 0, jobs: Sequence[Job[PolicyCondition]] = ()) -> Report:
    """Return the report on all policies in ``rows``, arm by arm; one of the ``jobs`` is run again to be drawn."""
    report = Report(
        "Arbitration policies on the same scenes and people",
        "Every policy meets the same scenes and the same people with the same random numbers. Success is a grasp of "
        "the object that was wanted; times and paths count up to the moment at which the jaws begin to close. Means "
        "and intervals are over scenes: people who share a scene count as one.",
    )
    report.add("How it was made", f"Command: {command}")
    arms = _arms(rows)
    for robot, arm in arms.items():
        where, suffix = (f", {robot}", f"_{robot}") if len(arms) > 1 else ("", "")
        policies = _policies(arm)
        used = {name: title for name, title in MODE_TITLES.items() if arm[name].any()}
        picture = _picture(policies, seed, f"policies{suffix}")
        report.add(f"Success, time, effort{where}", picture, _table(policies, MEASURE_TITLES, seed, success=True))
        report.add(f"Against the paper's policy{where}", *_differences(arm, seed))
        report.add(f"Smoothness{where}", _HOW_SMOOTH, _table(policies, SMOOTHNESS_TITLES, seed))
        report.add(f"Time in each mode{where}", _table(policies, used, seed))
        report.add(f"Jumps at changes of mode{where}", _HOW_JUMPS, _table(policies, JUMP_TITLES, seed, worst=True))
    report.add("One case in detail", *_motions(rows, jobs))
    return report


def _motions(rows: Sequence[Row], jobs: Sequence[Job[PolicyCondition]]) -> list[Picture | str]:
    """Return modes over time and the tool's paths in the first case in which every policy succeeds."""
    good = {row["key"] for row in rows if row["success"]}
    job = next((job for job in jobs if good.issuperset(job.keys())), None)
    if job is None:
        return ["There is no case in which every policy succeeds."]
    setup = EpisodeSetup(job.scene, job.settings)
    paths = [path_of(setup, simulated(setup, job.person, c.policy), c.name) for c in job.conditions]
    title = f"{job.scene.robot}, scene {job.scene.seed}, {job.scene.goal}, {job.person.kind}"
    words = f"{title}: control modes over time, from the first sample to the object that is carried."
    parts = [paths[first : first + PATHS_DRAWN] for first in range(0, len(paths), PATHS_DRAWN)]
    drawn = [
        path_picture(f"ways_{k}", job.scene, part, title, ". The tool's path by mode; a fork is the grasp.")
        for k, part in enumerate(parts, 1)
    ]
    return [Picture("timelines", timelines(paths), words), *drawn]


def path_of(setup: EpisodeSetup, ticks: Run, label: str) -> ToolPath:
    """Return the tool's path in a run, and the grasp that was the target last."""
    targets = [tick.step.target for tick in ticks if tick.step.target is not None]
    return tool_path(label, Motion.of_run(ticks, setup.robot), targets[-1].X_WG if targets else None)


def _picture(policies: dict[str, DataFrame], seed: int, name: str) -> Picture:
    titles = {"success": "success", **{c: MEASURE_TITLES[c] for c in ("grasp_s", "effort_m")}}
    groups = {
        column: {
            policy: Estimate(*(_success(rows, seed) if column == "success" else _mean(rows, column, seed)))
            for policy, rows in policies.items()
        }
        for column in titles
    }
    caption = "Means with 95 % intervals; times are of the episodes that succeeded, effort is of all."
    return Picture(name, bars(groups, titles), caption)


def _table(
    policies: dict[str, DataFrame],
    columns: dict[str, str],
    seed: int,
    *,
    success: bool = False,
    worst: bool = False,
) -> Table:
    head = ["policy", "cases", *(["success"] if success else []), *columns.values()]
    lines = []
    for name, rows in policies.items():
        share = [f"{100 * _success(rows, seed).value:.0f} %"] if success else []
        if worst:
            means = {column: mean_of(_of_scenes(rows, column)) for column in columns}
            texts = [
                f"{mean:.3g}, at most {rows[column].max():.3g}" if np.isfinite(mean) else None
                for column, mean in means.items()
            ]
        else:
            texts = [estimate(_mean(rows, column, seed)) for column in columns]
        lines.append([name, len(rows), *share, *texts])
    words = "Means, and the worst of all cases" if worst else "Means with 95 % bootstrap intervals"
    return Table(head, lines, words)


def _differences(arm: DataFrame, seed: int) -> list[Table | str]:
    lines: list[list[Any]] = []
    for name in arm["condition"].unique():
        for column, d in _against(arm, name, seed).items():
            clear = d.mean.low * d.mean.high > 0.0
            lines.append([name, MEASURE_TITLES[column], d.pairs, d.mean.value, bounds(d.mean), d.d_z, clear])
    if not lines:
        return ["The paper's policy was not among those tried."]
    head = ["policy", "measure", "scenes", "minus alternating", "95 %", "d_z", "clear of zero"]
    return [Table(head, lines, "Paired differences over the cases in which both succeed")]
