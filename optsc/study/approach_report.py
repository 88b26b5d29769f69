"""Report of the grasp choice study: paired differences, where the claim fails and why, and pictures of cases."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from optsc.study.approach import (
    CLAIMS,
    STRATEGIES,
    Failure,
    StrategyComparison,
    explanation,
    pair_means,
    pairs_of,
)
from optsc.study.conditions import OperatorSpec
from optsc.study.episode_setup import EpisodeSettings
from optsc.study.outcomes import Row
from optsc.study.report_parts import (
    APPROACH_PATHS,
    MODES_TO_THE_GRASP,
    approach_paths,
    bounds,
    path_picture,
    percentage,
)
from optsc.study.scenes import Scene
from optsc.viewers.report import Picture, Report, Table
from optsc.viewers.report_motion import timelines
from optsc.viewers.report_statistics import Estimate, PairedValues, forest, paired_scatter

LISTED, EXPLAINED = 40, 12
"""Failing cases that are listed, and that are explained in words, the longest detours first."""
DRAWN = 2
"""Failing cases that are drawn for each arm."""
UNITS = {"shorter": "path [m]", "turns less": "turn [rad]", "quicker": "time [s]"}


def summary_of(comparisons: Sequence[StrategyComparison], failed: Sequence[Failure]) -> dict[str, Any]:
    """Return the results for machines."""
    results = [
        {
            "robot": c.robot,
            "measure": c.measure,
            "cases": c.cases[0],
            "complete_pairs": c.cases[1],
            "same_grasp": c.cases[2],
            "scenes": c.scenes[0],
            "scenes_compared": c.scenes[1],
            "success": c.arrived,
            "differences": {name: difference._asdict() for name, difference in c.differences.items()},
        }
        for c in comparisons
    ]
    reasons: dict[str, dict[str, int]] = {}
    for robot in dict.fromkeys(c.robot for c in comparisons):
        reasons[robot] = dict(Counter(f.why for f in failed if f.pair.paper["robot"] == robot).most_common())
    return {"comparisons": results, "failures": len(failed), "reasons": reasons}


def build(
    rows: Sequence[Row],
    comparisons: Sequence[StrategyComparison],
    failed: Sequence[Failure],
    scenes: Mapping[str, Scene],
    settings: EpisodeSettings,
    command: str,
) -> Report:
    """Return the report; ``scenes`` are those of the rows, by hash."""
    report = Report(
        "The grasp that suits hand and arm, against the grasp that suits the arm alone",
        "Both strategies start from the same hand-over in the same scene at the same speed; what differs is which "
        "grasp is chosen. Differences are paper minus manipulability only. A scene counts once: where several people "
        "do the same task in it, it has the mean of those who arrived under both strategies.",
    )
    report.add("How it was made", f"Command: {command}", *_counts(comparisons))
    report.add("The claim in parts", _forest(comparisons), *_tables(comparisons))
    report.add("Case by case", _scatter(rows, comparisons))
    report.add("Where it fails", *_failure_tables(failed), *_explained(failed, scenes, settings))
    report.add("Cases in pictures", *_pictures(rows, comparisons, failed, scenes, settings))
    return report


def _counts(comparisons: Sequence[StrategyComparison]) -> list[Table]:
    counted = ["cases", "both arrived", "same grasp", "scenes", "scenes compared"]
    head = ["arm", "M", *counted, *(f"success: {s.name}" for s in STRATEGIES)]
    lines = []
    for c in comparisons:
        shares = [percentage(c.arrived[strategy.name]) for strategy in STRATEGIES]
        lines.append([c.robot, c.measure, *c.cases, *c.scenes, *shares])
    caption = (
        "A case is a person in a scene. Success is arriving at a grasp of the wanted object, a mean over scenes with "
        "Wilson's interval for as many trials as there are scenes"
    )
    return [Table(head, lines, caption)]


def _forest(comparisons: Sequence[StrategyComparison]) -> Picture:
    robots = list(dict.fromkeys(c.robot for c in comparisons))
    measures = list(dict.fromkeys(c.measure for c in comparisons))
    by_place = {(c.robot, c.measure): c for c in comparisons}
    panels = {
        UNITS.get(part, part): {
            robot: [Estimate(*by_place[robot, m].differences[name].mean) for m in measures] for robot in robots
        }
        for part, (name, _) in CLAIMS.items()
    }
    signs = {UNITS.get(part, part): sign for part, (_, sign) in CLAIMS.items()}
    caption = (
        "Mean paired differences, paper minus manipulability only, with 95 % bootstrap intervals over scenes, for each "
        "definition of M. The tinted side is in favour of the claim; smoothness is log dimensionless jerk, greater is "
        "smoother."
    )
    return Picture("differences", forest(panels, measures, signs), caption)


def _tables(comparisons: Sequence[StrategyComparison]) -> list[Table]:
    head = ["M", "scenes", "paper", "other", "difference", "95 %", "relative", "d_z", "rank-biserial"]
    tables = []
    for robot in dict.fromkeys(c.robot for c in comparisons):
        for part, (name, sign) in CLAIMS.items():
            lines = []
            for c in (c for c in comparisons if c.robot == robot):
                d = c.differences[name]
                better = d.less if sign < 0.0 else d.more
                relative = f"{100 * d.relative:.1f} %"
                numbers = [d.pairs, d.mean_a, d.mean_b, d.mean.value, bounds(d.mean), relative]
                lines.append([c.measure, *numbers, d.d_z, d.rank_biserial, f"{100 * better:.0f} %"])
            tables.append(Table([*head, "paper better"], lines, f"{robot}: {part} ({name})"))
    return tables


def _scatter(rows: Sequence[Row], comparisons: Sequence[StrategyComparison]) -> Picture:
    measure = comparisons[0].measure
    panels = []
    for robot in dict.fromkeys(c.robot for c in comparisons):
        pairs = [pair for pair in pairs_of(rows, robot, measure) if pair.complete]
        y, x = (np.array(means) for means in pair_means(pairs, "path_length_m"))
        panels.append(PairedValues(f"{robot}, M: {measure}", x, y, y > x + 1e-6))
    figure = paired_scatter(panels, "manipulability only: path [m]", "paper: path [m]", "paper longer")
    return Picture(
        "paths",
        figure,
        "One point per scene, a mean where several people were in it; below the diagonal the paper's path is shorter.",
    )


def _failure_tables(failed: Sequence[Failure]) -> list[Table | str]:
    if not failed:
        return ["In no case was any part of the claim wrong."]
    reasons: Counter[tuple[str, str]] = Counter((f.pair.paper["robot"], f.why) for f in failed)
    lines = [[robot, why, count] for (robot, why), count in reasons.most_common()]
    listed = []
    columns = {"jump_target_distance_m": 1e3, "path_length_m": 1.0, "duration_s": 1.0}
    for failure in failed[:LISTED]:
        paper = failure.pair.paper
        numbers = [scale * side[name] for name, scale in columns.items() for side in failure.pair]
        case = [paper["robot"], paper["measure"], paper["scene_seed"], paper["goal"]]
        listed.append([*case, *numbers, ", ".join(failure.parts)])
    head = [
        "arm",
        "M",
        "scene",
        "object",
        "to grasp, paper [mm]",
        "other [mm]",
        "path, paper [m]",
        "other [m]",
    ]
    counted = "Why some part of the claim fails, counted over all definitions of M"
    longest = f"The {len(listed)} longest detours of {len(failed)}; all of them with all numbers are in failures.csv"
    return [
        Table(["arm", "why", "cases"], lines, counted),
        Table([*head, "time, paper [s]", "other [s]", "parts that fail"], listed, longest),
    ]


def _explained(failed: Sequence[Failure], scenes: Mapping[str, Scene], settings: EpisodeSettings) -> list[Table]:
    lines = []
    for failure in _distinct(failed)[:EXPLAINED]:
        paper = failure.pair.paper
        words = explanation(failure, settings, scenes[paper["scene"]])
        lines.append([f"{paper['robot']} {paper['measure']} {paper['scene_seed']}", failure.why, words])
    head = ["case", "why", "how the choice was made"]
    return [Table(head, lines, "Failing cases in detail")] if lines else []


def _distinct(failed: Sequence[Failure]) -> list[Failure]:
    """Return one failure for each scene and pair of choices: several definitions of M often choose the same two."""
    found: dict[tuple[Any, ...], Failure] = {}
    for failure in failed:
        paper, other = failure.pair
        found.setdefault((paper["scene"], paper["candidate"], other["candidate"]), failure)
    return list(found.values())


def _pictures(
    rows: Sequence[Row],
    comparisons: Sequence[StrategyComparison],
    failed: Sequence[Failure],
    scenes: Mapping[str, Scene],
    settings: EpisodeSettings,
) -> list[Picture]:
    pictures, bars = [], []
    for robot in dict.fromkeys(c.robot for c in comparisons):
        pairs = [p for p in pairs_of(rows, robot, comparisons[0].measure) if p.complete and not p.same_grasp]
        pairs.sort(key=lambda pair: pair.paper["path_length_m"] - pair.other["path_length_m"])
        shown = [("typical", pairs[len(pairs) // 2])] if pairs else []
        worst = [f.pair for f in _distinct(failed) if f.pair.paper["robot"] == robot and f.pair.complete]
        shown += [(f"failing {k}", pair) for k, pair in enumerate(worst[:DRAWN], 1)]
        for name, pair in shown:
            scene, paper = scenes[pair.paper["scene"]], pair.paper
            conditions = [strategy.with_measure(paper["measure"]) for strategy in STRATEGIES]
            # Made again from the seeds of the rows.
            operator = OperatorSpec(paper["person"], paper["person_seed"])
            paths = approach_paths(scene, operator, conditions, settings)
            bars += [replace(path, label=f"{robot}, {name}: {path.label}") for path in paths]
            title = f"{robot}, scene {scene.seed}, {scene.goal}: {name} case"
            file_name = f"way_{robot}_{name.replace(' ', '_')}"
            pictures.append(path_picture(file_name, scene, paths, title, f". {APPROACH_PATHS}"))
    if bars:
        caption = MODES_TO_THE_GRASP
        pictures.append(Picture("timelines", timelines(bars), caption))
    return pictures
