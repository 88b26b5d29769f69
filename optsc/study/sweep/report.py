"""Report of a sweep: the trade-off and its front, what each number does, how stable the rankings are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optsc.study.cases import Job
from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER, Condition
from optsc.study.outcomes import Row
from optsc.study.report_parts import APPROACH_PATHS, MODES_TO_THE_GRASP, approach_paths, path_picture
from optsc.study.results_folder import save_rows, save_summary
from optsc.study.stability import Stability, stability
from optsc.study.sweep.results import (
    CASE,
    TRADE_OFF,
    difference_from,
    setting_results,
    shown_settings,
    trade_off_of,
)
from optsc.viewers.report import Picture, Report, Table
from optsc.viewers.report_motion import timelines
from optsc.viewers.report_statistics import Estimate, front, sensitivity, stability_lines

if TYPE_CHECKING:
    from pandas import DataFrame

REFERENCES = (PAPER.name, MANIPULABILITY_ONLY.name)
"""Conditions that every sweep has beside its settings."""
LABELS = {"path_length_m": "path of the tool [m]", "target_yoshikawa": "manipulability at the grasp"}
OUTCOMES = {"path_length_m": "path [m]", "duration_s": "time [s]", "target_yoshikawa": "manipulability"}
COLUMNS = (
    *("path_length_m", "duration_s", "rotation_rad", "ldlj_joint"),
    *("target_yoshikawa", "clearance_m"),
)
"""Means that are listed for each setting on the front."""
MEASURES: Mapping[str, str] = {
    "path_length_m": "path [m]",
    "duration_s": "time [s]",
    "rotation_rad": "rotation [rad]",
    "target_yoshikawa": "manipulability",
}
"""What settings on the front are compared in."""
LISTED = 30
"""Settings on the front that are listed."""


def save_report(
    rows: Sequence[Row],
    jobs: Sequence[Job[Condition]],
    objectives: Mapping[str, str],
    output: Path,
    command: str,
    *,
    searched: bool = False,
    stability_cases: int = 10,
    seed: int = 0,
) -> tuple[Path, int]:
    """Write tables, summary and page of a sweep to ``output``; return the page and the number of settings on the front.

    Args:
        rows: of all settings and of `REFERENCES` in every case, see `run_jobs`.
        jobs: that the rows are of.
        objectives: ``minimize`` or ``maximize`` by the names of the measures that the front is about.
        output: where the files go: ``table`` with the rows, ``settings``, ``summary.json``, ``report.html``.
        command: that made it, to be kept with it.
        searched: whether the objectives were chosen for a search; then they have a picture.
        stability_cases: in how many cases rankings are perturbed.
        seed: of the perturbations.
    """
    trade_off = trade_off_of(objectives)
    settings = setting_results([row for row in rows if row["condition"] not in REFERENCES], trade_off)
    references = setting_results([row for row in rows if row["condition"] in REFERENCES])
    save_rows(rows, output)
    save_rows([*references.to_dict("records"), *settings.to_dict("records")], output, "settings")
    stabilities = stability_of_front(settings, jobs, trade_off, stability_cases, seed)
    report = build(settings, references, stabilities, command, rows=rows, jobs=jobs)
    if searched:
        report.add("The objectives of the search", _objectives_picture(settings, references, objectives))
    page = report.save(output)
    best = settings[settings["best"]]
    facts = {
        "command": command,
        "seed": seed,
        "settings": len(settings),
        "cases": len(jobs),
        "rows": len(rows),
        "objectives": objectives,
        "front": best.drop(columns="best").to_dict("records"),
        "references": references.drop(columns="best").to_dict("records"),
        "stability": [s._asdict() for s in stabilities],
    }
    save_summary(facts, output)
    return page, len(best)


def stability_of_front(
    settings: DataFrame, jobs: Sequence[Job[Condition]], trade_off: Mapping[str, float], cases: int, seed: int
) -> list[Stability]:
    """Return how stable rankings of the paper, the ends of the front and its knee are in so many cases, arm by arm."""
    found: list[Stability] = []
    robots = list(dict.fromkeys(job.scene.robot for job in jobs)) if cases else []
    for robot in robots:
        mine = [job for job in jobs if job.scene.robot == robot]
        by_name = {condition.name: condition for condition in mine[0].conditions}
        wanted = {PAPER.name: PAPER}
        for label, name in shown_settings(settings, robot, trade_off).items():
            point = ", ".join(
                f"{n.removeprefix('weight.')} {v:.2g}" if isinstance(v, float) else f"{n} {v}"
                for n, v in by_name[name].about.items()
            )
            wanted[f"{label} ({point})"] = by_name[name]
        before = f"{robot}: " if len(robots) > 1 else ""
        named = [replace(condition, name=before + name) for name, condition in wanted.items()]
        pairs = [(job.scene, job.person) for job in mine[:cases]]
        found += stability(pairs, named, settings=mine[0].settings, seed=seed)
    return found


def build(
    settings: DataFrame,
    references: DataFrame,
    stabilities: Sequence[Stability],
    command: str,
    *,
    rows: Sequence[Row] = (),
    jobs: Sequence[Job[Condition]] = (),
) -> Report:
    """Return the page.

    Args:
        settings: of the sweep, see `setting_results`.
        references: settings to compare with, such as the paper's.
        stabilities: of rankings, if they were asked for.
        command: that made it.
        rows: of all settings and references in every case; with them the front is compared with the paper's cascade.
        jobs: that the rows are of; with them the ends of the front and its knee are shown in one scene.
    """
    from pandas import DataFrame

    report = Report("Sweep of selection settings", f"{len(settings)} settings over the same scenes and people.")
    report.add("How it was made", f"Command: {command}")
    table = DataFrame(rows)
    for robot, mine in settings.groupby("robot", sort=False):
        named = references[references["robot"] == robot]
        report.add(f"{robot}: the trade-off", _front(robot, mine, named), _best(mine, named))
        if rows and (table["condition"] == PAPER.name).any():
            report.add(f"{robot}: the front against the paper's cascade", differences(_listed(mine), table))
            if jobs:
                report.add(f"{robot}: one scene, looked at", *motions(robot, mine, table, jobs))
        picture = _sensitivity(robot, mine)
        if picture is not None:
            report.add(f"{robot}: what each number does", picture)
    if stabilities:
        report.add("How firmly rankings stand", *_stability(stabilities))
    return report


def _front(robot: str, settings: DataFrame, references: DataFrame) -> Picture:
    names = list(TRADE_OFF)[:2]
    caption = (
        "Every setting by its means over all cases; those joined are beaten by no other in both at once. "
        "Settings under which a case failed that others solve are not compared: their means leave it out."
    )
    labels = [LABELS.get(name, name) for name in names]
    return Picture(f"front_{robot}", _front_figure(settings, references, names, labels), caption)


def _objectives_picture(settings: DataFrame, references: DataFrame, objectives: Mapping[str, str]) -> Picture:
    names = list(objectives)[:2]
    words = ", ".join(f"{name} ({direction})" for name, direction in objectives.items())
    caption = f"What was searched for: {words}. Settings are on the front with regard to all of these."
    return Picture("objectives", _front_figure(settings, references, names, names), caption)


def _front_figure(settings: DataFrame, references: DataFrame, names: Sequence[str], labels: Sequence[str]) -> Any:
    x, y = (settings[name].to_numpy(float) for name in names)
    compared = settings["success"] == settings["success"].max()
    points = {
        condition: (float(a), float(b)) for condition, a, b in references[["condition", *names]].itertuples(index=False)
    }
    best = settings["best"].to_numpy(bool)
    return front(x, y, best, compared.to_numpy(), (labels[0], labels[1]), points)


def _best(settings: DataFrame, references: DataFrame) -> Table:
    labels = {name: label for label, name in shown_settings(settings).items()}
    varied = [name for name in settings if name.startswith("at_")]
    columns = [*varied, "success", *COLUMNS]
    records = [*references.to_dict("records"), *_listed(settings).to_dict("records")]
    lines = [
        [row["condition"], labels.get(row["condition"], ""), *(row.get(name) for name in columns)] for row in records
    ]
    head = ["setting", "", *(name.removeprefix("at_") for name in columns)]
    return Table(head, lines, "Reference settings, and those on the front with its ends and its knee")


def _listed(settings: DataFrame) -> DataFrame:
    """Return the settings on the front that are listed, the shortest path first: ends, knee, and others."""
    best = settings[settings["best"]].sort_values("path_length_m", kind="stable")
    # Many settings choose the same grasps everywhere: one of them is enough, if it can be one that is shown.
    shown = best["condition"].isin(shown_settings(settings).values())
    distinct = best.loc[shown.sort_values(ascending=False, kind="stable").index].drop_duplicates(list(COLUMNS))
    return best[best["condition"].isin(distinct["condition"].head(LISTED))]


def _sensitivity(robot: str, settings: DataFrame) -> Picture | None:
    varied = settings[[name for name in settings if name.startswith("at_")]]
    numbers = varied.infer_objects().select_dtypes("number").dropna(axis="columns")
    if numbers.empty or len(settings) < 3:
        return None
    columns = {name.removeprefix("at_"): numbers[name].tolist() for name in numbers}
    outcomes = {label: settings[name].tolist() for name, label in OUTCOMES.items()}
    caption = "Means over all cases against each number that was varied; the line joins medians of equal counts."
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
    table = Table(["setting", "perturbation", "tau", "5 %", "95 %", "same choice"], stabilities)
    return Picture("stability", stability_lines(sizes, tau, same), caption), table


def differences(settings: DataFrame, rows: DataFrame, reference: str = PAPER.name) -> Table:
    """Return the table of paired differences of ``settings`` on the front from the reference."""
    labels = {name: label for label, name in shown_settings(settings).items()}
    lines: list[list[Any]] = []
    for robot, name in settings[["robot", "condition"]].itertuples(index=False):
        line: list[Any] = [name, labels.get(name, "")]
        for number, measure in enumerate(MEASURES):
            d = difference_from(rows, robot, name, reference, measure)
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
    robot: str,
    settings: DataFrame,
    rows: DataFrame,
    jobs: Sequence[Job[Condition]],
    reference: Condition = PAPER,
) -> list[Picture | str]:
    """Return modes over time and the path of the tool, under the shown settings and the reference, in one scene.

    The scene is the one, among the ``jobs`` in which all of them arrived, where they choose the most different grasps.
    """
    shown = shown_settings(settings)
    if not shown:
        return ["There is no front to show."]
    job = _most_telling(robot, [*shown.values(), reference.name], rows, jobs)
    if job is None:
        return ["There is no scene in which the reference and all of the front's settings arrive."]
    by_name = {c.name: c for c in job.conditions}
    wanted = [Condition(reference.name, reference.rule, reference.measure)]
    wanted += [
        Condition(f"{label} ({name})", by_name[name].rule, by_name[name].measure) for label, name in shown.items()
    ]
    paths = approach_paths(job.scene, job.person, wanted, job.settings)
    title = f"{robot}, scene {job.scene.seed}, {job.scene.goal}"
    words = f": the front's settings and the reference. {APPROACH_PATHS}"
    return [
        path_picture(f"ways_{robot}", job.scene, paths, title, words),
        Picture(f"timelines_{robot}", timelines(paths), f"{title}. {MODES_TO_THE_GRASP}"),
    ]


def _most_telling(
    robot: str, names: Sequence[str], rows: DataFrame, jobs: Sequence[Job[Condition]]
) -> Job[Condition] | None:
    """Return the job with the most different grasps under conditions of these ``names``, all of which arrive."""
    arrived = rows[(rows["robot"] == robot) & rows["condition"].isin(names) & rows["arrived"].astype(bool)]
    complete = arrived.groupby(CASE)["condition"].nunique() == len(names)
    grasps = arrived.drop_duplicates([*CASE, "object", "candidate", "half_turn"]).groupby(CASE).size()
    counts = grasps[complete].to_dict()
    if not counts:
        return None

    def different_grasps(job: Job[Condition]) -> int:
        return counts.get((job.scene.hash, job.person.kind, job.person.seed), 0)

    best = max(jobs, key=different_grasps)
    return best if different_grasps(best) else None
