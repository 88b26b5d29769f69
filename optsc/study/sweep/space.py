"""What a sweep varies: named dimensions, the points of a design among them, and the condition that a point stands for.

Names of dimensions, and what they set:

* ``weight.COST``: weight of a cost in a weighted sum, in units of one over the cost's typical spread (`SCALES`), so
  that weights of one make the costs count alike. Costs are those of `COSTS`.
* ``keep.orientation``, ``keep.position``: how many grasps the stages of the paper's cascade keep.
* ``keep.pose``: how many a first stage by weighted pose distance keeps, in place of those two.
* ``dof.x``, ``dof.y``, ``dof.z``, ``dof.rx``, ``dof.ry``, ``dof.rz``: weights of the pose distance in the gripper's
  frame; ``dof.length``: metres that a radian counts for in it.
* ``measure``: name of the definition of M.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import exp, log
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from optsc import selection
from optsc.errors import InvalidValue, UnknownName
from optsc.selection import Cascade, GraspCost, ManipulabilityLoss, PoseDistance, Rule, Stage, WeightedSum
from optsc.study.conditions import DEFAULT_MEASURE, Condition

Point: TypeAlias = dict[str, Any]

SCALES: Mapping[str, float] = MappingProxyType(
    {
        "orientation": 0.5,
        "position": 0.1,
        "manipulability": 0.05,
        "pose": 0.15,
        "joint-travel": 1.0,
        "quality": 0.3,
    }
)
"""Typical spread of each cost over the grasps of an object, in its unit; ours, one for costs not named."""
DOFS = ("x", "y", "z", "rx", "ry", "rz")
DIGITS = 9
"""Significant digits of a point's numbers, so that keys do not hang on the last one."""


def _costs() -> dict[str, type[GraspCost]]:
    found = {}
    for value in vars(selection).values():
        if inspect.isclass(value) and issubclass(value, GraspCost) and not inspect.isabstract(value):
            needed = [p for p in inspect.signature(value).parameters.values() if p.default is p.empty]
            if not needed:
                found[value.name.replace(" ", "-")] = value
    return found


COSTS: Mapping[str, type[GraspCost]] = MappingProxyType(_costs())
"""Costs by name that a sweep can weigh: all of `optsc.selection` that need no arguments."""


@dataclass(frozen=True)
class Dimension:
    """One thing to vary: a range of numbers, or a list of values.

    Attributes:
        name: see the module.
        low, high: ends of the range, both included; without meaning where there are `values`.
        kind: ``linear``, ``log`` or ``integer`` range.
        values: what to choose from instead.
    """

    name: str
    low: float = 0.0
    high: float = 1.0
    kind: str = "linear"
    values: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        _checked_name(self.name)
        if self.kind not in ("linear", "log", "integer"):
            raise UnknownName("kind of range", self.kind, ("linear", "log", "integer"))
        if not self.values:
            if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low <= self.high):
                raise InvalidValue(f"range of {self.name}", (self.low, self.high), "finite, lower end first")
            if self.kind == "log" and self.low <= 0.0:
                raise InvalidValue(f"range of {self.name}", (self.low, self.high), "above 0 for a log range")

    @classmethod
    def parse(cls, text: str) -> Dimension:
        """Return the dimension that ``name=low:high``, ``name=low:high:log`` or ``name=a,b,c`` says."""
        name, _, rest = text.partition("=")
        if not rest:
            raise InvalidValue("dimension", text, "name=low:high, name=low:high:log or :integer, name=a,b,c")
        if ":" not in rest:
            return cls(name, values=tuple(_value(part) for part in rest.split(",")))
        low, high, *kind = rest.split(":")
        try:
            return cls(name, float(low), float(high), kind[0] if kind else "linear")
        except ValueError as error:
            raise InvalidValue(f"range of {name}", rest, f"numbers ({error})") from None

    def at(self, share: float) -> Any:
        """Return the value at ``share`` in [0, 1] of the way through the range or the list."""
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        if self.kind == "log":
            return _rounded(exp(log(self.low) + share * (log(self.high) - log(self.low))))
        if self.kind == "integer":
            return int(min(self.low + np.floor(share * (self.high - self.low + 1)), self.high))
        return _rounded(self.low + share * (self.high - self.low))

    def levels(self, count: int) -> list[Any]:
        """Return ``count`` values evenly through the range, both ends included; all of a list's."""
        if self.values:
            return list(self.values)
        if self.kind == "integer":
            return sorted({round(v) for v in np.linspace(self.low, self.high, count)})
        return list(dict.fromkeys(self.at(float(share)) for share in np.linspace(0.0, 1.0, count)))


