"""One row of the quadratic program for each pair of bodies: how fast their distance may fall.

A row is g(q) v >= lower on the joint velocity v, where g is the gradient of the distance d. The rate at which d may
fall is the one from which the arm can brake with the deceleration A after a delay T:

    allowed(d) = sqrt((A T)^2 + 2 A d) - A T     for d > 0,        max(d / T, -push)     for d <= 0.

It has the slope 1/T on both sides of d = 0, the end of the margin, so an arm comes to rest there without a jolt.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi
import numpy as np

from optsc.kernels.chain import Chain, Rates
from optsc.kernels.symbols import only_if, symbols

FLAT = 1e-4
"""Gradients shorter than this [m/rad] are no row: no motion of the arm changes such a distance."""
HEAD = 3
"""Entries of a row before its gradient: need, lower, distance."""


class RowSettings:
    """Layout of the settings vector; see `optsc.collision.avoidance` for meaning and units."""

    SIZE = 6
    MARGIN, TABLE_HEIGHT, BRAKING, MOST_BRAKING, DELAY, PUSH = range(6)


class Box:
    """Layout of what describes one box: rotation (column by column), centre, half extents, twist, two flags."""

    SIZE = 23
    ROTATION, CENTRE, HALF = slice(0, 9), slice(9, 12), slice(12, 15)
    LINEAR, ANGULAR = slice(15, 18), slice(18, 21)
    ABSENT, HAND_MAY_TOUCH = 21, 22


class RowBuilder:
    """Expressions that turn a distance and its gradient into one row, for an arm of n joints."""

    CAPSULE = 8  # two ends, greatest speed of a point at this tick, number of the joint

    def __init__(self, chain: Chain, rates: Rates) -> None:
        n = self.n = chain.n
        self.capsule = casadi.SX.sym("capsule", self.CAPSULE)
        self.other = casadi.SX.sym("other", self.CAPSULE)
        self.low, self.high = casadi.SX.sym("low", n), casadi.SX.sym("high", n)
        self.settings = casadi.SX.sym("settings", RowSettings.SIZE)
        self.axes = casadi.SX.sym("axes", 6, n)
        self.shared = [self.low, self.high, self.settings, self.axes]
        self.slides = chain.slides
        self.acceleration = casadi.DM(rates.acceleration)
        self.stop_rate = float(np.min(rates.acceleration / rates.velocity))

    def ends(self, capsule: casadi.SX) -> tuple[casadi.SX, casadi.SX]:
        """The ends of a capsule's segment."""
        return capsule[0:3], capsule[3:6]

    def along(self, capsule: casadi.SX, point: casadi.SX, direction: casadi.SX) -> casadi.SX:
        """How fast (n) a point of a capsule moves along a direction as each joint moves at unit speed."""
        moment = casadi.cross(point, direction)
        entries = []
        for i in range(self.n):
            axis, origin = self.axes[:3, i], self.axes[3:, i]
            arm = direction if self.slides[i] else moment - casadi.cross(origin, direction)
            entries.append((capsule[7] >= i) * casadi.dot(axis, arm))
        return casadi.vertcat(*entries)

    def row(
        self,
        distance: casadi.SX,
        gradient: casadi.SX,
        margin: casadi.SX,
        drift: casadi.SX | float = 0.0,
        scale: casadi.SX | float = 1.0,
    ) -> casadi.SX:
        """(need, lower, distance, gradient (n)); a row can matter at this tick only where its need is below zero.

        ``scale`` is the length of the direction in the gradient, short where blending outweighs the distance.
        """
        s, spare = self.settings, distance - margin
        able = s[RowSettings.BRAKING] * casadi.dot(casadi.fabs(gradient), self.acceleration)
        able = casadi.fmin(able, s[RowSettings.MOST_BRAKING])
        delay = s[RowSettings.DELAY]
        braking = casadi.sqrt((able * delay) ** 2 + 2.0 * able * casadi.fmax(spare, 0.0)) - able * delay
        outwards = casadi.fmax(spare / delay, -s[RowSettings.PUSH] * scale)
        lower = -casadi.if_else(spare > 0.0, braking, outwards) - drift
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        least = casadi.dot(gradient, middle) - casadi.dot(casadi.fabs(gradient), half)
        need = casadi.if_else(casadi.dot(gradient, gradient) < FLAT * FLAT, 1.0, least - lower)
        return casadi.densify(casadi.vertcat(need, lower, distance, gradient))

    def far(self, distance: casadi.SX) -> casadi.SX:
        """What stands for the row of a pair that cannot matter: the distance is a lower bound."""
        return casadi.densify(casadi.vertcat(1.0, 0.0, distance, casadi.SX(self.n, 1)))

    def pair(self, name: str, inputs: list[casadi.SX], bound: casadi.SX, row: casadi.SX) -> PairFunctions:
        """Return the functions of one pair: a lower bound of its distance, and its row, skipped on demand."""
        known = casadi.SX.sym("known")
        arguments = [known, *inputs, *self.shared]
        exact = casadi.Function(f"{name}_exact", arguments, [row])
        chosen = only_if(exact, arguments, [self.far(known)])
        return PairFunctions(casadi.Function(f"{name}_bound", inputs, [bound]), chosen, self)


