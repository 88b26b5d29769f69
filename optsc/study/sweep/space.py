"""Search space of a sweep: named dimensions, and the condition that a point among them stands for.

Names of dimensions, and what they set:

* ``weight.COST``: weight of a cost in a weighted sum, in units of one over the cost's typical spread (`SCALES`), so
  that weights of one make the costs count alike. Costs are those of `COSTS`.
* ``keep.orientation``, ``keep.position``: how many grasps the stages of the paper's cascade keep.
* ``keep.pose``: how many a first stage by weighted pose distance keeps, instead of those two.
* ``dof.x``, ``dof.y``, ``dof.z``, ``dof.rx``, ``dof.ry``, ``dof.rz``: weights of the pose distance in the gripper's
  frame; ``dof.length``: metres that a radian counts for in it.
* ``measure``: name of the definition of M; part of every setting, whatever its rule.

A dimension that has no effect on the rule of a point is refused, see `rule_of`.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, log
from types import MappingProxyType
from typing import Annotated, Any, TypeAlias

import numpy as np

from optsc import selection
from optsc.checks import Checked, NonNegative, OneOf, Where, require
from optsc.errors import InvalidValue
from optsc.selection import (
    Cascade,
    GraspCost,
    ManipulabilityLoss,
    PoseDistance,
    RankingRule,
    Stage,
    WeightedSum,
)
from optsc.study.conditions import DEFAULT_MEASURE, Condition, measure

Point: TypeAlias = dict[str, Any]

SCALES: Mapping[str, float] = MappingProxyType(
    {
        "orientation": 0.5,
        "position": 0.1,
        "manipulability": 0.05,
        "pose": 0.15,
        "joint-travel": 1.0,
        "quality": 0.05,
        "clearance": 0.03,
        "clearance-on-the-way": 0.04,
        "manipulability-on-the-way": 0.03,
        "peak-joint-speed": 0.35,
        "way-length": 0.06,
    }
)
"""Typical spread of each cost over the grasps of an object, in its unit.

Tuned here: interquartile ranges over all reachable grasps of the wanted object at the hand-over, in ten random
scenes of a Panda (``scene_set(("panda",), 10, 1)``). The first five are rounded from
0.34, 0.09, 0.07, 0.11 and 0.73.
"""
WHOLE = ("keep.orientation", "keep.position", "keep.pose")
"""Dimensions that count grasps: whole numbers from one."""
DOFS = ("x", "y", "z", "rx", "ry", "rz")
DIGITS = 9
"""Significant digits of a point's numbers, so that keys do not depend on the last one."""


def _slug(cost: GraspCost | type[GraspCost]) -> str:
    """Return the cost's name as dimensions have it."""
    return cost.name.replace(" ", "-")


def _costs() -> dict[str, type[GraspCost]]:
    found = {}
    for value in (getattr(selection, name) for name in dir(selection)):
        if inspect.isclass(value) and issubclass(value, GraspCost) and not inspect.isabstract(value):
            needed = [p for p in inspect.signature(value).parameters.values() if p.default is p.empty]
            if not needed:
                found[_slug(value)] = value
    return found


COSTS: Mapping[str, type[GraspCost]] = MappingProxyType(_costs())
"""Costs by name that a sweep can weigh: all of `optsc.selection` that need no arguments."""
NAMES = (
    *(f"weight.{cost}" for cost in COSTS),
    *WHOLE,
    *(f"dof.{dof}" for dof in DOFS),
    *("dof.length", "measure"),
)
"""Names of all dimensions."""
_GRASPS = Where(
    "a whole number of grasps, 1 or more",
    lambda x: not isinstance(x, bool) and x >= 1 and float(x).is_integer(),
)


