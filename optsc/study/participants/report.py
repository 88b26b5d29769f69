"""Report of a study with participants: means, workload, differences within participants, who is still to come."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pandas import DataFrame

from optsc.study.arbitration_report import JUMP_TITLES
from optsc.study.outcomes import Row
from optsc.study.participants.analysis import (
    MEASURES,
    WORKLOAD,
    Difference,
    average,
    differences,
    participant_means,
    tidy,
)
from optsc.study.participants.participant_session import collect
from optsc.study.participants.plan import StudyPlan
from optsc.study.results_folder import save_rows, save_summary
from optsc.study.statistics import mean_of
from optsc.viewers.report import Code, Picture, Report, Table
from optsc.viewers.report_statistics import Estimate, bars, forest

SHOWN = {"success": 1.0, "grasp_s": -1.0, "effort_m": -1.0, "tlx_raw": -1.0}
"""Measures in the figures, and the sign of a difference that is for the better."""
FEW = 6
"""With fewer participants intervals say little: resampling cannot invent people who were not there."""


def save_report(
    plan: StudyPlan,
    directory: Path,
    output: Path,
    command: str,
    *,
    reference: str | None = None,
    seed: int = 0,
) -> tuple[Path, list[Difference]]:
    """Write tables, summary and page of the study in ``directory`` to ``output``; return the page and the differences.

    Written are ``trials`` (a row for each trial, practice included), ``participants`` (a row for each participant and
    condition) and ``differences``, each as CSV and Parquet, ``summary.json``, ``report.html`` and its ``figures``.

    Args:
        plan: of the study.
        directory: where its trials are.
        output: where the report goes.
        command: that makes it, to be kept with it.
        reference: the condition that the others are compared with; the plan's first by default.
        seed: of the bootstrap.

    Raises:
        InvalidValue, Mismatch, DamagedFile: see `tidy` and `collect`.
        UnknownName: nothing was done under the reference.
    """
    rows = tidy(plan, collect(directory))
    means = participant_means(rows)
    found = [] if means.empty else differences(rows, reference or plan.design.conditions[0], seed)
    save_rows(rows, output, "trials")
    tables = {"participants": means.to_dict("records"), "differences": [one.row() for one in found]}
    for name, table in tables.items():
        if table:
            save_rows(table, output, name)
    page = build(plan, rows, means, found, progress(plan, directory), command, seed).save(output)
    save_summary({"command": command, **_summary(plan, rows, means, found, seed)}, output)
    return page, found


def _summary(
    plan: StudyPlan, rows: Sequence[Row], means: DataFrame, found: Sequence[Difference], seed: int
) -> dict[str, Any]:
    return {
        "study": plan.design.name,
        "plan": plan.key,
        "trials": len(rows),
        "operators": dict(Counter(row["operator"] for row in rows)),
        "conditions": {
            name: {measure: average(means, name, measure, seed) for measure in (*MEASURES, *WORKLOAD)}
            for name in _conditions(plan, means)
        },
        "differences": [one.row() for one in found],
    }


def progress(plan: StudyPlan, directory: Path) -> list[tuple[int, int, int, tuple[str, ...]]]:
    """Return for each participant the number, the trials done and planned, and the conditions still to be rated."""
    lines = []
    for participant in range(1, plan.participants + 1):
        session = plan.session(participant, directory)
        planned = sum(len(block.trials) for block in session.blocks)
        unrated = tuple(block.condition for block in session.unrated)
        lines.append((participant, planned - len(session.remaining), planned, unrated))
    return lines


def build(
    plan: StudyPlan,
    rows: Sequence[Row],
    means: DataFrame,
    found: Sequence[Difference],
    done: Sequence[tuple[int, int, int, tuple[str, ...]]],
    command: str,
    seed: int = 0,
) -> Report:
    """Return the page."""
    report = Report(
        f"Study with people: {plan.design.name}",
        "Every participant meets every condition, in counterbalanced order and in the same scenes. Success is a grasp "
        "of the object that was wanted; times and paths count up to the moment at which the jaws begin to close. "
        "Practice is left out. The participant is the unit: means and differences are of participants.",
    )
    report.add("How it was made", Code(command), *_facts(plan, rows), _progress(done))
    if means.empty:
        report.add("Results", "So far there was only practice.")
        return report
    report.add("Means", _means_picture(plan, means, seed), _means_table(plan, means, MEASURES, seed))
    report.add("Workload", _means_table(plan, means, WORKLOAD, seed))
    report.add("Differences within participants", *_differences(found))
    report.add("Jumps at changes of mode", _jumps(plan, rows))
    report.add("By place in the order", _places(plan, means))
    return report


def _facts(plan: StudyPlan, rows: Sequence[Row]) -> list[str]:
    design = plan.design
    facts = [
        f"{plan.participants} participants, {len(design.conditions)} conditions, {design.trials} trials and "
        f"{design.practice} for practice of each, {design.time_limit:g} s at most; orders are balanced with every "
        f"{design.group} participants. {plan.robot}, {plan.objects} objects, scenes {plan.level}, follower "
        f"{plan.follower}, {plan.rate:g} Hz; seed {design.seed}.",
        "Hands: " + ", ".join(f"{kind} {n}" for kind, n in Counter(row["operator"] for row in rows).items()) + ".",
    ]
    policies = DataFrame(rows).groupby("condition", sort=False)["policy"].nunique()
    changed = policies.index[policies > 1].tolist()
    if changed:
        facts.append(f"Settings of the policy changed during the study: {', '.join(changed)}.")
    if len({row["operator"] for row in rows}) > 1:
        facts.append("Hands of more than one kind are in these numbers; rehearsals belong into another folder.")
    people = {row["participant"] for row in rows}
    if len(people) < FEW:
        facts.append(f"Only {len(people)} took part so far: intervals of so few say little.")
    return facts


def _progress(done: Sequence[tuple[int, int, int, tuple[str, ...]]]) -> Table:
    lines = [[number, f"{n} of {planned}", ", ".join(left) or "–"] for number, n, planned, left in done]
    return Table(["participant", "trials", "not rated yet"], lines, "Who has done what")


def _conditions(plan: StudyPlan, means: DataFrame) -> list[str]:
    return [name for name in plan.design.conditions if name in set(means["condition"])]


def _means_picture(plan: StudyPlan, means: DataFrame, seed: int) -> Picture:
    groups = {
        MEASURES[measure]: {name: Estimate(*average(means, name, measure, seed)) for name in _conditions(plan, means)}
        for measure in SHOWN
    }
    return Picture("means", bars(groups, {}), "Means over participants with 95 % bootstrap intervals.")


def _means_table(plan: StudyPlan, means: DataFrame, measures: dict[str, str], seed: int) -> Table:
    lines = []
    for name in _conditions(plan, means):
        line: list[Any] = [name, int((means["condition"] == name).sum())]
        for measure in measures:
            value, low, high = average(means, name, measure, seed)
            line.append(f"{value:.3g} ({low:.3g} to {high:.3g})" if value == value else None)
        lines.append(line)
    head = ["condition", "participants", *measures.values()]
    return Table(head, lines, "Means over participants with 95 % bootstrap intervals")


def _differences(found: Sequence[Difference]) -> list[Any]:
    if not found:
        return ["There is one condition only."]
    reference = found[0].reference
    conditions = list(dict.fromkeys(one.condition for one in found))
    by_place = {(one.condition, one.measure): one.found for one in found}
    panels = {
        MEASURES[m]: {f"minus {reference}": [Estimate(*by_place[name, m].mean) for name in conditions]}
        for m in SHOWN
        if any(by_place[name, m].pairs for name in conditions)
    }
    picture = Picture(
        "differences",
        forest(panels, conditions, {MEASURES[m]: sign for m, sign in SHOWN.items()}),
        f"Mean differences within participants, minus {reference}, with 95 % bootstrap intervals; the tinted side is "
        "better than that.",
    )
    lines = []
    for one in found:
        d = one.found
        title = {**MEASURES, **WORKLOAD}[one.measure]
        interval = f"{d.mean.low:.3g} to {d.mean.high:.3g}" if d.pairs else None
        clear = bool(d.mean.low * d.mean.high > 0.0) if d.pairs else None
        numbers = [d.pairs, d.mean_a, d.mean_b, d.mean.value, interval, d.d_z, d.rank_biserial, clear]
        lines.append([one.condition, title, *numbers])
    head = ["condition", "measure", "participants", "mean", reference, f"minus {reference}", "95 %", "d_z"]
    caption = (
        "Each participant's mean over the scenes in which they succeeded under both (success and workload: over all). "
        "There are many rows, and intervals are not corrected for that."
    )
    return [picture, Table([*head, "rank-biserial", "clear of zero"], lines, caption)]


def _jumps(plan: StudyPlan, rows: Sequence[Row]) -> Table:
    trials = DataFrame([row for row in rows if not row["practice"]])
    lines = []
    for name in plan.design.conditions:
        jumps = trials[trials["condition"] == name].reindex(columns=list(JUMP_TITLES)).astype(float)
        cells = [f"{mean_of(x):.3g}, at most {x.max():.3g}" if x.notna().any() else None for _, x in jumps.items()]
        lines.append([name, *cells])
    return Table(["condition", *JUMP_TITLES.values()], lines, "Means, and the worst of all trials")


def _places(plan: StudyPlan, means: DataFrame) -> Table:
    lines = []
    for place in range(1, len(plan.design.conditions) + 1):
        mine = means[means["place"] == place]
        lines.append([place, len(mine), *(mean_of(mine[name]) for name in SHOWN)])
    caption = (
        "Means over whatever condition came first, second, ...: a trend is practice or fatigue, which counterbalanced "
        "orders spread over all conditions, once there are as many participants as a balanced group has."
    )
    return Table(["place", "participants", *(MEASURES[name] for name in SHOWN)], lines, caption)
