"""What a sweep comes to: outcomes of each setting over all cases, and which settings nothing beats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from optsc.errors import InvalidValue, UnknownName
from optsc.study.outcomes import CHOSEN, MEASURED, Row
from optsc.study.statistics import mean_of, pareto_front

MEANS = (*MEASURED, *CHOSEN, "jump_target_distance_m", "jump_target_chord")
"""Measures whose mean over all cases is told for each setting."""
TRADE_OFF: Mapping[str, float] = {"path_length_m": 1.0, "target_yoshikawa": -1.0}
"""What the front is about by default: 1 for less is better, -1 for more."""

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


class Settled(NamedTuple):
    """One setting over all cases.

    Attributes:
        row: its name, its point, how many cases, the share that succeeded, and means of `MEANS`.
        best: whether it is on the Pareto front of the trade-off, among those that succeed as often as any.
    """

    row: Row
    best: bool


def settle(rows: Sequence[Row], trade_off: Mapping[str, float] = TRADE_OFF) -> list[Settled]:
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
    return [Settled(mean, bool(best)) for mean, best in zip(means, _front(costs), strict=True)]


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
