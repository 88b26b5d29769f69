"""Analysis of trials: means of each participant, and differences within participants.

The participant is the unit: a person counts once, however many trials there were. A trial that failed has no time to
the grasp, so that everything but success and workload is compared in those scenes in which a participant succeeded
under both conditions.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import NamedTuple

import numpy as np
from pandas import DataFrame

from optsc.errors import InvalidValue, Mismatch, UnknownName
from optsc.study.arbitration_report import MEASURE_TITLES
from optsc.study.outcomes import Row
from optsc.study.participants.plan import StudyPlan
from optsc.study.participants.workload import SCALES
from optsc.study.statistics import Interval, PairedDifference, bootstrap, mean_of, paired_difference

WORKLOAD = {f"tlx_{name}": name for name in SCALES}
"""The six scales, of which a block has one answer each."""
MEASURES = {"success": "success [share]", **MEASURE_TITLES, "tlx_raw": "workload (raw NASA-TLX)"}
"""What is compared, with its unit."""
VALUES = [*MEASURES, *WORKLOAD]
ALWAYS = ("success", "tlx_raw", *WORKLOAD)
"""Measures that also a failed trial has."""
TRIAL = ["participant", "condition", "condition_number", "place", "scene_seed"]
"""Columns that tell trials apart."""


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
        Mismatch: a trial is of another plan.
        InvalidValue: there is none, or one of somebody who is not in the plan.
    """
    if not rows:
        raise InvalidValue("trials that are done", 0, "1 or more; `optsc study people run` executes them")
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


def participant_means(rows: Sequence[Row]) -> DataFrame:
    """Return a line for each participant and condition, practice left out: means of the trials, and the answers."""
    groups = _measured(rows).groupby(["participant", "condition"])
    means = groups[VALUES].agg(mean_of)
    means.insert(0, "place", groups["place"].first())
    means.insert(1, "trials", groups.size())
    return means.reset_index()


def average(means: DataFrame, condition: str, measure: str, seed: int = 0) -> Interval:
    """Return the mean over participants of what `participant_means` gave, with its interval."""
    values = means.loc[means["condition"] == condition, measure].dropna()
    return bootstrap(values, np.random.default_rng(seed))


def differences(rows: Sequence[Row], reference: str, seed: int = 0) -> list[Difference]:
    """Return the difference of every other condition from ``reference`` in every measure; raise `UnknownName`.

    Each participant's mean over the compared scenes is one of the paired values; ``seed`` is of the bootstrap.
    """
    trials = _measured(rows)
    numbers = trials.drop_duplicates("condition").sort_values("condition_number")
    conditions = numbers["condition"].tolist()
    if reference not in conditions:
        raise UnknownName("condition with trials", reference, conditions)
    found = []
    for condition in conditions:
        for measure in VALUES if condition != reference else ():
            pairs = _paired(trials, condition, reference, measure)
            # The same resamples for every measure: intervals differ by the data alone.
            difference = paired_difference(pairs["one"], pairs["other"], np.random.default_rng(seed))
            found.append(Difference(condition, reference, measure, difference))
    return found


def _measured(rows: Sequence[Row]) -> DataFrame:
    """Return the trials that count, with NaN for what a trial does not have."""
    table = DataFrame([row for row in rows if not row["practice"]]).reindex(columns=[*TRIAL, *VALUES])
    table[VALUES] = table[VALUES].astype(float)
    table.loc[table["success"] == 0.0, [name for name in VALUES if name not in ALWAYS]] = nan
    return table


def _paired(trials: DataFrame, condition: str, reference: str, measure: str) -> DataFrame:
    """Return the means of each participant under either condition, over the scenes that have a value under both."""
    one, other = (
        trials[trials["condition"] == name].set_index(["participant", "scene_seed"])[measure]
        for name in (condition, reference)
    )
    pairs = one.to_frame("one").join(other.rename("other"), how="inner").dropna()
    return pairs.groupby("participant").agg(mean_of)