def _value(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _checked_name(name: str) -> None:
    valid = [f"weight.{cost}" for cost in COSTS]
    valid += ["keep.orientation", "keep.position", "keep.pose", "dof.length", "measure"]
    valid += [f"dof.{dof}" for dof in DOFS]
    if name not in valid:
        raise UnknownName("dimension", name, valid)


def grid(dimensions: Sequence[Dimension], levels: int) -> list[Point]:
    """Return every combination of ``levels`` values of each dimension."""
    lines = [dimension.levels(levels) for dimension in dimensions]
    return [_named(dimensions, values) for values in product(*lines)]


def random(dimensions: Sequence[Dimension], count: int, seed: int) -> list[Point]:
    """Return ``count`` points, each value drawn by itself."""
    shares = np.random.default_rng(seed).uniform(size=(count, len(dimensions)))
    return [
        _named(dimensions, [d.at(float(s)) for d, s in zip(dimensions, row, strict=True)]) for row in shares
    ]


def sobol(dimensions: Sequence[Dimension], count: int, seed: int) -> list[Point]:
    """Return ``count`` points of a scrambled Sobol sequence: even in every few dimensions at once (A. B. Owen 1998)."""
    from scipy.stats import qmc

    sampler = qmc.Sobol(len(dimensions), scramble=True, rng=np.random.default_rng(seed))
    # Balanced at powers of two; the rest of the power is drawn and left.
    shares = sampler.random_base2(max(0, (count - 1).bit_length()))[:count]
    return [
        _named(dimensions, [d.at(float(s)) for d, s in zip(dimensions, row, strict=True)]) for row in shares
    ]


def simplex(dimensions: Sequence[Dimension], steps: int) -> list[Point]:
    """Return the points of a simplex lattice: values k / ``steps`` that add up to one (H. Scheffé 1958).

    For weights: only their ratios change a weighted sum, so that a simplex has all of them once. Ranges are ignored.
    """
    count = len(dimensions)
    if count < 2 or steps < 1:
        raise InvalidValue("dimensions and steps of a simplex", (count, steps), "2 or more, 1 or more")

    def compositions(rest: int, parts: int) -> list[tuple[int, ...]]:
        if parts == 1:
            return [(rest,)]
        return [(k, *tail) for k in range(rest + 1) for tail in compositions(rest - k, parts - 1)]

    return [_named(dimensions, [_rounded(k / steps) for k in row]) for row in compositions(steps, count)]


def one_at_a_time(dimensions: Sequence[Dimension], levels: int, base: Point) -> list[Point]:
    """Return ``base``, then for each dimension ``base`` with that one value changed."""
    points = [dict(base)]
    for dimension in dimensions:
        if dimension.name not in base:
            raise InvalidValue("base point", sorted(base), f"a value of {dimension.name}")
        points += [{**base, dimension.name: v} for v in dimension.levels(levels) if v != base[dimension.name]]
    return points


DESIGNS = ("grid", "random", "sobol", "simplex", "one-at-a-time")


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

    Raises `UnknownName`, and `InvalidValue` without dimensions or points.
    """
    if name not in DESIGNS:
        raise UnknownName("design", name, DESIGNS)
    if not dimensions or count < 1 or levels < 1:
        raise InvalidValue("dimensions, count, levels", (len(dimensions), count, levels), "1 or more each")
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


def rule_of(point: Point) -> Rule:
    """Return the rule that a point stands for: a weighted sum if it has weights, else a cascade.

    Raises `UnknownName` for a name that means nothing, and `InvalidValue` for weights that are all zero.
    """
    for name in point:
        _checked_name(name)
    weights = {name.removeprefix("weight."): v for name, v in point.items() if name.startswith("weight.")}
    if weights:
        terms = [
            (_cost(cost, point), float(w) / SCALES.get(cost, 1.0)) for cost, w in sorted(weights.items())
        ]
        return WeightedSum(tuple((cost, _rounded(weight)) for cost, weight in terms))
    if "keep.pose" in point:
        return Cascade((Stage(_cost("pose", point), int(point["keep.pose"])), Stage(ManipulabilityLoss())))
    return Cascade.paper(int(point.get("keep.orientation", 30)), int(point.get("keep.position", 6)))


def _cost(name: str, point: Point) -> GraspCost:
    if name != "pose":
        return COSTS[name]()
    dof = {d: float(point.get(f"dof.{d}", 1.0)) for d in DOFS}
    length = float(point.get("dof.length", 0.15))
    return PoseDistance((dof["x"], dof["y"], dof["z"]), (dof["rx"], dof["ry"], dof["rz"]), length)


def conditions(points: Sequence[Point]) -> list[Condition]:
    """Return the condition of each point, named by its number, but of those whose weights are all zero."""
    found = []
    for number, point in enumerate(points):
        weights = [v for name, v in point.items() if name.startswith("weight.")]
        if weights and not any(weights):
            continue
        name = f"{number:05d}"
        found.append(Condition(name, rule_of(point), str(point.get("measure", DEFAULT_MEASURE)), point))
    return found
