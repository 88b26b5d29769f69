"""The report on arbitration policies: who wins where, also where the paper's way does not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from optsc.metrics import Motion
from optsc.records import Run
from optsc.study.arbitration import PolicyJob, simulated
from optsc.study.outcomes import Row
from optsc.study.staging import Stage
from optsc.study.statistics import bootstrap, mean_of, paired_difference, share_interval
from optsc.viewers.report import Picture, Report, Table
from optsc.viewers.report_motion import Path, timelines, trajectories
from optsc.viewers.report_statistics import Estimate, bars

IN_A_ROW = 4
"""Ways of the tool in one figure."""
REFERENCE = "alternating"
"""The paper's policy, which the others are compared with."""
COLUMNS = {
    "grasp_s": "time to the grasp [s]",
    "effort_m": "way of the hand [m]",
    "intervention": "share of time the hand moves",
    "agreement": "agreement (cosine)",
    "path_length_m": "way of the tool [m]",
    "ldlj_tool": "LDLJ of the tool",
    "ldlj_joint": "LDLJ of the joints",
    "clearance_m": "least clearance [m]",
}
JUMPS = {
    "jump_position_m": "position step [m]",
    "jump_rotation_rad": "rotation step [rad]",
    "jump_velocity_m_s": "velocity step [m/s]",
    "jump_angular_velocity_rad_s": "angular velocity step [rad/s]",
    "jump_acceleration_m_s2": "peak acceleration [m/s²]",
    "jump_jerk_m_s3": "peak jerk [m/s³]",
    "jump_joint_rad": "joint step [rad]",
    "jump_branch_flip": "branch flips",
}


def summary_of(rows: Sequence[Row], seed: int = 0) -> dict[str, Any]:
    """Return the results for machines: shares, means, and paired differences from the paper's policy."""
    result = {}
    for name, of_policy in _by_policy(rows).items():
        wins = sum(bool(row["success"]) for row in of_policy)
        entry: dict[str, Any] = {"cases": len(of_policy), "success": share_interval(wins, len(of_policy))}
        for column in (*COLUMNS, *JUMPS):
            entry[column] = bootstrap(_finite(of_policy, column), np.random.default_rng(seed))
        entry["minus_alternating"] = _against(rows, name, seed)
        result[name] = entry
    return {"policies": result}


def _against(rows: Sequence[Row], name: str, seed: int) -> dict[str, Any]:
    """Return paired differences from the reference over the cases in which both succeed."""
    policies = _by_policy(rows)
    if name == REFERENCE or REFERENCE not in policies:
        return {}
    reference = {_case(row): row for row in policies[REFERENCE]}
    both = [
        (row, reference[_case(row)])
        for row in policies[name]
        if _case(row) in reference and row["success"] and reference[_case(row)]["success"]
    ]
    return {
        column: paired_difference(
            [a[column] for a, _ in both], [b[column] for _, b in both], np.random.default_rng(seed)
        )._asdict()
        for column in COLUMNS
    }


def _by_policy(rows: Sequence[Row]) -> dict[str, list[Row]]:
    return {
        name: [row for row in rows if row["condition"] == name]
        for name in dict.fromkeys(row["condition"] for row in rows)
    }


def _case(row: Row) -> tuple[Any, ...]:
    return row["scene"], row["person"], row["person_seed"]


def _finite(rows: Sequence[Row], column: str) -> list[float]:
    return [row[column] for row in rows if row[column] is not None and np.isfinite(row[column])]


def text_table(rows: Sequence[Row]) -> str:
    """Return success, time, effort and jump of each policy, for people."""
    lines = [f"{'policy':<22} success  time s  hand m  speed step m/s  peak m/s²"]
    for name, of_policy in _by_policy(rows).items():
        success = 100.0 * mean_of([float(row["success"]) for row in of_policy])
        time, effort, jump, peak = (
            mean_of(_finite(of_policy, column))
            for column in ("grasp_s", "effort_m", "jump_velocity_m_s", "jump_acceleration_m_s2")
        )
        lines.append(f"{name:<22} {success:5.0f} %  {time:6.2f}  {effort:6.2f}  {jump:14.4f}  {peak:9.2f}")
    return "\n".join(lines)


