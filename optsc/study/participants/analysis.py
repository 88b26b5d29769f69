"""What people's trials add up to: means of each participant, and differences within participants.

The participant is the unit: a person counts once, however many trials there were. A trial that failed has no time to
the grasp, so that everything but success and workload is compared in those scenes in which a participant succeeded
under both conditions.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import NamedTuple

import numpy as np

from optsc.errors import InvalidValue, Mismatch, UnknownName
from optsc.study.arbitration_report import COLUMNS
from optsc.study.outcomes import Row
from optsc.study.participants.plan import StudyPlan
from optsc.study.participants.workload import SCALES
from optsc.study.statistics import Interval, PairedDifference, bootstrap, mean_of, paired_difference

WORKLOAD = {f"tlx_{name}": name for name in SCALES}
"""The six scales, of which a block has one answer each."""
MEASURES = {"success": "success [share]", **COLUMNS, "tlx_raw": "workload (raw NASA-TLX)"}
"""What is compared, with its unit."""
ALWAYS = ("success", "tlx_raw", *WORKLOAD)
"""Measures that also a failed trial has."""


class Difference(NamedTuple):
    """What separates a condition from the reference in one measure, within participants."""

    condition: str
    reference: str
    measure: str
    found: PairedDifference

    def row(self) -> Row:
        """Return the difference as one flat row."""
        content = self.found._asdict()
        for name in ("mean", "median"):
            interval = content.pop(name)
            content |= {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}
        names = {"condition": self.condition, "reference": self.reference, "measure": self.measure}
        return {**names, "participants": content.pop("pairs"), **content}


def tidy(plan: StudyPlan, rows: Sequence[Row]) -> list[Row]:
    """Return what `optsc.study.participants.collect` gave, with the place of each condition in its participant's order.

    Raises:
        Mismatch: a trial was carried out by another plan.
        InvalidValue: there is none, or one of somebody who is not in the plan.
    """
    if not rows:
        raise InvalidValue("trials that are done", 0, "1 or more; `optsc study people run` carries them out")
    listed = []
    for row in rows:
        trial = f"trial of subject {row['participant']}, {row['condition']}, run {row['run']}"
        if row.get("plan") != plan.key:
            raise Mismatch(trial, f"plan {row.get('plan')}", f"plan {plan.key}")
        if not 1 <= row["participant"] <= plan.participants:
            raise InvalidValue(f"participant of the {trial}", row["participant"], f"1 to {plan.participants}")
        place = plan.design.order(row["participant"]).index(row["condition"]) + 1
        head = {name: row[name] for name in ("study", "participant", "condition")}
        listed.append({**head, "place": place, **row})
    return listed


def participant_means(rows: Sequence[Row]) -> list[Row]:
    """Return a row for each participant and condition, practice left out: means of the trials, and the answers."""
    means = []
    for participant, condition in sorted({(row["participant"], row["condition"]) for row in rows}):
        mine = _trials(rows, participant, condition)
        if mine:
            values = {name: mean_of([_value(row, name) for row in mine]) for name in (*MEASURES, *WORKLOAD)}
            head = {"participant": participant, "condition": condition, "place": mine[0]["place"]}
            means.append({**head, "trials": len(mine), **values})
    return means


def average(means: Sequence[Row], condition: str, measure: str, seed: int = 0) -> Interval:
    """Return the mean over participants of what `participant_means` gave, with its interval."""
    values = [row[measure] for row in means if row["condition"] == condition and np.isfinite(row[measure])]
    return bootstrap(values, np.random.default_rng(seed))


def differences(rows: Sequence[Row], reference: str, seed: int = 0) -> list[Difference]:
    """Return the difference of every other condition from ``reference`` in every measure; raise `UnknownName`.

    Each participant's mean over the compared scenes is one of the paired values; ``seed`` is of the bootstrap.
    """
    conditions = list(dict.fromkeys(row["condition"] for row in rows if not row["practice"]))
    if reference not in conditions:
        raise UnknownName("condition with trials", reference, conditions)
    conditions.sort(key=lambda name: next(r["condition_number"] for r in rows if r["condition"] == name))
    found = []
    for condition in conditions:
        for measure in (*MEASURES, *WORKLOAD) if condition != reference else ():
            a, b = _paired(rows, condition, reference, measure)
            # The same resamples for every measure: intervals differ by the data alone.
            difference = paired_difference(a, b, np.random.default_rng(seed))
            found.append(Difference(condition, reference, measure, difference))
    return found


def _paired(
    rows: Sequence[Row], condition: str, reference: str, measure: str
) -> tuple[list[float], list[float]]:
    """Return one value for each participant under either condition."""
    a, b = [], []
    for participant in sorted({row["participant"] for row in rows}):
        one = {row["scene_seed"]: row for row in _trials(rows, participant, condition)}
        other = {row["scene_seed"]: row for row in _trials(rows, participant, reference)}
        pairs = [(_value(one[seed], measure), _value(other[seed], measure)) for seed in one if seed in other]
        complete = [pair for pair in pairs if np.isfinite(pair).all()]
        a.append(mean_of([x for x, _ in complete]))
        b.append(mean_of([y for _, y in complete]))
    return a, b


def _trials(rows: Sequence[Row], participant: int, condition: str) -> list[Row]:
    return [
        row
        for row in rows
        if row["participant"] == participant and row["condition"] == condition and not row["practice"]
    ]


def _value(row: Row, measure: str) -> float:
    if measure not in ALWAYS and not row["success"]:
        return nan
    value = row.get(measure)
    return nan if value is None else float(value)
