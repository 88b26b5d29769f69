"""The report on arbitration policies: who wins where, also where the paper's way does not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from optsc.control.modes import Mode
from optsc.metrics import Motion
from optsc.records import Run
from optsc.study.arbitration import TIMES, PolicyJob, simulated
from optsc.study.episode_setup import EpisodeSetup
from optsc.study.outcomes import Row, scene_means
from optsc.study.statistics import Interval, bootstrap, mean_of, paired_difference, share_interval
from optsc.viewers.report import Picture, Report, Table
from optsc.viewers.report_motion import Path, timelines, trajectories
from optsc.viewers.report_statistics import Estimate, bars

IN_A_ROW = 4
"""Ways of the tool in one figure."""
REFERENCE = "alternating"
"""The paper's policy, which the others are compared with."""
_TOLD = ("jump_velocity_m_s", "jump_acceleration_m_s2")
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
COLUMNS = {
    "grasp_s": "time to the grasp [s]",
    "effort_m": "way of the hand [m]",
    "intervention": "share of time the hand moves",
    "agreement": "agreement (cosine)",
    "path_length_m": "way of the tool [m]",
    "ldlj_tool": "LDLJ of the tool, by stretch",
    "ldlj_joint": "LDLJ of the joints, by stretch",
    "clearance_m": "least clearance [m]",
}
SMOOTHNESS = {
    "ldlj_tool": "LDLJ, tool",
    "ldlj_turn": "LDLJ, turning",
    "ldlj_joint": "LDLJ, joints",
    "sparc_tool": "SPARC, tool",
    "sparc_turn": "SPARC, turning",
    "sparc_joint": "SPARC, joints",
    "stretches": "stretches",
    "moving_s": "time in them [s]",
}
MODES = {name: f"{mode.value} [s]" for name, mode in zip(TIMES, Mode, strict=True)}
JUMPS = {
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


def summary_of(rows: Sequence[Row], seed: int = 0) -> dict[str, Any]:
    """Return the results for machines: for each arm shares, means, and paired differences from the paper's policy.

    They are under ``robots``; those of a study with one arm are under ``policies`` besides.
    """
    found = {robot: _summary_of_arm(mine, seed) for robot, mine in _by(rows, "robot").items()}
    only = {"policies": next(iter(found.values()))} if len(found) == 1 else {}
    return {"robots": {robot: {"policies": policies} for robot, policies in found.items()}, **only}


def _summary_of_arm(rows: Sequence[Row], seed: int) -> dict[str, Any]:
    result = {}
    for name, of_policy in _by(rows, "condition").items():
        scenes = len({row["scene"] for row in of_policy})
        entry: dict[str, Any] = {
            "cases": len(of_policy),
            "scenes": scenes,
            "success": _success(of_policy, seed),
        }
        for column in dict.fromkeys((*COLUMNS, *SMOOTHNESS, *MODES, *JUMPS)):
            entry[column] = _mean(of_policy, column, seed)
        entry["minus_alternating"] = _against(rows, name, seed)
        result[name] = entry
    return result


def _against(rows: Sequence[Row], name: str, seed: int) -> dict[str, Any]:
    """Return paired differences from the reference over the cases in which both succeed, a scene being the unit."""
    policies = _by(rows, "condition")
    if name == REFERENCE or REFERENCE not in policies:
        return {}
    reference = {_case(row): row for row in policies[REFERENCE]}
    both = [
        (row, reference[_case(row)])
        for row in policies[name]
        if _case(row) in reference and row["success"] and reference[_case(row)]["success"]
    ]
    found = {}
    for column in COLUMNS:
        complete = [pair for pair in both if _finite(pair, [column])]
        a, b = (
            [mean[column] for mean in scene_means([pair[side] for pair in complete], [column])]
            for side in (0, 1)
        )
        found[column] = paired_difference(a, b, np.random.default_rng(seed))._asdict()
    return found


def _by(rows: Sequence[Row], label: str) -> dict[str, list[Row]]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row[label], []).append(row)
    return groups


def _case(row: Row) -> tuple[Any, ...]:
    return row["scene"], row["person"], row["person_seed"]


def _finite(rows: Sequence[Row], columns: Sequence[str]) -> bool:
    return all(row[column] is not None and np.isfinite(row[column]) for row in rows for column in columns)


def _of_scenes(rows: Sequence[Row], column: str) -> list[float]:
    """Return a mean for each scene that has one: people who share a scene are not independent of each other."""
    return [mean[column] for mean in scene_means(rows, [column]) if np.isfinite(mean[column])]


def _mean(rows: Sequence[Row], column: str, seed: int) -> Interval:
    return bootstrap(_of_scenes(rows, column), np.random.default_rng(seed))


def _success(rows: Sequence[Row], seed: int) -> Interval:
    """Return the share of successes: Wilson's interval where every scene either has it or not, else of scene means."""
    shares = _of_scenes(rows, "success")
    if all(share in (0.0, 1.0) for share in shares):
        return share_interval(round(sum(shares)), len(shares))
    return bootstrap(shares, np.random.default_rng(seed))


def text_table(rows: Sequence[Row]) -> str:
    """Return success, time, effort and jump of each policy on each arm, for people; means over scenes."""
    lines = []
    for robot, of_arm in _by(rows, "robot").items():
        lines.append(f"{robot:<22} success  time s  hand m  speed step m/s  peak m/s²")
        for name, of_policy in _by(of_arm, "condition").items():
            success, time, effort, jump, peak = (
                mean_of(_of_scenes(of_policy, column))
                for column in ("success", "grasp_s", "effort_m", *_TOLD)
            )
            lines.append(
                f"{name:<22} {100.0 * success:5.0f} %  {time:6.2f}  {effort:6.2f}  {jump:14.4f}  {peak:9.2f}"
            )
    return "\n".join(lines)


