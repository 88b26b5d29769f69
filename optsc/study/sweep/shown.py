"""A sweep's front looked at: which of its settings to show, how they differ from the paper's, how they move.

A front of many settings has three that say most: its two ends, and the knee between them, where giving up some of one
thing for the other pays least in either direction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from optsc.study.approach_report import ways
from optsc.study.conditions import PAPER, Condition
from optsc.study.outcomes import Job, Row
from optsc.study.statistics import PairedDifference, averages, paired_difference
from optsc.study.sweep.results import TRADE_OFF, Settled
from optsc.viewers.report import Picture, Table
from optsc.viewers.report_motion import timelines, trajectories

KNEE = "knee"
"""Label of the setting between the ends of a front."""
MEASURES: Mapping[str, str] = {
    "path_length_m": "path [m]",
    "duration_s": "time [s]",
    "rotation_rad": "rotation [rad]",
    "target_yoshikawa": "manipulability",
}
"""What settings on the front are compared in."""


def shown_settings(
    settled: Sequence[Settled], robot: str | None = None, trade_off: Mapping[str, float] = TRADE_OFF
) -> dict[str, Settled]:
    """Return both ends of the front and its knee, by what they are: ``least path_length_m``, ``knee``, and so on.

    Ends are those of the first two measures of ``trade_off``. The knee is the setting farthest below the line
    between them, both measures counted in shares of the front's extent (I. Das 1999). Fewer where the front has fewer
    settings that differ; none without a front. ``robot`` is by default the first that there is.
    """
    names = list(trade_off)[:2]
    mine = [s for s in settled if robot in (None, s.row["robot"])]
    front = [s for s in mine if s.best and s.row["robot"] == mine[0].row["robot"]]
    if not front:
        return {}
    costs = np.array([[trade_off[name] * s.row[name] for name in names] for s in front])
    first, last = (int(np.lexsort((costs[:, 1 - k], costs[:, k]))[0]) for k in (0, 1))
    labels = [f"{'least' if trade_off[name] > 0.0 else 'most'} {name}" for name in names]
    if np.array_equal(costs[first], costs[last]):
        return {f"{labels[0]}, {labels[1]}": front[first]}
    found = {labels[0]: front[first], labels[1]: front[last]}
    low, high = costs.min(axis=0), costs.max(axis=0)
    # The line goes from (0, 1) to (1, 0); what lies below it is better in both than a mixture of the ends.
    distance = 1.0 - ((costs - low) / (high - low)).sum(axis=1)
    distance[np.all(costs == costs[first], axis=1) | np.all(costs == costs[last], axis=1)] = -np.inf
    knee = int(np.argmax(distance))
    if np.isfinite(distance[knee]):
        found = {labels[0]: front[first], KNEE: front[knee], labels[1]: front[last]}
    return found


def difference_from(
    rows: Sequence[Row], robot: str, condition: str, reference: str, measure: str, seed: int = 0
) -> PairedDifference:
    """Return ``condition`` minus ``reference`` in a ``measure``, over the scenes in which both arrived.

    The same person has to arrive at the same object. Several people in a scene count as one, with the mean of their
    numbers. ``seed`` is of the bootstrap.
    """
    sides: dict[tuple[str, str, int], dict[str, Row]] = {}
    for row in rows:
        if row["robot"] == robot and row["condition"] in (condition, reference) and row["arrived"]:
            case = (row["scene"], row["person"], row["person_seed"])
            sides.setdefault(case, {})[row["condition"]] = row
    both = {
        case: side
        for case, side in sides.items()
        if len(side) == 2 and side[condition]["object"] == side[reference]["object"]
    }
    a = [side[condition][measure] for side in both.values()]
    b = [side[reference][measure] for side in both.values()]
    return paired_difference(*averages([case[0] for case in both], a, b), np.random.default_rng(seed))


def differences(front: Sequence[Settled], rows: Sequence[Row], reference: str = PAPER.name) -> Table:
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
    shown: Mapping[str, Settled], rows: Sequence[Row], jobs: Sequence[Job], reference: Condition = PAPER
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
