"""Experimental designs: which points of a space of settings a sweep tries."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from optsc.checks import AtLeast, OneOf, require
from optsc.errors import InvalidValue
from optsc.study.sweep.space import Dimension, Point, check_distinct, rounded

DESIGNS = ("grid", "random", "sobol", "simplex", "one-at-a-time")


def grid(dimensions: Sequence[Dimension], levels: int) -> list[Point]:
    """Return every combination of ``levels`` values of each dimension."""
    lines = [dimension.levels(levels) for dimension in dimensions]
    return [_named(dimensions, values) for values in product(*lines)]


def random(dimensions: Sequence[Dimension], count: int, seed: int) -> list[Point]:
    """Return ``count`` points, each value drawn by itself."""
    shares = np.random.default_rng(seed).uniform(size=(count, len(dimensions)))
    return [_named(dimensions, [d.at(float(s)) for d, s in zip(dimensions, row, strict=True)]) for row in shares]


def sobol(dimensions: Sequence[Dimension], count: int, seed: int) -> list[Point]:
    """Return ``count`` points of a scrambled Sobol sequence: even in every few dimensions at once (A. B. Owen 1998)."""
    from scipy.stats import qmc

    sampler = qmc.Sobol(len(dimensions), scramble=True, rng=np.random.default_rng(seed))
    # Balanced at powers of two; the rest of the power is drawn and left.
    shares = sampler.random_base2(max(0, (count - 1).bit_length()))[:count]
    return [_named(dimensions, [d.at(float(s)) for d, s in zip(dimensions, row, strict=True)]) for row in shares]


def simplex(dimensions: Sequence[Dimension], steps: int) -> list[Point]:
    """Return the points of a simplex lattice of weights, with ``steps`` values of each other dimension.

    The lattice are the values k / ``steps`` that add up to one (H. Scheffé 1958): only ratios of weights change a
    weighted sum, so that it has all of them once. Dimensions that are no weights are crossed with it as a grid. Raises
    `InvalidValue` for fewer than two weights, and for a weight with another range than 0:1.
    """
    weights = [d for d in dimensions if d.name.startswith("weight.")]
    others = [d for d in dimensions if d not in weights]
    if len(weights) < 2 or steps < 1:
        valid = "2 or more weight.COST, 1 or more"
        raise InvalidValue("weights and steps of a simplex", (len(weights), steps), valid)
    for d in weights:
        if d.values or d.kind != "linear" or (d.low, d.high) != (0.0, 1.0):
            raise InvalidValue(
                f"range of {d.name} in a simplex", d.values or (d.low, d.high, d.kind), "0:1, which it fills"
            )

    def compositions(rest: int, parts: int) -> list[tuple[int, ...]]:
        if parts == 1:
            return [(rest,)]
        return [(k, *tail) for k in range(rest + 1) for tail in compositions(rest - k, parts - 1)]

    lattice = [_named(weights, [rounded(k / steps) for k in row]) for row in compositions(steps, len(weights))]
    order = [d.name for d in dimensions]
    mixed = [{**other, **point} for other in grid(others, steps) for point in lattice]
    return [{name: point[name] for name in order} for point in mixed]


def one_at_a_time(dimensions: Sequence[Dimension], levels: int, base: Point) -> list[Point]:
    """Return ``base``, then for each dimension ``base`` with that one value changed."""
    points = [dict(base)]
    for dimension in dimensions:
        if dimension.name not in base:
            raise InvalidValue("base point", sorted(base), f"a value of {dimension.name}")
        points += [{**base, dimension.name: v} for v in dimension.levels(levels) if v != base[dimension.name]]
    return points


def design(
    name: str,
    dimensions: Sequence[Dimension],
    *,
    count: int,
    levels: int,
    seed: int,
    base: Point | None = None,
) -> list[Point]:
    """Return the points of the design of that name: ``count`` for random and sobol, ``levels`` for the others.

    Raises `UnknownName`, and `InvalidValue` without dimensions or points, or with a dimension that comes twice.
    """
    require("design", name, OneOf(DESIGNS, "design"))
    check_distinct(dimensions)
    for field, number in (("count", count), ("levels", levels)):
        require(field, number, AtLeast(1))
    match name:
        case "grid":
            return grid(dimensions, levels)
        case "random":
            return random(dimensions, count, seed)
        case "sobol":
            return sobol(dimensions, count, seed)
        case "simplex":
            return simplex(dimensions, levels)
        case _:
            return one_at_a_time(dimensions, levels, base or {d.name: d.at(0.5) for d in dimensions})


def _named(dimensions: Sequence[Dimension], values: Sequence[Any]) -> Point:
    return {dimension.name: value for dimension, value in zip(dimensions, values, strict=True)}
