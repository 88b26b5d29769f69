"""Intent inference: a belief over goal objects from the motion of the hand.

Of an object with many grasps the nearest counts: its cost-to-go V_g is the least over all poses the arm can
reach. A person who wants object g moves so that little is wasted; what a motion from x to x' wastes is

    s_g = C_g(x, x') + V_g(x') - V_g(x),   C_g = V_t'(d) |dp| + V_r'(a) |da|,

with d and a the distance and angle from x to the nearest grasp: the motion's length at the price that the remaining
path has there. Straight towards a single grasp nothing is wasted. The belief follows Boltzmann's law, b_g <- b_g
exp(-beta s_g), normalised: the recursive form of maximum-entropy goal inference (A. Dragan, S. Srinivasa, "A policy-
blending formalism for shared control", 2013; S. Javdani et al., "Shared autonomy via hindsight optimization", 2018).
As V telescopes, a path of many steps wastes what they cost together, less what it gained: V_g at its start minus V_g
at its end. The cost-to-go with its constants is that of the authors' program; there a step costs 0.1 s of the slope,
whatever its length, which makes trembling near a grasp speak for it.

That belief runs away once the assistance moves the tool (R. Aronson, E. Short, arXiv:2408.12103). Here only the
hand's own motion counts, a hand at rest says nothing, and with every update a little belief leaks back to all
objects.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import pi
from typing import Annotated, NamedTuple

import numpy as np

from optsc.checks import AtLeast, Below, Checked, NonNegative, Pair, Positive
from optsc.geometry import rotation
from optsc.geometry.rotation import Array
from optsc.selection.reach import REACHED, ReachTable


@dataclass(frozen=True)
class HuberCost(Checked):
    """A cost-to-go that is quadratic near the goal and linear far from it.

        V(d) = weight (gain / (2 width) d^2 + slope d)             for d <= width
        V(d) = weight ((gain + slope) d - gain width / 2)          for d > width

    Attributes:
        gain: what the slope rises by over the width [1/m] or [1/rad].
        width: where the quadratic part ends [m] or [rad].
        slope: at the goal itself [1/m] or [1/rad].
        weight: of it all [1].
    """

    gain: Annotated[float, Positive]
    width: Annotated[float, Positive]
    slope: Annotated[float, Positive]
    weight: Annotated[float, Positive] = 1.0

    def value(self, distance: Array) -> Array:
        """Return the cost-to-go (...) at distances (...), none of them negative."""
        near = 0.5 * self.gain / self.width * np.square(distance) + self.slope * distance
        far = (self.gain + self.slope) * distance - 0.5 * self.gain * self.width
        return self.weight * np.where(distance <= self.width, near, far)

    def derivative(self, distance: Array) -> Array:
        """Return V' (...) at distances (...)."""
        return self.weight * (self.gain * np.minimum(distance / self.width, 1.0) + self.slope)


@dataclass(frozen=True)
class IntentSettings(Checked):
    """How motion of the hand becomes belief.

    Attributes:
        translation, rotation: cost-to-go over distance and angle; the constants of Javdani et al.
        rationality: beta, belief per cost wasted [1]: how straight people are taken to go. With 1, as there, half a
            metre of reaching barely tells two objects apart that stand side by side; the default is tuned here.
        leak: share of the belief that goes back to all objects alike at each update [1].
        cap: belief in one object at most [1].
        dead_band: distance and angle that the hand moves from update to update [m, rad]; less is rest.
    """

    translation: HuberCost = field(default_factory=lambda: HuberCost(2.25, 0.07, 0.2))
    rotation: HuberCost = field(default_factory=lambda: HuberCost(0.20, pi / 32, 0.01, 0.07))
    rationality: Annotated[float, Positive] = 5.0
    leak: Annotated[float, NonNegative, Below(1.0)] = 0.01
    cap: Annotated[float, AtLeast(0.5), Below(1.0)] = 0.99
    dead_band: Annotated[tuple[float, float], Pair] = (0.01, 0.1)


