"""What a sweep comes to: outcomes of each setting over all cases, and which settings nothing beats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from optsc.errors import InvalidValue, UnknownName
from optsc.study.outcomes import CHOSEN, MEASURED, Row
from optsc.study.statistics import PairedDifference, averages, mean_of, paired_difference, pareto_front

MEANS = (*MEASURED, *CHOSEN, "jump_target_distance_m", "jump_target_chord")
"""Measures whose mean over all cases is told for each setting."""
TRADE_OFF: Mapping[str, float] = {"path_length_m": 1.0, "target_yoshikawa": -1.0}
"""What the front is about by default: 1 for less is better, -1 for more."""

KNEE = "knee"
"""Label of the setting between the ends of a front."""
DIRECTIONS: Mapping[str, float] = {"minimize": 1.0, "maximize": -1.0}
"""Signs of directions as a trade-off has them."""


def trade_off_of(objectives: Mapping[str, str]) -> dict[str, float]:
    """Return the trade-off of ``objectives``, each ``minimize`` or ``maximize`` by the name of a measure.

    Raises `UnknownName` for a measure that is none of `MEANS`, `InvalidValue` for another direction or no objective.
    """
    if not objectives:
        raise InvalidValue("objectives", "none", "one or more")
    for name, direction in objectives.items():
        if name not in MEANS:
            raise UnknownName("measure", name, MEANS)
        if direction not in DIRECTIONS:
            raise InvalidValue(f"direction of {name}", direction, "minimize or maximize")
    return {name: DIRECTIONS[direction] for name, direction in objectives.items()}


class SettingResult(NamedTuple):
    """One setting over all cases.

    Attributes:
        row: its name, its point, how many cases, the share that succeeded, and means of `MEANS`.
        best: whether it is on the Pareto front of the trade-off, among those that succeed as often as any.
    """

    row: Row
    best: bool


def setting_results(rows: Sequence[Row], trade_off: Mapping[str, float] = TRADE_OFF) -> list[SettingResult]:
    """Return every setting in ``rows`` over all its cases, in order of appearance.

    Means leave out what did not arrive, so settings are only compared for the front if none succeeds more often: or
    else one that gives up on hard scenes would look better.
    """
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["robot"], row["condition"], row["measure"]), []).append(row)
    means = [_means(place, group) for place, group in groups.items()]
    success = np.array([mean["success"] for mean in means])
    costs = np.array([[sign * mean[name] for name, sign in trade_off.items()] for mean in means])
    if len(costs):
        costs[success < success.max()] = np.nan
    return [SettingResult(mean, bool(best)) for mean, best in zip(means, _front(costs), strict=True)]


def _front(costs: np.ndarray) -> np.ndarray:
    return pareto_front(costs) if len(costs) else np.zeros(0, dtype=bool)


def _means(place: tuple[str, str, str], rows: Sequence[Row]) -> Row:
    robot, condition, measure = place
    point = {name: value for name, value in rows[0].items() if name.startswith("at_")}
    means: dict[str, Any] = {name: mean_of([row[name] for row in rows]) for name in MEANS}
    success = float(np.mean([bool(row["success"]) for row in rows]))
    return {
        "robot": robot,
        "condition": condition,
        "measure": measure,
        **point,
        "cases": len(rows),
        "success": success,
        **means,
    }


def shown_settings(
    settled: Sequence[SettingResult], robot: str | None = None, trade_off: Mapping[str, float] = TRADE_OFF
) -> dict[str, SettingResult]:
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
