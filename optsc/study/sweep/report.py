"""The report of a sweep: the trade-off, what each number does, how firmly rankings stand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from optsc.study.conditions import PAPER
from optsc.study.outcomes import Job, Row
from optsc.study.stability import Stability
from optsc.study.sweep.results import TRADE_OFF, Settled
from optsc.study.sweep.shown import differences, motions, shown_settings
from optsc.viewers.report import Picture, Report, Table
from optsc.viewers.report_statistics import Estimate, front, sensitivity, stability_lines

LABELS = {"path_length_m": "path of the tool [m]", "target_yoshikawa": "manipulability at the grasp"}
OUTCOMES = {"path_length_m": "path [m]", "duration_s": "time [s]", "target_yoshikawa": "manipulability"}
COLUMNS = (
    *("path_length_m", "duration_s", "rotation_rad", "ldlj_joint"),
    *("target_yoshikawa", "clearance_m"),
)
"""Means that are told of each setting on the front."""
LISTED = 30
"""Settings on the front that are told."""


def build(
    settled: Sequence[Settled],
    references: Sequence[Settled],
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


def _front(robot: str, settled: Sequence[Settled], named: Sequence[Settled]) -> Picture:
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


def _best(settled: Sequence[Settled], named: Sequence[Settled]) -> Table:
    labels = {s.row["condition"]: label for label, s in shown_settings(settled).items()}
    varied = [name for name in settled[0].row if name.startswith("at_")] if settled else []
    head = ["setting", "", *(name.removeprefix("at_") for name in varied), "success", *COLUMNS]
    lines: list[list[Any]] = []
    for s in [*named, *_listed(settled)]:
        name, point = s.row["condition"], [s.row.get(name) for name in varied]
        lines.append([name, labels.get(name, ""), *point, s.row["success"], *(s.row[c] for c in COLUMNS)])
    return Table(head, lines, "Reference settings, and those on the front with its ends and its knee")


def _listed(settled: Sequence[Settled]) -> list[Settled]:
    """Return the settings on the front that are told, the shortest way first: ends, knee, and others."""
    shown = [s.row["condition"] for s in shown_settings(settled).values()]
    best = sorted((s for s in settled if s.best), key=lambda s: s.row["path_length_m"])
    # Many settings choose the same grasps everywhere: one of them is enough, if it can be one that is shown.
    first = sorted(best, key=lambda s: s.row["condition"] not in shown)
    distinct: dict[tuple[Any, ...], Settled] = {}
    for s in first:
        distinct.setdefault(tuple(s.row[name] for name in COLUMNS), s)
    kept = {s.row["condition"] for s in list(distinct.values())[:LISTED]}
    return [s for s in best if s.row["condition"] in kept]


def _sensitivity(robot: str, settled: Sequence[Settled]) -> Picture | None:
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


def rows_of(settled: Sequence[Settled]) -> list[Row]:
    """Return the settings as flat rows."""
    return [{**s.row, "best": s.best} for s in settled]
