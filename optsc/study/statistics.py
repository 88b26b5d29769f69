"""Statistics of paired comparisons: intervals, effect sizes, fronts, stability of rankings."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array

RESAMPLES = 5000
CONFIDENCE = 0.95


class Interval(NamedTuple):
    """An estimate and the confidence interval about it."""

    value: float
    low: float
    high: float


class PairedDifference(NamedTuple):
    """What separates two conditions on the same cases: a minus b.

    Attributes:
        pairs: number of cases that both have a number for.
        mean_a, mean_b: means over those.
        mean: mean of the differences, with its bootstrap interval.
        median: median of the differences, with its bootstrap interval.
        relative: mean difference as a share of the mean of b [-].
        d_z: Cohen's effect size for pairs, mean over standard deviation of the differences [-]; J. Cohen 1988. 0.2 is
            called small, 0.5 medium, 0.8 large.
        less, more: shares of the cases in which a is below and above b [-]; the rest are ties.
        rank_biserial: matched-pairs rank-biserial correlation [-]: the rank sum of positive differences minus that of
            negative ones over all ranks (D. S. Kerby 2014); -1 where a is always less. Zero differences do not count.
    """

    pairs: int
    mean_a: float
    mean_b: float
    mean: Interval
    median: Interval
    relative: float
    d_z: float
    less: float
    more: float
    rank_biserial: float


NO_PAIRS = PairedDifference(0, nan, nan, *(Interval(nan, nan, nan),) * 2, nan, nan, nan, nan, nan)


def bootstrap(values: ArrayLike, rng: np.random.Generator, *, median: bool = False) -> Interval:
    """Return the mean or median of ``values`` (N,) with its percentile bootstrap interval.

    The values have to be independent of each other: one number for each scene, not one for each tick. NaN without
    values. B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13.
    """
    x = np.asarray(values, dtype=float)
    if x.ndim != 1 or not np.all(np.isfinite(x)):
        raise InvalidValue("values", x.shape, "finite, shape (N,)")
    if not len(x):
        return Interval(nan, nan, nan)
    statistic = np.median if median else np.mean
    estimates = np.concatenate(
        [statistic(x[rng.integers(len(x), size=(count, len(x)))], axis=1) for count in _blocks(len(x))]
    )
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(estimates, [tail, 100.0 - tail])
    return Interval(float(statistic(x)), float(low), float(high))


def _blocks(size: int) -> list[int]:
    """Return how many resamples to draw at a time, so that memory stays small."""
    most = max(1, 2_000_000 // size)
    full, rest = divmod(RESAMPLES, most)
    return [most] * full + ([rest] if rest else [])


def paired_difference(a: ArrayLike, b: ArrayLike, rng: np.random.Generator) -> PairedDifference:
    """Return what separates ``a`` (N,) from ``b`` (N,), case by case; cases where either is NaN are left out.

    Raises `InvalidValue` when the two have not one number for each case.
    """
    x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if x.shape != y.shape or x.ndim != 1:
        raise InvalidValue("shapes of the paired values", (x.shape, y.shape), "equal, (N,)")
    both = np.isfinite(x) & np.isfinite(y)
    x, y = x[both], y[both]
    if not len(x):
        return NO_PAIRS
    difference = x - y
    spread = float(np.std(difference, ddof=1)) if len(x) > 1 else nan
    mean = bootstrap(difference, rng)
    return PairedDifference(
        pairs=len(x),
        mean_a=float(np.mean(x)),
        mean_b=float(np.mean(y)),
        mean=mean,
        median=bootstrap(difference, rng, median=True),
        relative=mean.value / abs(float(np.mean(y))) if np.mean(y) != 0.0 else nan,
        d_z=mean.value / spread if spread > 0.0 else (0.0 if mean.value == 0.0 else nan),
        less=float(np.mean(difference < 0.0)),
        more=float(np.mean(difference > 0.0)),
        rank_biserial=rank_biserial(difference),
    )


def averages(groups: Sequence[Hashable], a: Sequence[float], b: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return the means of ``a`` (N,) and ``b`` (N,) within each of the ``groups`` (N,), in order of appearance.

    For what is repeated within a case, such as several people in one scene: repetitions are not independent of each
    other, and a bootstrap over them gives intervals that are too narrow (S. H. Hurlbert 1984). Where either is NaN,
    both are left out, and so is a group without any left. Raises `InvalidValue` for different numbers of them.
    """
    if not len(groups) == len(a) == len(b):
        raise InvalidValue("groups and paired values", (len(groups), len(a), len(b)), "as many of each")
    found: dict[Hashable, list[tuple[float, float]]] = {}
    for group, x, y in zip(groups, a, b, strict=True):
        if np.isfinite(x) and np.isfinite(y):
            found.setdefault(group, []).append((float(x), float(y)))
    means = [np.mean(pairs, axis=0).tolist() for pairs in found.values()]
    return [x for x, _ in means], [y for _, y in means]


def rank_biserial(differences: ArrayLike) -> float:
    """Return the matched-pairs rank-biserial correlation of ``differences`` (N,); 0 where all are zero."""
    d = np.asarray(differences, dtype=float)
    d = d[d != 0.0]
    if not len(d):
        return 0.0
    from scipy.stats import rankdata

    ranks = rankdata(np.abs(d))
    return float(np.sum(ranks * np.sign(d)) / np.sum(ranks))


def share_interval(successes: float, count: int) -> Interval:
    """Return a share and its interval after Wilson (1927), which also holds near 0 and 1; NaN of nothing.

    ``successes`` may be a sum of shares, where each of ``count`` cases was repeated: the interval is that of single
    trials then, which is no less than the true one.
    """
    if not 0 <= successes <= count:
        raise InvalidValue("successes", successes, f"0 to {count}")
    if count == 0:
        return Interval(nan, nan, nan)
    z, p = 1.959963984540054, successes / count
    middle = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * np.sqrt(p * (1 - p) / count + z * z / (4 * count * count))
    return Interval(p, max(0.0, float(middle - half)), min(1.0, float(middle + half)))


def pareto_front(costs: ArrayLike) -> np.ndarray:
    """Return which rows of ``costs`` (N, d) no other row beats: none is as low in all and lower in one.

    Rows with NaN are never on the front. Equal rows are on it together.
    """
    x = np.asarray(costs, dtype=float)
    if x.ndim != 2:
        raise InvalidValue("shape of the costs", x.shape, "(N, d)")
    front = np.all(np.isfinite(x), axis=1)
    for i in np.flatnonzero(front):
        rivals = x[front]
        beaten = np.all(rivals <= x[i], axis=1) & np.any(rivals < x[i], axis=1)
        front[i] = not np.any(beaten)
    return front


def kendall_tau(one: Sequence[int], other: Sequence[int]) -> float:
    """Return Kendall's tau-b [-] between two rankings of the same things, each a list of names best first.

    Things that only one of them has are left out. NaN for fewer than two in common.
    """
    place = {name: rank for rank, name in enumerate(other)}
    common = [place[name] for name in one if name in place]
    if len(common) < 2:
        return nan
    from scipy.stats import kendalltau

    return float(kendalltau(np.arange(len(common)), common).statistic)


def mean_of(values: ArrayLike) -> float:
    """Return the mean of what is finite in ``values``; NaN where nothing is."""
    x: Array = np.asarray(values, dtype=float)
    x = x[np.isfinite(x)]
    return float(np.mean(x)) if len(x) else nan
