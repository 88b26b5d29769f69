"""Stateless selector: every decision is made on a reach table solved from the configuration of that moment.

The live selector keeps its table up to date a few grasps at a time, so what it knows at the trigger depends on how the
hand went there and on what the rule was interested in on the way. In a study a choice has to follow from the scene and
the moment alone: then the same geometry serves every rule, and a weight that changes a choice did so by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.control.approach import Approach
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates
from optsc.robot import RobotModel
from optsc.robot.manipulability import Manipulability
from optsc.selection import GraspSelector, Ranking, RankingRule, ReachTable
from optsc.selection.reach import ClearRows
from optsc.study.conditions import measure


class TableKey(NamedTuple):
    """What a reach table follows from, but for the definition of M; scenes are told apart by identity."""

    candidates: Candidates
    clear: ClearRows | None
    q: bytes
    columns: frozenset[str]


class Tables:
    """Reach tables: solved once for each scene and configuration, scored once for each definition of M."""

    def __init__(self) -> None:
        self._kept: dict[TableKey, dict[str, ReachTable]] = {}

    def get(self, key: TableKey, name: str, solve: Callable[[], ReachTable], robot: RobotModel) -> ReachTable:
        """Return the table of ``key`` with the M of that name.

        ``solve`` is asked for it where it is not there and does not follow from one that is.
        """
        tables = self._kept.setdefault(key, {})
        if name not in tables:
            # Further columns may depend on M; configurations and reach do not.
            known = next(iter(tables.values()), None) if not key.columns else None
            tables[name] = solve() if known is None else with_measure(known, robot, measure(name))
        return tables[name]


def with_measure(table: ReachTable, robot: RobotModel, definition: Manipulability) -> ReachTable:
    """Return ``table`` with another definition of M in it; configurations and reach stay what they are."""
    values = np.zeros(table.status.shape)
    reached = table.admissible
    if reached.any():
        values[reached] = definition.evaluate(robot, table.q_grasp[reached])
    values[~np.isfinite(values)] = 0.0
    return replace(table, manipulability=values)


class StatelessSelector(GraspSelector):
    """A grasp selector that decides on tables solved from the configuration at the decision, see the module.

    Attributes:
        measure: name of the definition of M.
        tables: where solved tables are kept; selectors of the same scene may share it.
    """

    def __init__(
        self,
        robot: RobotModel,
        rule: RankingRule,
        measure_name: str,
        approach: Approach,
        tables: Tables | None = None,
    ) -> None:
        super().__init__(
            robot,
            rule,
            measure(measure_name),
            standoff=approach.standoff,
            speed=approach.speed,
            angular_speed=approach.angular_speed,
        )
        self.measure = measure_name
        self.tables = Tables() if tables is None else tables

    def decide_by(self, rule: RankingRule, measure_name: str) -> None:
        """Rank by another rule and definition of M from now on; raise `UnknownName`."""
        self.measure = measure_name
        self.rank_by(rule, measure(measure_name))

    def observe(
        self,
        candidates: Candidates,
        q: ArrayLike,
        *,
        clear: ClearRows | None = None,
        reuse: bool = False,
    ) -> ReachTable:
        """Keep the scene and return its table as seen from ``q`` (n,) [rad]; see `optsc.selection.GraspSelector`."""
        return self._solve_from(candidates, self.robot.checked(q), clear)

    def decides_from(self, q: Array) -> None:
        """Solve the table from the configuration ``q`` (n,) [rad] of a decision."""
        if self.candidates is not None:
            self._solve_from(self.candidates, self.robot.checked(q), self.state.clear)

    def rank(
        self,
        X_WT: Pose,
        q: Array,
        candidates: Candidates | None = None,
        *,
        refresh_limit: int | None = None,
    ) -> Ranking:
        """Return the ranking; a ``refresh_limit`` above zero marks a decision: made on a table solved from ``q``."""
        if refresh_limit:
            self.decides_from(q)
        return super().rank(X_WT, q, refresh_limit=0)

    def is_outdated(self, object_name: str | None) -> bool:
        """Return False: a table that is decided on is solved from where the arm is."""
        return False

    def refresh_piece(self, q: ArrayLike, object_name: str | None = None, *, finalists_only: bool = False) -> bool:
        """Do nothing: whatever matters is solved at the decision."""
        return False

    def refresh_oldest(self, q: ArrayLike, limit: int) -> int:
        """Do nothing: whatever matters is solved at the decision."""
        return 0

    def _solve_from(self, candidates: Candidates, q: Array, clear: ClearRows | None) -> ReachTable:
        def solve() -> ReachTable:
            return self.solver.table(candidates, q, clear=clear)

        key = TableKey(candidates, clear, q.tobytes(), self.solver.columns)
        table = self.tables.get(key, self.measure, solve, self.robot)
        if table is not self.table:
            self.use(table, clear=clear)
        return table
