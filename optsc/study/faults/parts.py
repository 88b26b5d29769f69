"""Parts of the user's that can be made to fail: solver, policy, cost, filter, inverse kinematics, collision check.

Each asks a hook of the world for its answer where one is set, and is what it stands for otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from optsc.control.arbitration import HAND_ALONE, Arbitration, Blend, Moment, Trigger
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates
from optsc.ik.avoidance import Nearness
from optsc.ik.solvers import QpSolution, QpSolver, Rows
from optsc.selection import PositionDistance
from optsc.selection.filters import GraspFilter
from optsc.selection.grid import Situation
from optsc.study.faults.fault import Hook


class Hooks:
    """Hooks by the name of the part; none is set at first."""

    def __init__(self) -> None:
        self._hooks: dict[str, Hook] = {}

    def set(self, hooks: dict[str, Hook]) -> None:
        """Let these parts answer otherwise from now on, and no others."""
        self._hooks = dict(hooks)

    def call(self, name: str, genuine: Callable[..., Any], *arguments: Any) -> Any:
        """Return what the part of that name answers."""
        hook = self._hooks.get(name)
        return genuine(*arguments) if hook is None else hook(genuine, arguments)


class UserSolver:
    """A QP solver."""

    def __init__(self, hooks: Hooks, solver: QpSolver) -> None:
        self.name, self._hooks, self._solver = solver.name, hooks, solver

    def solve(self, H: Array, g: Array, lower: Array, upper: Array, rows: Rows | None = None) -> QpSolution:
        """Return what the solver, or the hook, answers."""
        return self._hooks.call("solver", self._solver.solve, H, g, lower, upper, rows)


@dataclass(frozen=True, eq=False)
class UserPolicy(Arbitration):
    """An arbitration policy that leaves all to the hand, and hands over at the trigger."""

    hooks: Hooks

    name: ClassVar[str] = "user-defined"
    trigger: ClassVar[Trigger] = Trigger.HANDS_OVER

    def blend(self, moment: Moment) -> Blend:
        """Return what the policy, or the hook, answers."""
        return self.hooks.call("policy", lambda _: HAND_ALONE, moment)

    def begins(self, intended_for: float) -> bool:
        """Return whether the robot begins by itself."""
        return self.hooks.call("begins", lambda _: False, intended_for)


@dataclass(frozen=True, eq=False)
class UserCost(PositionDistance):
    """The distance in position."""

    hooks: Hooks

    def values(self, situation: Situation) -> Array:
        """Return the distance, or what the hook answers."""
        return self.hooks.call("cost", super().values, situation)

    def key(self, situation: Situation) -> Array:
        """Return its square, or what the hook answers."""
        return self.hooks.call("cost", super().key, situation)


@dataclass(frozen=True, eq=False)
class UserFilter(GraspFilter):
    """A filter that all pass."""

    hooks: Hooks

    @property
    def reason(self) -> str:
        """Why a grasp does not pass."""
        return self.hooks.call("reason", lambda: "refused by the user's filter")

    def passes(self, situation: Situation) -> np.ndarray:
        """Return what the filter, or the hook, answers."""
        return self.hooks.call("filter", lambda s: np.ones(s.grid.reachable.shape, dtype=bool), situation)


class UserAvoidance:
    """Avoidance of nothing."""

    def __init__(self, hooks: Hooks) -> None:
        self._hooks = hooks

    @property
    def obstacles(self) -> Collection[str]:
        """Return no names."""
        return self._hooks.call("obstacles", tuple)

    def hand_may_touch(self, *names: str | None) -> None:
        """Do nothing."""
        self._hooks.call("hand may touch", lambda *_: None, *names)

    def rows(self, q: Array, lowest: Array, highest: Array) -> Rows | None:
        """Return no rows, or what the hook answers."""
        return self._hooks.call("rows", lambda *_: None, q, lowest, highest)

    def stopping(self, q: Array, lowest: Array, highest: Array, solver: QpSolver) -> Array:
        """Return rest, or what the hook answers."""
        return self._hooks.call("stopping", lambda q, *_: np.zeros(len(q)), q, lowest, highest, solver)

    def blocking(self, velocity: Array) -> Nearness | None:
        """Return nothing, or what the hook answers."""
        return self._hooks.call("blocking", lambda _: None, velocity)

    def snapshot(self) -> Array:
        """Return nothing, as it remembers nothing, or what the hook answers."""
        return self._hooks.call("snapshot", lambda: np.zeros(0))

    def restore(self, obstacles: Array) -> None:
        """Do nothing, or what the hook does."""
        self._hooks.call("restore", lambda _: None, obstacles)


def user_ik(hooks: Hooks, solve: Callable[..., Any]) -> Callable[..., Any]:
    """Return inverse kinematics as a selector asks for it."""
    return lambda *arguments: hooks.call("inverse kinematics", solve, *arguments)


def user_clear(hooks: Hooks) -> Callable[[Array, Array, Candidates], np.ndarray]:
    """Return a collision check that finds everything clear."""
    return lambda *rows: hooks.call("clear", lambda q, *_: np.ones(len(q), dtype=bool), *rows)