def build(rows: Sequence[Row], command: str, seed: int = 0, jobs: Sequence[PolicyJob] = ()) -> Report:
    """Return the report on all policies in ``rows``, arm by arm; of one of the ``jobs`` it shows every motion anew."""
    report = Report(
        "Arbitration policies on the same scenes and people",
        "Every policy meets the same scenes and the same people with the same random numbers. Success is a grasp of "
        "the object that was wanted; times and ways count up to the moment at which the jaws begin to close. Means "
        "and intervals are over scenes: people who share a scene count as one.",
    )
    report.add("How it was made", f"Command: {command}")
    arms = _by(rows, "robot")
    for robot, mine in arms.items():
        where = f", {robot}" if len(arms) > 1 else ""
        policies = _by(mine, "condition")
        picture = _picture(policies, seed, f"policies_{robot}" if len(arms) > 1 else "policies")
        report.add(f"Success, time, effort{where}", picture, _table(policies, COLUMNS, seed, success=True))
        report.add(f"Against the paper's policy{where}", *_differences(mine, seed))
        report.add(f"Smoothness{where}", _HOW_SMOOTH, _table(policies, SMOOTHNESS, seed))
        report.add(f"Time in each mode{where}", _table(policies, _used(mine), seed))
        report.add(f"Jumps at changes of mode{where}", _HOW_JUMPS, _table(policies, JUMPS, seed, worst=True))
    report.add("One case, looked at", *_motions(rows, jobs))
    return report


def _used(rows: Sequence[Row]) -> dict[str, str]:
    return {name: title for name, title in MODES.items() if any(row[name] for row in rows)}


def _motions(rows: Sequence[Row], jobs: Sequence[PolicyJob]) -> list[Picture | str]:
    """Return who led when, and which way the tool went, in the first case in which every policy succeeds."""
    good = {row["key"] for row in rows if row["success"]}
    job = next((job for job in jobs if good.issuperset(job.keys())), None)
    if job is None:
        return ["There is no case in which every policy succeeds."]
    stage = EpisodeSetup(job.scene, job.settings)
    objects = {name: (model.parts, stage.world.X_WO[name]) for name, model in stage.world.objects.items()}
    paths = [path_of(stage, simulated(stage, job.person, c.policy), c.name) for c in job.conditions]
    title = f"{job.scene.robot}, scene {job.scene.seed}, {job.scene.goal}, {job.person.kind}"
    words = f"{title}: who led when, from the first sample to the object that is carried."
    pictures: list[Picture | str] = [Picture("timelines", timelines(paths), words)]
    for number, first in enumerate(range(0, len(paths), IN_A_ROW), 1):
        words = "The way of the tool, coloured by mode; a fork is the grasp."
        figure = trajectories(objects, paths[first : first + IN_A_ROW], title, job.scene.goal)
        pictures.append(Picture(f"ways_{number}", figure, f"{title}. {words}"))
    return pictures


def path_of(stage: EpisodeSetup, ticks: Run, label: str) -> Path:
    """Return the way of the tool in a run, and the grasp that it was led to last."""
    motion = Motion.of_run(ticks, stage.robot)
    targets = [tick.step.target for tick in ticks if tick.step.target is not None]
    X_WG = targets[-1].X_WG if targets else None
    return Path(label, motion.X_WT.translation, motion.modes, motion.rate, X_WG)


def _picture(policies: dict[str, list[Row]], seed: int, name: str) -> Picture:
    titles = {"success": "success", "grasp_s": "time to the grasp [s]", "effort_m": "way of the hand [m]"}
    groups: dict[str, dict[str, Estimate]] = {title: {} for title in titles}
    for policy, rows in policies.items():
        groups["success"][policy] = Estimate(*_success(rows, seed))
        for column in ("grasp_s", "effort_m"):
            groups[column][policy] = Estimate(*_mean(rows, column, seed))
    caption = "Means with 95 % intervals; times are of the episodes that succeeded, effort is of all."
    return Picture(name, bars(groups, titles), caption)


def _table(
    policies: dict[str, list[Row]],
    columns: dict[str, str],
    seed: int,
    *,
    success: bool = False,
    worst: bool = False,
) -> Table:
    head = ["policy", "cases", *(["success"] if success else []), *columns.values()]
    lines = []
    for name, rows in policies.items():
        line: list[Any] = [name, len(rows)]
        if success:
            line.append(f"{100 * _success(rows, seed).value:.0f} %")
        for column in columns:
            mean = _mean(rows, column, seed)
            if not np.isfinite(mean.value):
                line.append(None)
            elif worst:
                most = max(row[column] for row in rows if _finite([row], [column]))
                line.append(f"{mean.value:.3g}, at most {most:.3g}")
            else:
                line.append(f"{mean.value:.3g} ({mean.low:.3g} to {mean.high:.3g})")
        lines.append(line)
    words = "Means, and the worst of all cases" if worst else "Means with 95 % bootstrap intervals"
    return Table(head, lines, words)


def _differences(rows: Sequence[Row], seed: int) -> list[Table | str]:
    lines = []
    for name in _by(rows, "condition"):
        for column, difference in _against(rows, name, seed).items():
            mean = difference["mean"]
            clear = mean.low * mean.high > 0.0
            interval = f"{mean.low:.3g} to {mean.high:.3g}"
            numbers = [difference["pairs"], mean.value, interval, difference["d_z"]]
            lines.append([name, COLUMNS[column], *numbers, clear])
    if not lines:
        return ["The paper's policy was not among those tried."]
    head = ["policy", "measure", "scenes", "minus alternating", "95 %", "d_z", "clear of zero"]
    return [Table(head, lines, "Paired differences over the cases in which both succeed")]