@dataclass(frozen=True)
class Dimension(Checked):
    """One thing to vary: a range of numbers, or a list of values.

    Attributes:
        name: see the module.
        low, high: ends of the range, both included; without meaning where there are `values`.
        kind: ``linear``, ``log`` or ``integer`` range.
        values: what to choose from instead.

    Raises:
        UnknownName: no such dimension, kind of range or definition of M.
        InvalidValue: a range or value that the dimension cannot have: weights, also those of degrees of freedom, are 0
            or more, numbers of grasps whole and 1 or more.
    """

    name: Annotated[str, OneOf(NAMES, "dimension")]
    low: float = 0.0
    high: float = 1.0
    kind: Annotated[str, OneOf(("linear", "log", "integer"), "kind of range")] = "linear"
    values: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.values:
            self._check_range()
        for value in self.values or (self.low, self.high):
            _check_value(self.name, value)

    def _check_range(self) -> None:
        field, ends = f"range of {self.name}", (self.low, self.high)
        if self.name == "measure":
            raise InvalidValue(field, ends, "names: measure=a,b")
        if not (np.isfinite(ends).all() and self.low <= self.high):
            raise InvalidValue(field, ends, "finite, lower end first")
        if self.kind == "log" and self.low <= 0.0:
            raise InvalidValue(field, ends, "above 0 for a log range")
        if self.kind == "integer" and any(float(end) % 1.0 for end in ends):
            raise InvalidValue(field, ends, "whole numbers")
        if self.name in WHOLE and self.kind != "integer":
            raise InvalidValue(f"kind of {field}", self.kind, "integer, as in 5:120:integer")

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
        """Return the value at ``share`` in [0, 1] of the range or the list."""
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        if self.kind == "log":
            return rounded(exp(log(self.low) + share * (log(self.high) - log(self.low))))
        if self.kind == "integer":
            return int(min(self.low + np.floor(share * (self.high - self.low + 1)), self.high))
        return rounded(self.low + share * (self.high - self.low))

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


def rounded(value: float) -> float:
    """Return ``value`` with `DIGITS` significant digits."""
    return float(f"{value:.{DIGITS}g}")


def _check_value(name: str, value: Any) -> None:
    """Raise `UnknownName` or `InvalidValue` where ``name`` cannot have that value."""
    if name == "measure":
        measure(str(value))
    else:
        require(name, value, _GRASPS if name in WHOLE else NonNegative)


def check_distinct(dimensions: Sequence[Dimension]) -> None:
    """Raise `InvalidValue` unless there are ``dimensions``, and each once."""
    names = [dimension.name for dimension in dimensions]
    if not names or len(set(names)) < len(names):
        raise InvalidValue("dimensions", names, "at least one, each once")


def rule_of(point: Point) -> RankingRule:
    """Return the rule that a point stands for: a weighted sum if it has weights, else a cascade.

    Raises `UnknownName` for a name that means nothing, and `InvalidValue` for weights that are all zero, for a value
    that a dimension cannot have, and for a dimension that has no effect on the rule.
    """
    for name, value in point.items():
        require("dimension", name, OneOf(NAMES, "dimension"))
        _check_value(name, value)
    rule = _rule(point)
    idle = set(point) - _dimensions_of(rule)
    for name in sorted(idle):
        if name.startswith("dof."):
            valid = "beside weight.pose or keep.pose, which measure the pose distance"
        elif any(other.startswith("weight.") for other in point):
            valid = "without weight.COST: a weighted sum keeps no stages"
        else:
            valid = "without keep.pose, which takes the place of both other stages"
        raise InvalidValue(f"{name}, which this setting does not use,", point[name], valid)
    return rule


def _rule(point: Point) -> RankingRule:
    weights = {name.removeprefix("weight."): v for name, v in point.items() if name.startswith("weight.")}
    if weights:
        terms = [(_cost(cost, point), float(w) / SCALES[cost]) for cost, w in sorted(weights.items())]
        return WeightedSum(tuple((cost, rounded(weight)) for cost, weight in terms))
    if "keep.pose" in point:
        return Cascade((Stage(_cost("pose", point), int(point["keep.pose"])), Stage(ManipulabilityLoss())))
    return Cascade.paper(int(point.get("keep.orientation", 30)), int(point.get("keep.position", 6)))


def _dimensions_of(rule: RankingRule) -> set[str]:
    """Return the names of all dimensions that ``rule`` depends on, a weight of zero included."""
    # The definition of M is the condition's: also a rule without M has it in its rows.
    names = {"measure"}
    costs: list[GraspCost] = []
    if isinstance(rule, WeightedSum):
        costs = [cost for cost, _ in rule.terms]
        names |= {f"weight.{_slug(cost)}" for cost in costs}
    elif isinstance(rule, Cascade):
        costs = [stage.cost for stage in rule.steps]
        names |= {f"keep.{_slug(cost)}" for cost in costs}
    if any(isinstance(cost, PoseDistance) for cost in costs):
        names |= {*(f"dof.{dof}" for dof in DOFS), "dof.length"}
    return names


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
        definition = str(point.get("measure", DEFAULT_MEASURE))
        found.append(Condition(condition_name(number), rule_of(point), definition, point))
    return found


def condition_name(number: int) -> str:
    """Return the name of the condition of a point with that number."""
    return f"{number:05d}"
