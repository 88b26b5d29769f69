"""Grasp choice study, the paper's experiment: both strategies from the same hand-over, in the same scenes.

In every scene one operator moves the arm to a ready pose and hands over. From the same configuration and velocity the
robot goes once to the grasp that the paper's cascade chooses, and once to that of greatest manipulability, at the same
speed. What differs between the two motions is the choice of the grasp and nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import degrees
from typing import Any, NamedTuple

import numpy as np

from optsc.control.path_feasibility import SPEED_LIMIT_SHARE
from optsc.robot.manipulability import DEFINITIONS
from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER, Condition, OperatorSpec
from optsc.study.engine import Engine
from optsc.study.episode_setup import EpisodeSettings
from optsc.study.outcomes import MEASURED, Row
from optsc.study.scenes import Scene
from optsc.study.statistics import Interval, PairedDifference, averages, paired_difference, share_interval

STRATEGIES = (PAPER, MANIPULABILITY_ONLY)
CLAIMS: dict[str, tuple[str, float]] = {
    "shorter": ("path_length_m", -1.0),
    "turns less": ("rotation_rad", -1.0),
    "smoother (tool)": ("ldlj_tool", 1.0),
    "smoother (joints)": ("ldlj_joint", 1.0),
    "quicker": ("duration_s", -1.0),
}
"""The paper's claim in parts: the measure of each, and the sign of a difference in its favour."""
COMPARED = (*MEASURED, "target_yoshikawa", "target_travel_rad", "jump_target_distance_m", "jump_target_chord")
"""Measures whose paired differences are reported."""
MARGIN = 1e-6
"""Differences up to this are none: both chose the same grasp."""


def approach_conditions(measures: Sequence[str] | None = None) -> tuple[Condition, ...]:
    """Return both strategies under each definition of M, by default all of `DEFINITIONS`; raise `UnknownName`."""
    return tuple(strategy.with_measure(name) for name, strategy in product(measures or DEFINITIONS, STRATEGIES))


class StrategyPair(NamedTuple):
    """One case under both strategies."""

    paper: Row
    other: Row

    @property
    def complete(self) -> bool:
        """Whether both arrived at a grasp of the same object."""
        return bool(self.paper["arrived"] and self.other["arrived"] and self.paper["object"] == self.other["object"])

    @property
    def same_grasp(self) -> bool:
        """Whether both chose the same grasp, the jaws not turned by half a turn between them."""
        names = ("candidate", "half_turn", "hand_over")
        return all(self.paper[name] == self.other[name] for name in names)


def pairs_of(rows: Sequence[Row], robot: str, measure: str) -> list[StrategyPair]:
    """Return the cases of one arm and one definition of M, in the order of the rows."""
    sides: dict[tuple[str, str, int], dict[str, Row]] = {}
    for row in rows:
        if row["robot"] == robot and row["measure"] == measure:
            case = (row["scene"], row["person"], row["person_seed"])
            sides.setdefault(case, {})[row["condition"]] = row
    names = [strategy.name for strategy in STRATEGIES]
    return [StrategyPair(*(side[name] for name in names)) for side in sides.values() if set(names) <= set(side)]


class StrategyComparison(NamedTuple):
    """What came out for one arm and one definition of M.

    Attributes:
        robot, measure: which.
        cases: how many pairs there are, complete ones among them, those with the same grasp among these.
        scenes: how many scenes these are in: all pairs, the complete ones. Several people in a scene are no independent
            cases: what follows is over scenes, each with the mean of its pairs.
        differences: by measure, paper minus manipulability only, over the scenes of complete pairs.
        arrived: of each strategy, the share of all cases in which it arrived at a grasp, with Wilson's interval for as
            many trials as there are scenes.
    """

    robot: str
    measure: str
    cases: tuple[int, int, int]
    scenes: tuple[int, int]
    differences: dict[str, PairedDifference]
    arrived: dict[str, Interval]


def compare(rows: Sequence[Row], seed: int = 0) -> list[StrategyComparison]:
    """Return the comparison for each arm and definition of M in ``rows``; ``seed`` is of the bootstrap."""
    return [_compared(robot, measure, pairs_of(rows, robot, measure), seed) for robot, measure in _factors(rows)]


