"""One row of the quadratic program for each pair of bodies: how fast their distance may fall.

A row is g(q) v >= lower on the joint velocity v, where g is the gradient of the distance d. The rate at which d may
fall is the one from which the arm can brake with the deceleration A after a delay T:

    allowed(d) = sqrt((A T)^2 + 2 A d) - A T     for d > 0,        max(d / T, -push)     for d <= 0.

It has the slope 1/T on both sides of d = 0, the end of the margin, so an arm comes to rest there without a jolt.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi
import numpy as np

from optsc.kernels.chain import Chain, Rates
from optsc.kernels.symbols import only_if

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
        return PairFunctions(casadi.Function(f"{name}_bound", inputs, [bound]), chosen, self.stop_rate)


class PairFunctions(NamedTuple):
    """Functions of one pair: inputs -> lower bound of the distance; (near, bound, inputs, shared inputs) -> row."""

    bound: casadi.Function
    row: casadi.Function
    stop_rate: float

    def each(
        self,
        inputs: Sequence[casadi.MX],
        speed: casadi.MX,
        margin: casadi.MX,
        shared: Sequence[casadi.MX],
        fixed: int = 0,
    ) -> casadi.MX:
        """Return the rows (3 + n, count) of pairs side by side; the last ``fixed`` inputs they have in common.

        Pairs that can still brake from the greatest ``speed`` (1, count) [m/s] that they can have are skipped.
        """
        count, settings = speed.shape[1], shared[2]
        common = list(range(len(inputs) - fixed, len(inputs) + len(shared)))
        bound = self.bound.map("bounds", "serial", count, common[:fixed], [])(*inputs)
        # With |g v| <= speed and the deceleration share * sum |g_i| A_i, up to its cap, the stop is no longer.
        delay, share, most = (settings[k] for k in (RowSettings.DELAY, RowSettings.BRAKING, RowSettings.MOST_BRAKING))
        time = delay + 0.5 * casadi.fmax(1.0 / (share * self.stop_rate), speed / most)
        near = bound - margin < speed * time
        rows = self.row.map("rows", "serial", count, [2 + k for k in common], [])
        return rows(near, bound, *inputs, *shared)
