"""The report of the paper's experiment: differences with intervals, where the claim fails and why, and how it looks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from optsc.study.approach import (
    CLAIMS,
    STRATEGIES,
    Failure,
    StrategyComparison,
    StrategyPair,
    explanation,
    pair_means,
    pairs_of,
)
from optsc.study.conditions import Condition, OperatorSpec
from optsc.study.engine import Engine
from optsc.study.episode_setup import EpisodeSettings
from optsc.study.outcomes import Row
from optsc.study.scenes import Scene
from optsc.viewers.report import Picture, Report, Table
from optsc.viewers.report_motion import ToolPath, timelines, trajectories
from optsc.viewers.report_statistics import Estimate, Scatter, forest, paired_scatter

EXPLAINED = 12
"""Failing cases that are told in words, the longest detours first."""
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
    report.add("What it looks like", *_pictures(rows, comparisons, failed, scenes, settings))
    return report


def _counts(comparisons: Sequence[StrategyComparison]) -> list[Table]:
    counted = ["cases", "both arrived", "same grasp", "scenes", "scenes compared"]
    head = ["arm", "M", *counted, *(f"success: {s.name}" for s in STRATEGIES)]
    lines = []
    for c in comparisons:
        shares = [_share(c.arrived[strategy.name]) for strategy in STRATEGIES]
        lines.append([c.robot, c.measure, *c.cases, *c.scenes, *shares])
    caption = (
        "A case is a person in a scene. Success is arriving at a grasp of the wanted object, a mean over scenes with "
        "Wilson's interval for as many trials as there are scenes"
    )
    return [Table(head, lines, caption)]


def _share(interval: tuple[float, float, float]) -> str:
    value, low, high = (100.0 * x for x in interval)
    return f"{value:.1f} % ({low:.1f} to {high:.1f})"


def _forest(comparisons: Sequence[StrategyComparison]) -> Picture:
    robots = list(dict.fromkeys(c.robot for c in comparisons))
    measures = list(dict.fromkeys(c.measure for c in comparisons))
    by_place = {(c.robot, c.measure): c for c in comparisons}
    panels = {
        UNITS.get(part, part): {
            robot: [Estimate(*by_place[robot, m].differences[name].mean) for m in measures]
            for robot in robots
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
    head = [
        "M",
        "scenes",
        "paper",
        "other",
        "difference",
        "95 %",
        "relative",
        "d_z",
        "rank-biserial",
        "paper better",
    ]
    tables = []
    for robot in dict.fromkeys(c.robot for c in comparisons):
        for part, (name, sign) in CLAIMS.items():
            lines = []
            for c in (c for c in comparisons if c.robot == robot):
                d = c.differences[name]
                better = d.less if sign < 0.0 else d.more
                interval = f"{d.mean.low:.3g} to {d.mean.high:.3g}"
                numbers = [d.pairs, d.mean_a, d.mean_b, d.mean.value, interval, f"{100 * d.relative:.1f} %"]
                lines.append([c.measure, *numbers, d.d_z, d.rank_biserial, f"{100 * better:.0f} %"])
            tables.append(Table(head, lines, f"{robot}: {part} ({name})"))
    return tables


def _scatter(rows: Sequence[Row], comparisons: Sequence[StrategyComparison]) -> Picture:
    measure = comparisons[0].measure
    panels = []
    for robot in dict.fromkeys(c.robot for c in comparisons):
        pairs = [pair for pair in pairs_of(rows, robot, measure) if pair.complete]
        y, x = (np.array(means) for means in pair_means(pairs, "path_length_m"))
        panels.append(Scatter(f"{robot}, M: {measure}", x, y, y > x + 1e-6))
    figure = paired_scatter(panels, "manipulability only: path [m]", "paper: path [m]", "paper longer")
    return Picture(
        "paths",
        figure,
        "One point per scene, a mean where several people were in it; below the diagonal the paper's way is shorter.",
    )


def _failure_tables(failed: Sequence[Failure]) -> list[Table | str]:
    if not failed:
        return ["In no case was any part of the claim wrong."]
    reasons: Counter[tuple[str, str]] = Counter((f.pair.paper["robot"], f.why) for f in failed)
    lines = [[robot, why, count] for (robot, why), count in reasons.most_common()]
    listed = []
    for failure in failed[:40]:
        paper, other = failure.pair
        numbers = [_millimetres(paper), _millimetres(other), paper["path_length_m"], other["path_length_m"]]
        times = [paper["duration_s"], other["duration_s"]]
        case = [paper["robot"], paper["measure"], paper["scene_seed"], paper["goal"]]
        listed.append([*case, *numbers, *times, ", ".join(failure.parts)])
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
    return [
        Table(
            ["arm", "why", "cases"],
            lines,
            "Why some part of the claim fails, counted over all definitions of M",
        ),
        Table(
            [*head, "time, paper [s]", "other [s]", "parts that fail"],
            listed,
            f"The {len(listed)} longest detours of {len(failed)}; all of them with all numbers are in failures.csv",
        ),
    ]


def _millimetres(row: Row) -> float:
    return 1e3 * row["jump_target_distance_m"]


def _explained(
    failed: Sequence[Failure], scenes: Mapping[str, Scene], settings: EpisodeSettings
) -> list[Table]:
    lines = []
    for failure in _distinct(failed)[:EXPLAINED]:
        paper = failure.pair.paper
        words = explanation(failure, settings, scenes[paper["scene"]])
        lines.append([f"{paper['robot']} {paper['measure']} {paper['scene_seed']}", failure.why, words])
    return (
        [Table(["case", "why", "the choice in its own words"], lines, "Failing cases, looked at")]
        if lines
        else []
    )


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
            scene = scenes[pair.paper["scene"]]
            paths = paths_of(scene, pair, settings)
            bars += [_renamed(path, f"{robot}, {name}: {path.label}") for path in paths]
            world = scene.world()
            objects = {n: (model.parts, world.X_WO[n]) for n, model in world.objects.items()}
            title = f"{robot}, scene {scene.seed}, {scene.goal}: {name} case"
            figure = trajectories(objects, paths, title, scene.goal)
            words = "The way of the tool, coloured by mode; a circle marks the hand-over, a fork the chosen grasp."
            pictures.append(Picture(f"way_{robot}_{name.replace(' ', '_')}", figure, f"{title}. {words}"))
    if bars:
        caption = "Who led when, from the first sample to the grasp."
        pictures.append(Picture("timelines", timelines(bars), caption))
    return pictures


def _renamed(path: ToolPath, label: str) -> ToolPath:
    return ToolPath(label, path.p, path.modes, path.rate, path.X_WG)


def paths_of(scene: Scene, pair: StrategyPair, settings: EpisodeSettings) -> list[ToolPath]:
    """Return the tool's way under both strategies, made again from the rows' own seeds."""
    person = OperatorSpec(pair.paper["person"], pair.paper["person_seed"])
    return ways(scene, person, [s.with_measure(pair.paper["measure"]) for s in STRATEGIES], settings)


def ways(
    scene: Scene, person: OperatorSpec, conditions: Sequence[Condition], settings: EpisodeSettings
) -> list[ToolPath]:
    """Return the tool's way to the grasp under each condition, named as it is; none for one that chooses nothing."""
    engine, found = Engine(scene, person, settings), []
    for condition, choice in zip(conditions, engine.choices(conditions), strict=True):
        if choice is not None:
            motion = engine.motion(condition, choice).track.motion()
            p, X_WG = motion.X_WT.translation, choice.target.X_WG
            found.append(ToolPath(condition.name, p, motion.modes, motion.rate, X_WG))
    return found