class Pair(NamedTuple):
    """One pair: the inputs of its functions, greatest speed that it can have [m/s], and distance that it keeps [m]."""

    inputs: Sequence[Any]
    speed: Any
    margin: Any


class PairFunctions(NamedTuple):
    """Functions of one pair: inputs -> lower bound of the distance; (near, bound, inputs, shared inputs) -> row."""

    bound: casadi.Function
    row: casadi.Function
    builder: RowBuilder

    def together(
        self, name: str, sizes: Mapping[str, int | tuple[int, int]], pairs: Callable[[Sequence[Any], Any], list[Pair]]
    ) -> casadi.Function:
        """Return (inputs of ``sizes``, shared inputs) -> rows (3 + n, P) of P pairs, and the least need of them.

        Pairs that can still brake from their greatest speed are skipped; where that is all of them, all are at once.

        Args:
            name: of the function.
            sizes: names and sizes of the inputs.
            pairs: given the inputs and the settings, returns the pairs.
        """
        builder = self.builder
        inputs, shared = symbols(casadi.MX, **sizes), [casadi.MX.sym("shared", *x.shape) for x in builder.shared]
        near, bounds, any_near = self._near(sizes, pairs)(*inputs, shared[2])
        count = near.shape[1]
        flags, known = symbols(casadi.MX, near=(1, count), known=(1, count))
        arguments = [*inputs, *shared, flags, known]
        # One call after another: a map would copy what its calls have in common.
        rows = [self.row(flags[k], known[k], *pair.inputs, *shared) for k, pair in enumerate(pairs(inputs, shared[2]))]
        side_by_side = casadi.horzcat(*rows)
        exact = casadi.Function(f"{name}_exact", arguments, [side_by_side, casadi.mmin(side_by_side[0, :])])
        chosen = only_if(exact, arguments, [self._all_far(count)(known), casadi.MX(1.0)])
        return casadi.Function(name, [*inputs, *shared], list(chosen(any_near, *inputs, *shared, near, bounds)))

    def _near(
        self, sizes: Mapping[str, int | tuple[int, int]], pairs: Callable[[Sequence[Any], Any], list[Pair]]
    ) -> casadi.Function:
        """(inputs, settings) -> which pairs may matter (1, P), bounds of their distances (1, P), whether any may."""
        *inputs, settings = symbols(casadi.SX, **sizes, settings=RowSettings.SIZE)
        # With |g v| <= speed and the deceleration share * sum |g_i| A_i, up to its cap, the stop is no longer.
        delay, share, most = (settings[k] for k in (RowSettings.DELAY, RowSettings.BRAKING, RowSettings.MOST_BRAKING))
        some, flags, bounds = casadi.SX(0), [], []
        for pair in pairs(inputs, settings):
            time = delay + 0.5 * casadi.fmax(1.0 / (share * self.builder.stop_rate), pair.speed / most)
            bounds.append(self.bound(*pair.inputs))
            flags.append(bounds[-1] - pair.margin < pair.speed * time)
            some = casadi.logic_or(some, flags[-1])
        outputs = [casadi.densify(casadi.horzcat(*flags)), casadi.densify(casadi.horzcat(*bounds)), some]
        return casadi.Function("near", [*inputs, settings], outputs)

    def _all_far(self, count: int) -> casadi.Function:
        """Bounds (1, count) -> the rows that stand for pairs that cannot matter."""
        known = casadi.SX.sym("known", 1, count)
        return casadi.Function("far", [known], [casadi.horzcat(*(self.builder.far(known[k]) for k in range(count)))])