@dataclass(frozen=True, eq=False)
class Goals:
    """The grasps of all objects that the arm can reach, with both jaw twins: R poses of K objects.

    Attributes:
        names: the objects that have one (K,), sorted.
        line: (R,) number of each pose's object; rising.
        first: (K,) first pose of each object.
        positions, quaternions: of the tool at the grasp, (R, 3) [m] and (R, 4).
        candidate: (R,) index into the candidates.
        manipulability: (R,).
    """

    names: tuple[str, ...]
    line: np.ndarray
    first: np.ndarray
    positions: Array
    quaternions: Array
    candidate: np.ndarray
    manipulability: Array

    @classmethod
    def of(cls, table: ReachTable, barred: np.ndarray | None = None) -> Goals:
        """Return the goals of a reach table, without the candidates that are ``barred`` (N,) bool."""
        usable = table.status == REACHED
        if barred is not None:
            usable = usable & ~barred[:, None]
        candidates = table.candidates
        rows = np.flatnonzero(usable)
        candidate = rows // table.twins
        objects = np.asarray(candidates.object_index, dtype=np.int64)[candidate]
        names = tuple(sorted({candidates.object_names[int(k)] for k in np.unique(objects)}))
        number = {name: k for k, name in enumerate(names)}
        lines = np.array([number.get(name, -1) for name in candidates.object_names], dtype=np.int64)
        line = lines[objects] if len(rows) else objects
        order = np.argsort(line, kind="stable")
        rows, line = rows[order], line[order]
        return cls(
            names,
            line,
            np.searchsorted(line, np.arange(len(names))),
            table.X_WG.translation.reshape(-1, 3)[rows],
            table.X_WG.quaternion.reshape(-1, 4)[rows],
            candidate[order],
            table.manipulability.reshape(-1)[rows],
        )

    @cached_property
    def lines(self) -> list[slice]:
        """Which poses are those of each object (K,)."""
        ends = np.searchsorted(self.line, np.arange(len(self.names)), side="right")
        return [slice(*pair) for pair in zip(self.first.tolist(), ends.tolist(), strict=True)]


class CostToGo(NamedTuple):
    """Per object (K,): the cost-to-go of its nearest grasp, the row of that, and how far it is [m, rad]."""

    value: Array
    row: np.ndarray
    distance: Array
    angle: Array


def cost_to_go(settings: IntentSettings, goals: Goals, position: Array, quaternion: Array) -> CostToGo:
    """Return V_g = min over the poses of g of V_t(distance) + V_r(angle), from a tool pose (3,) and (4,)."""
    distance = np.linalg.norm(goals.positions - position, axis=1)
    angle = rotation.angle(goals.quaternions, quaternion)
    value = settings.translation.value(distance) + settings.rotation.value(angle)
    row = np.array([line.start + int(np.argmin(value[line])) for line in goals.lines], dtype=np.int64)
    return CostToGo(value[row], row, distance[row], angle[row])


def wasted(settings: IntentSettings, before: CostToGo, after: CostToGo, moved: float, turned: float) -> Array:
    """Return s_g (K,) of a motion that was ``moved`` long [m] and ``turned`` by an angle [rad]; see the module."""
    cost = settings.translation.derivative(before.distance) * moved
    cost = cost + settings.rotation.derivative(before.angle) * turned
    return cost + after.value - before.value


@dataclass(frozen=True, eq=False)
class Belief:
    """How likely each of K objects is the intended goal.

    Attributes:
        names: the objects, sorted.
        probability: (K,), of sum one.
    """

    names: tuple[str, ...]
    probability: Array

    @classmethod
    def even(cls, names: tuple[str, ...]) -> Belief:
        """Return the belief of someone who has not seen anything."""
        return cls(names, np.full(len(names), 1.0 / max(1, len(names))))

    def __post_init__(self) -> None:
        self.probability.flags.writeable = False

    @property
    def best(self) -> str | None:
        """The most probable object, of equals the first by name; None without objects."""
        return self.names[int(np.argmax(self.probability))] if self.names else None

    @property
    def gap(self) -> float:
        """By how much the most probable object exceeds the second; 1 where there is only one, 0 where there is none."""
        if len(self.names) < 2:
            return float(len(self.names))
        second, first = np.partition(self.probability, -2)[-2:]
        return float(first - second)

    def among(self, names: tuple[str, ...]) -> Belief:
        """Return the belief over other objects: those known keep their proportions, new ones get an even share."""
        if names == self.names:
            return self
        known = dict(zip(self.names, self.probability.tolist(), strict=True))
        share = 1.0 / max(1, len(names))
        kept = sum(known.get(name, 0.0) for name in names)
        old = share * sum(name in known for name in names)
        values = [old * known[name] / kept if name in known and kept > 0 else share for name in names]
        total = sum(values)
        return Belief(names, np.array([value / total for value in values]))


def updated(settings: IntentSettings, belief: Belief, waste: Array) -> Belief:
    """Return the belief after a motion that would have wasted ``waste`` (K,) towards each object.

    b_g exp(-beta s_g), normalised; then the leak; then the excess of the greatest over the cap goes to the others
    evenly.
    """
    count = len(belief.names)
    if count < 2:
        return belief
    # The least waste is taken off first, so that the exponentials cannot all vanish.
    likelihood = np.exp(-settings.rationality * (waste - waste.min()))
    b = belief.probability * likelihood
    b = (1.0 - settings.leak) * b / b.sum() + settings.leak / count
    top = int(np.argmax(b))
    excess = b[top] - settings.cap
    if excess > 0:
        b += excess / (count - 1)
        b[top] = settings.cap
    return Belief(belief.names, b)
