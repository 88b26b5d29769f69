"""The report of a sweep: the trade-off, what each number does, how firmly rankings stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from optsc.study.approach_report import ways
from optsc.study.conditions import PAPER, Condition
from optsc.study.outcomes import Job, Row
from optsc.study.stability import Stability
from optsc.study.sweep.results import TRADE_OFF, SettingResult, difference_from, shown_settings
from optsc.viewers.report import Picture, Report, Table
from optsc.viewers.report_motion import timelines, trajectories
from optsc.viewers.report_statistics import Estimate, front, sensitivity, stability_lines

LABELS = {"path_length_m": "path of the tool [m]", "target_yoshikawa": "manipulability at the grasp"}
OUTCOMES = {"path_length_m": "path [m]", "duration_s": "time [s]", "target_yoshikawa": "manipulability"}
COLUMNS = (
    *("path_length_m", "duration_s", "rotation_rad", "ldlj_joint"),
    *("target_yoshikawa", "clearance_m"),
)
"""Means that are told of each setting on the front."""
MEASURES: Mapping[str, str] = {
    "path_length_m": "path [m]",
    "duration_s": "time [s]",
    "rotation_rad": "rotation [rad]",
    "target_yoshikawa": "manipulability",
}
"""What settings on the front are compared in."""
LISTED = 30
"""Settings on the front that are told."""


def build(
    settled: Sequence[SettingResult],
    references: Sequence[SettingResult],
    stabilities: Sequence[Stability],
    command: str,
    *,
    rows: Sequence[Row] = (),
    jobs: Sequence[Job] = (),
) -> Report:
    """Return the report.

    Args:
        settled: the settings of the sweep.
        references: settings to compare with, such as the paper's.
        stabilities: of rankings, if they were asked for.
        command: that made it.
        rows: of all settings and references in every case; with them the front is compared with the paper's cascade.
        jobs: that the rows are of; with them the ends of the front and its knee are shown in one scene.
    """
    report = Report(
        "Sweep of selection settings", f"{len(settled)} settings over the same scenes and people."
    )
    report.add("How it was made", f"Command: {command}")
    for robot in dict.fromkeys(s.row["robot"] for s in settled):
        mine = [s for s in settled if s.row["robot"] == robot]
        named = [s for s in references if s.row["robot"] == robot]
        report.add(f"{robot}: the trade-off", _front(robot, mine, named), _best(mine, named))
        if rows and any(row["condition"] == PAPER.name for row in rows):
            report.add(f"{robot}: the front against the paper's cascade", differences(_listed(mine), rows))
            if jobs:
                report.add(f"{robot}: one scene, looked at", *motions(shown_settings(mine), rows, jobs))
        picture = _sensitivity(robot, mine)
        if picture is not None:
            report.add(f"{robot}: what each number does", picture)
    if stabilities:
        report.add("How firmly rankings stand", *_stability(stabilities))
    return report


def _front(robot: str, settled: Sequence[SettingResult], named: Sequence[SettingResult]) -> Picture:
    x_name, y_name = list(TRADE_OFF)[:2]
    x, y = (np.array([s.row[name] for s in settled], dtype=float) for name in (x_name, y_name))
    best = np.array([s.best for s in settled], dtype=bool)
    points = {s.row["condition"]: (s.row[x_name], s.row[y_name]) for s in named}
    caption = (
        "Every setting by its means over all cases; those joined are beaten by no other in both at once. "
        "Settings under which a case failed that others solve are not compared: their means leave it out."
    )
    success = np.array([s.row["success"] for s in settled])
    labels = LABELS.get(x_name, x_name), LABELS.get(y_name, y_name)
    figure = front(x, y, best, success == success.max(), labels, points)
    return Picture(f"front_{robot}", figure, caption)


def _best(settled: Sequence[SettingResult], named: Sequence[SettingResult]) -> Table:
    labels = {s.row["condition"]: label for label, s in shown_settings(settled).items()}
    varied = [name for name in settled[0].row if name.startswith("at_")] if settled else []
    head = ["setting", "", *(name.removeprefix("at_") for name in varied), "success", *COLUMNS]
    lines: list[list[Any]] = []
    for s in [*named, *_listed(settled)]:
        name, point = s.row["condition"], [s.row.get(name) for name in varied]
        lines.append([name, labels.get(name, ""), *point, s.row["success"], *(s.row[c] for c in COLUMNS)])
    return Table(head, lines, "Reference settings, and those on the front with its ends and its knee")


def _listed(settled: Sequence[SettingResult]) -> list[SettingResult]:
    """Return the settings on the front that are told, the shortest way first: ends, knee, and others."""
    shown = [s.row["condition"] for s in shown_settings(settled).values()]
    best = sorted((s for s in settled if s.best), key=lambda s: s.row["path_length_m"])
    # Many settings choose the same grasps everywhere: one of them is enough, if it can be one that is shown.
    first = sorted(best, key=lambda s: s.row["condition"] not in shown)
    distinct: dict[tuple[Any, ...], SettingResult] = {}
    for s in first:
        distinct.setdefault(tuple(s.row[name] for name in COLUMNS), s)
    kept = {s.row["condition"] for s in list(distinct.values())[:LISTED]}
    return [s for s in best if s.row["condition"] in kept]


def _sensitivity(robot: str, settled: Sequence[SettingResult]) -> Picture | None:
    numbers = [
        name
        for name, value in settled[0].row.items()
        if name.startswith("at_") and isinstance(value, (int, float)) and not isinstance(value, bool)
        if all(name in s.row for s in settled)
    ]
    if not numbers or len(settled) < 3:
        return None
    columns = {name.removeprefix("at_"): [s.row[name] for s in settled] for name in numbers}
    outcomes = {label: [s.row[name] for s in settled] for name, label in OUTCOMES.items()}
    caption = (
        "Means over all cases against each number that was varied; the line joins medians of equal counts."
    )
    return Picture(f"sensitivity_{robot}", sensitivity(columns, outcomes), caption)


def _stability(stabilities: Sequence[Stability]) -> tuple[Picture, Table]:
    names = list(dict.fromkeys(s.condition for s in stabilities))
    sizes = sorted({s.size for s in stabilities})
    of = {(s.condition, s.size): s for s in stabilities}
    tau = {n: [Estimate(of[n, z].tau, of[n, z].low, of[n, z].high) for z in sizes] for n in names}
    same = {n: [of[n, z].same_choice for z in sizes] for n in names}
    caption = (
        "Kendall's tau between the 30 best grasps before and after each weight (in a cascade: each number of grasps "
        "kept) was multiplied by a random factor; the band holds nine tenths of scenes and draws."
    )
    lines = [[s.condition, s.size, s.tau, s.low, s.high, s.same_choice] for s in stabilities]
    table = Table(["setting", "perturbation", "tau", "5 %", "95 %", "same choice"], lines)
    return Picture("stability", stability_lines(sizes, tau, same), caption), table


def differences(front: Sequence[SettingResult], rows: Sequence[Row], reference: str = PAPER.name) -> Table:
    """Return the table of paired differences of settings on the front from the reference."""
    labels = {s.row["condition"]: label for label, s in shown_settings(front).items()}
    lines: list[list[Any]] = []
    for s in front:
        name = s.row["condition"]
        line: list[Any] = [name, labels.get(name, "")]
        for number, measure in enumerate(MEASURES):
            d = difference_from(rows, s.row["robot"], name, reference, measure)
            interval = f"{d.mean.value:+.3g} ({d.mean.low:+.3g} to {d.mean.high:+.3g})" if d.pairs else "-"
            line += [*([] if number else [d.pairs]), interval, d.d_z]
        lines.append(line)
    head = ["setting", "", "scenes", *(cell for name in MEASURES.values() for cell in (name, "d_z"))]
    caption = (
        f"Settings on the front minus {reference}: mean paired differences with 95 % bootstrap intervals over scenes "
        "in which both arrived, and Cohen's d_z. They were picked for these very scenes, as the best of many, which no "
        "interval knows of: expect less elsewhere, and try them on other scenes before believing them."
    )
    return Table(head, lines, caption)


def motions(
    shown: Mapping[str, SettingResult], rows: Sequence[Row], jobs: Sequence[Job], reference: Condition = PAPER
) -> list[Picture | str]:
    """Return who led when and which way the tool went, under the ``shown`` settings and the reference, in one scene.

    The scene is the one, among the ``jobs`` in which all of them arrived, where they choose the most different grasps.
    """
    if not shown:
        return ["There is no front to show."]
    robot = next(iter(shown.values())).row["robot"]
    labels = {s.row["condition"]: f"{label} ({s.row['condition']})" for label, s in shown.items()}
    job = _telling(robot, [*labels, reference.name], rows, jobs)
    if job is None:
        return ["There is no scene in which the reference and all of the front's settings arrive."]
    by_name = {c.name: c for c in job.conditions}
    wanted = [Condition(reference.name, reference.rule, reference.measure)]
    wanted += [Condition(label, by_name[name].rule, by_name[name].measure) for name, label in labels.items()]
    paths = ways(job.scene, job.person, wanted, job.settings)
    world = job.scene.world()
    objects = {name: (model.parts, world.X_WO[name]) for name, model in world.objects.items()}
    title = f"{robot}, scene {job.scene.seed}, {job.scene.goal}"
    way = "The way of the tool, coloured by mode; a circle marks the hand-over, a fork the chosen grasp."
    led = "Who led when, from the first sample to the grasp."
    drawn = trajectories(objects, paths, title, job.scene.goal)
    return [
        Picture(f"ways_{robot}", drawn, f"{title}: the front's settings and the reference. {way}"),
        Picture(f"timelines_{robot}", timelines(paths), f"{title}. {led}"),
    ]


def _telling(robot: str, names: Sequence[str], rows: Sequence[Row], jobs: Sequence[Job]) -> Job | None:
    """Return the job with the most different grasps under conditions of these ``names``, all of which arrive."""
    chosen: dict[tuple[str, str, int], dict[str, tuple[Any, ...]]] = {}
    for row in rows:
        if row["robot"] == robot and row["condition"] in names and row["arrived"]:
            case = (row["scene"], row["person"], row["person_seed"])
            grasp = (row["object"], row["candidate"], row["half_turn"])
            chosen.setdefault(case, {})[row["condition"]] = grasp
    best, most = None, 0
    for job in jobs:
        grasps = chosen.get((job.scene.hash, job.person.kind, job.person.seed), {})
        if len(grasps) == len(names) and len(set(grasps.values())) > most:
            best, most = job, len(set(grasps.values()))
    return best


def rows_of(settled: Sequence[SettingResult]) -> list[Row]:
    """Return the settings as flat rows."""
    return [{**s.row, "best": s.best} for s in settled]