def _factors(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Return every arm with every definition of M, in order of appearance."""
    robots, measures = (dict.fromkeys(row[name] for row in rows) for name in ("robot", "measure"))
    return list(product(robots, measures))


def _compared(robot: str, measure: str, pairs: Sequence[StrategyPair], seed: int) -> StrategyComparison:
    complete = [pair for pair in pairs if pair.complete]
    differences = {}
    for name in COMPARED:
        paper, other = pair_means(complete, name)
        # The same resamples for every measure: intervals differ by the data alone.
        differences[name] = paired_difference(paper, other, np.random.default_rng(seed))
    arrived = {
        strategy.name: share_interval(sum(shares), len(shares))
        for strategy, shares in zip(STRATEGIES, pair_means(pairs, "success"), strict=True)
    }
    counts = (len(pairs), len(complete), sum(pair.same_grasp for pair in complete))
    scenes = (len(_scenes(pairs)), len(_scenes(complete)))
    return StrategyComparison(robot, measure, counts, scenes, differences, arrived)


def _scenes(pairs: Sequence[StrategyPair]) -> set[str]:
    return {pair.paper["scene"] for pair in pairs}


def pair_means(pairs: Sequence[StrategyPair], name: str) -> tuple[list[float], list[float]]:
    """Return the measure of that name under both strategies: one mean for each scene in which a pair has both."""
    return averages(
        [pair.paper["scene"] for pair in pairs],
        [pair.paper[name] for pair in pairs],
        [pair.other[name] for pair in pairs],
    )


_FACTS = (
    *("grasp", "half_turn", "arrived", "ended", "object", "jump_target_distance_m", "jump_target_chord"),
    *("target_yoshikawa", "target_manipulability", "path_length_m", "rotation_rad", "duration_s"),
    *("ldlj_tool", "ldlj_joint", "straightness", "target_travel_rad"),
)


class Failure(NamedTuple):
    """A case in which the paper's strategy did worse in some part of the claim.

    Attributes:
        pair: both rows.
        parts: which parts of the claim failed, and by how much: paper minus manipulability only.
        why: what the numbers say about the reason, in words; one of few sentences, so that they can be counted.
    """

    pair: StrategyPair
    parts: dict[str, float]
    why: str

    def row(self) -> Row:
        """Return the case as one flat row: enough to see it, and to run it again."""
        paper, other = self.pair
        names = ("robot", "measure", "scene", "scene_seed", "level", "goal", "person", "person_seed")
        sides: dict[str, Any] = {}
        for side, row in (("paper", paper), ("other", other)):
            sides.update({f"{side}_{name}": row[name] for name in _FACTS})
        failed = ", ".join(self.parts)
        return {**{name: paper[name] for name in names}, "failed": failed, "why": self.why, **sides}


def failures(rows: Sequence[Row]) -> list[Failure]:
    """Return every case in which some part of the claim fails, the longest detours first."""
    found = [
        Failure(pair, parts, _why(pair, parts))
        for robot, measure in _factors(rows)
        for pair in pairs_of(rows, robot, measure)
        if (parts := _worse(pair))
    ]
    return sorted(found, key=lambda failure: -failure.parts.get("shorter", 0.0))


def _worse(pair: StrategyPair) -> dict[str, float]:
    paper, other = pair
    if not pair.complete:
        return {"arrives": 0.0} if other["success"] and not paper["success"] else {}
    differences = {part: paper[name] - other[name] for part, (name, _) in CLAIMS.items()}
    return {part: d for part, d in differences.items() if d * CLAIMS[part][1] < -MARGIN}


def _why(pair: StrategyPair, parts: dict[str, float]) -> str:
    paper, other = pair
    if "arrives" in parts:
        return f"the paper's choice did not arrive: {paper['ended']}"
    if paper["hand_over"] != other["hand_over"]:
        return "one of the two was refused at first, so that they did not start from the same ready pose"
    if "shorter" in parts:
        return _why_longer(paper, other)
    if "turns less" in parts:
        if "quicker" in parts:
            return "the way is not longer, but the tool turns more, and turning set the pace"
        return "the way is not longer and takes no longer, but the tool turns more"
    if "quicker" in parts:
        # A path that is neither longer nor turns more takes no longer by its time law: the arm was behind it.
        if paper["velocity_share"] > SPEED_LIMIT_SHARE:
            return "neither longer nor turning more, but a joint came near its greatest speed, and the arm fell behind"
        return "neither longer nor turning more, but the arm took longer to settle where its paths end"
    return "not longer, but less smooth by a measure that weighs how motion starts and stops"


def _why_longer(paper: Row, other: Row) -> str:
    if paper["jump_target_distance_m"] <= other["jump_target_distance_m"]:
        return "the grasp is nearer, but the way to it over its pre-grasp is longer"
    if paper["jump_target_chord"] <= other["jump_target_chord"]:
        return "orientation came first: a nearer grasp was turned more, and was left out by the first stage"
    # The cascade prefers a grasp that is nearer in both and has the greater M, unless its path is not free.
    return "the grasp is further away and turned more: a better one by its rank was passed over for its way"


def explanation(failure: Failure, settings: EpisodeSettings, scene: Scene) -> str:
    """Return in words and numbers why the paper's cascade passed over the grasp of greatest M, from the scene itself.

    The episode is run up to the hand-over again, which takes about a second.
    """
    paper, other = failure.pair
    engine = Engine(scene, OperatorSpec(paper["person"], paper["person_seed"]), settings)
    choices = engine.choices([strategy.with_measure(paper["measure"]) for strategy in STRATEGIES])
    if choices[0] is None:
        return "the paper's strategy chose nothing"
    if choices[1] is None:
        return "the grasp of greatest M was not chosen at all"
    ranking, rival = choices[0].ranking, choices[1].target
    here, there = choices[0].target, rival
    lines = [
        f"hand-over at {engine.hand_over(choices[0].hand_over).tick / settings.rate:.2f} s; "  # type: ignore[union-attr]
        f"paper's grasp {here.grasp_index} of the {here.object_name}: "
        f"{1e3 * paper['jump_target_distance_m']:.0f} mm and {_angle(paper):.0f}° away, M {here.manipulability:.4g}; "
        f"greatest M: grasp {there.grasp_index}, {1e3 * other['jump_target_distance_m']:.0f} mm and "
        f"{_angle(other):.0f}° away, M {there.manipulability:.4g}",
        ranking.explain(rival.candidate),
    ]
    return "\n".join(lines)


def _angle(row: Row) -> float:
    """Return the angle between tool and target at the hand-over [deg] from the chord 2 sin(angle / 4)."""
    return degrees(4.0 * np.arcsin(min(0.5 * row["jump_target_chord"], 1.0)))
