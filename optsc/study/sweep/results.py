"""Results of a sweep: means of each setting over all cases, the Pareto front, and paired differences of settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from optsc.errors import InvalidValue, UnknownName
from optsc.study.outcomes import CHOSEN, MEASURED, Row
from optsc.study.statistics import PairedDifference, averages, mean_of, paired_difference, pareto_front

if TYPE_CHECKING:
    from pandas import DataFrame

MEANS = (*MEASURED, *CHOSEN, "jump_target_distance_m", "jump_target_chord")
"""Measures whose mean over all cases is reported for each setting."""
TRADE_OFF: Mapping[str, float] = {"path_length_m": 1.0, "target_yoshikawa": -1.0}
"""What the front is about by default: 1 for less is better, -1 for more."""
KNEE = "knee"
"""Label of the setting between the ends of a front."""
DIRECTIONS: Mapping[str, float] = {"minimize": 1.0, "maximize": -1.0}
"""Signs of directions as a trade-off has them."""
SETTING = ["robot", "condition", "measure"]
"""Columns that tell settings apart."""
CASE = ["scene", "person", "person_seed"]
"""Columns that tell the cases of an arm apart."""


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


def setting_results(rows: Sequence[Row], trade_off: Mapping[str, float] = TRADE_OFF) -> DataFrame:
    """Return one line for each setting in ``rows``, in order of appearance.

    Columns are those of `SETTING`, the setting's point (``at_...``), the number of ``cases``, the share of ``success``
    among them, the mean of each of `MEANS` over the cases that have it, and whether the setting is ``best``: on the
    Pareto front of the trade-off. Means leave out what did not arrive, so only settings that succeed as often as any
    are compared for the front: otherwise a setting that fails in hard scenes would look better.
    """
    from pandas import DataFrame

    if not rows:
        return DataFrame(columns=[*SETTING, "cases", "success", *MEANS, "best"])
    # As objects, whole numbers of a point stay whole beside others that are not.
    table = DataFrame(rows, dtype=object)
    groups = table.groupby(SETTING, sort=False)
    results = groups[[name for name in table if name.startswith("at_")]].first()
    results["cases"] = groups.size()
    results["success"] = groups["success"].agg(mean_of).astype(float)
    means = groups[list(MEANS)].agg(mean_of).astype(float)
    results = results.join(means)
    costs = results[list(trade_off)].to_numpy() * list(trade_off.values())
    results["best"] = best_of(costs, results["success"].to_numpy())
    return results.reset_index()


def best_of(costs: np.ndarray, success: np.ndarray) -> np.ndarray:
    """Return which rows of ``costs`` (N, d) are on the Pareto front of those with the greatest ``success`` (N,)."""
    return pareto_front(np.where(success[:, None] < success.max(), np.nan, costs))


def shown_settings(
    results: DataFrame, robot: str | None = None, trade_off: Mapping[str, float] = TRADE_OFF
) -> dict[str, str]:
    """Return the names of both ends of the front and its knee, by what they are: ``least path_length_m``, ``knee``, ...

    Ends are those of the first two measures of ``trade_off``. The knee is the setting farthest below the line
    between them, both measures counted in shares of the front's extent (I. Das 1999). Fewer where the front has fewer
    settings that differ; none without a front. ``robot`` is by default the first that there is.
    """
    measures = list(trade_off)[:2]
    if robot is None:
        robot = next(iter(results["robot"]), None)
    front = results[results["best"].astype(bool) & (results["robot"] == robot)]
    if front.empty:
        return {}
    names = front["condition"].tolist()
    costs = front[measures].to_numpy(float) * [trade_off[name] for name in measures]
    first, last = (int(np.lexsort((costs[:, 1 - k], costs[:, k]))[0]) for k in (0, 1))
    labels = [f"{'least' if trade_off[name] > 0.0 else 'most'} {name}" for name in measures]
    if np.array_equal(costs[first], costs[last]):
        return {f"{labels[0]}, {labels[1]}": names[first]}
    low, high = costs.min(axis=0), costs.max(axis=0)
    # The line goes from (0, 1) to (1, 0); what lies below it is better in both than a mixture of the ends.
    distance = 1.0 - ((costs - low) / (high - low)).sum(axis=1)
    distance[np.all(costs == costs[first], axis=1) | np.all(costs == costs[last], axis=1)] = -np.inf
    knee = int(np.argmax(distance))
    between = {KNEE: names[knee]} if np.isfinite(distance[knee]) else {}
    return {labels[0]: names[first], **between, labels[1]: names[last]}


def difference_from(
    rows: DataFrame, robot: str, condition: str, reference: str, measure: str, seed: int = 0
) -> PairedDifference:
    """Return ``condition`` minus ``reference`` in a ``measure``, over the scenes in which both arrived.

    The same person has to arrive at the same object. Several people in a scene count as one, with the mean of their
    numbers. ``rows`` are those of a study; ``seed`` is of the bootstrap.
    """
    arrived = rows[(rows["robot"] == robot) & rows["arrived"].astype(bool)]
    one, other = (arrived[arrived["condition"] == name] for name in (condition, reference))
    pairs = one.merge(other, on=[*CASE, "object"], suffixes=("", "_reference"))
    a, b = averages(pairs["scene"].tolist(), pairs[measure].tolist(), pairs[f"{measure}_reference"].tolist())
    return paired_difference(a, b, np.random.default_rng(seed))
