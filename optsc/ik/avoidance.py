"""Avoidance: what adds rows to the quadratic program so that the arm keeps clear of things."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple, Protocol

from optsc.geometry.rotation import Array
from optsc.ik.solvers import QpSolver, Rows


class Nearness(NamedTuple):
    """A pair of bodies that holds the motion back: a link, what it is near to, and how far apart they are [m]."""

    link: str
    other: str
    distance: float


class Avoidance(Protocol):
    """What the servo asks of collision avoidance; `optsc.collision.CollisionAvoidance` is one.

    Within a tick `rows` is asked first, and `blocking` for the same configuration. What it remembers from tick to
    tick is in its snapshot.
    """

    @property
    def obstacles(self) -> Collection[str]:
        """Names of the obstacles."""
        ...

    def hand_may_touch(self, *names: str | None) -> None:
        """Let the hand touch these obstacles from now on and no others; raise `UnknownName`."""
        ...

    def rows(self, q: Array, lowest: Array, highest: Array) -> Rows | None:
        """Return the rows on the joint velocity of the next tick, which has the bounds given (n,) [rad/s]."""
        ...

    def stopping(self, q: Array, lowest: Array, highest: Array, solver: QpSolver) -> Array:
        """Return the velocity (n,) to brake to at this tick: rest, or the nearest to it that leads nowhere too fast."""
        ...

    def blocking(self, velocity: Array) -> Nearness | None:
        """Return the nearest pair whose row, of the last `rows`, holds this velocity (n,) back, if any does."""
        ...

    def snapshot(self) -> Array:
        """Return where the obstacles are, how they move, and which of them the hand may touch, for `restore`."""
        ...

    def restore(self, obstacles: Array) -> None:
        """Put back what `snapshot` returned."""
        ...