def build(rows: Sequence[Row], command: str, seed: int = 0, jobs: Sequence[PolicyJob] = ()) -> Report:
    """Return the report on all policies in ``rows``; of one of the ``jobs`` it shows every motion, made again."""
    report = Report(
        "Arbitration policies on the same scenes and people",
        "Every policy meets the same scenes and the same people with the same random numbers. Success is a grasp of "
        "the object that was wanted; times and ways count up to the moment at which the jaws begin to close.",
    )
    policies = _by_policy(rows)
    report.add("How it was made", f"Command: {command}")
    report.add(
        "Success, time, effort", _picture(policies, seed), _table(policies, COLUMNS, seed, success=True)
    )
    report.add("Against the paper's policy", *_differences(rows, seed))
    report.add("Jumps at changes of mode", _table(policies, JUMPS, seed, worst=True))
    report.add("One case, looked at", *_motions(rows, jobs))
    return report


def _motions(rows: Sequence[Row], jobs: Sequence[PolicyJob]) -> list[Picture | str]:
    """Return who led when, and which way the tool went, in the first case in which every policy succeeds."""
    good = {row["key"] for row in rows if row["success"]}
    job = next((job for job in jobs if good.issuperset(job.keys())), None)
    if job is None:
        return ["There is no case in which every policy succeeds."]
    stage = Stage(job.scene, job.settings)
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


def path_of(stage: Stage, ticks: Run, label: str) -> Path:
    """Return the way of the tool in a run, and the grasp that it was led to last."""
    motion = Motion.of_run(ticks, stage.robot)
    targets = [tick.step.target for tick in ticks if tick.step.target is not None]
    X_WG = targets[-1].X_WG if targets else None
    return Path(label, motion.X_WT.translation, motion.modes, motion.rate, X_WG)


def _picture(policies: dict[str, list[Row]], seed: int) -> Picture:
    titles = {"success": "success", "grasp_s": "time to the grasp [s]", "effort_m": "way of the hand [m]"}
    groups: dict[str, dict[str, Estimate]] = {title: {} for title in titles}
    for name, rows in policies.items():
        wins = sum(bool(row["success"]) for row in rows)
        groups["success"][name] = Estimate(*share_interval(wins, len(rows)))
        for column in ("grasp_s", "effort_m"):
            groups[column][name] = Estimate(*bootstrap(_finite(rows, column), np.random.default_rng(seed)))
    caption = "Means with 95 % intervals; times are of the episodes that succeeded, effort is of all."
    return Picture("policies", bars(groups, titles), caption)


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
            line.append(f"{100 * np.mean([bool(row['success']) for row in rows]):.0f} %")
        for column in columns:
            values = _finite(rows, column)
            if worst:
                line.append(f"{mean_of(values):.3g}, at most {max(values):.3g}" if values else None)
            else:
                mean = bootstrap(values, np.random.default_rng(seed))
                line.append(f"{mean.value:.3g} ({mean.low:.3g} to {mean.high:.3g})" if values else None)
        lines.append(line)
    words = "Means, and the worst of all cases" if worst else "Means with 95 % bootstrap intervals"
    return Table(head, lines, words)


def _differences(rows: Sequence[Row], seed: int) -> list[Table | str]:
    lines = []
    for name in _by_policy(rows):
        for column, difference in _against(rows, name, seed).items():
            mean = difference["mean"]
            clear = mean.low * mean.high > 0.0
            interval = f"{mean.low:.3g} to {mean.high:.3g}"
            numbers = [difference["pairs"], mean.value, interval, difference["d_z"]]
            lines.append([name, COLUMNS[column], *numbers, clear])
    if not lines:
        return ["The paper's policy was not among those tried."]
    head = ["policy", "measure", "pairs", "minus alternating", "95 %", "d_z", "clear of zero"]
    return [Table(head, lines, "Paired differences over the cases in which both succeed")]
