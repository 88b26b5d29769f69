"""Stateless selector: every decision is made on a reach table solved from the configuration of that moment.

The live selector keeps its table up to date a few grasps at a time, so what it knows at the trigger depends on how the
hand went there and on what the rule was interested in on the way. In a study a choice has to follow from the scene and
the moment alone: then the same geometry serves every rule, and a weight that changes a choice did so by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from optsc.control.approach import Approach
from optsc.errors import InvalidValue
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates
from optsc.robot import RobotModel
from optsc.robot.manipulability import Manipulability
from optsc.selection import GraspSelector, Ranking, RankingRule, ReachTable
from optsc.selection.reach import ClearRows
from optsc.study.conditions import measure


class Tables:
    """Reach tables of one scene: solved once for each configuration, scored once for each definition of M."""

    def __init__(self) -> None:
        self._kept: dict[tuple[bytes, str, frozenset[str]], ReachTable] = {}

    def get(
        self, q: Array, name: str, columns: frozenset[str], solve: Callable[[], ReachTable], robot: RobotModel
    ) -> ReachTable:
        """Return the table seen from ``q`` (n,) [rad] with the M of that name and further columns.

        ``solve`` is asked for it where it is not there and does not follow from one that is.
        """
        place = (q.tobytes(), name, columns)
        if place not in self._kept:
            others = [table for (at, _, more), table in self._kept.items() if at == place[0] and more == columns]
            # Further columns may depend on M; configurations and reach do not.
            known = others[0] if others and not columns else None
            self._kept[place] = solve() if known is None else with_measure(known, robot, measure(name))
        return self._kept[place]


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
        self._scene: tuple[Candidates, ClearRows | None] | None = None

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
        self._scene = (candidates, clear)
        return self._solve_from(self.robot.checked(q))

    def rank(
        self,
        X_WT: Pose,
        q: Array,
        candidates: Candidates | None = None,
        *,
        refresh_limit: int | None = None,
    ) -> Ranking:
        """Return the ranking; a ``refresh_limit`` above zero marks a decision: made on a table solved from ``q``."""
        if refresh_limit and self._scene is not None:
            self._solve_from(self.robot.checked(q))
        return super().rank(X_WT, q, refresh_limit=0)

    def refresh_oldest(self, q: ArrayLike, limit: int) -> int:
        """Do nothing: whatever matters is solved at the decision."""
        return 0

    def _solve_from(self, q: Array) -> ReachTable:
        if self._scene is None:
            raise InvalidValue("scene of the selector", None, "observed before it is ranked")
        candidates, clear = self._scene

        def solve() -> ReachTable:
            return super(StatelessSelector, self).observe(candidates, q, clear=clear, reuse=False)

        table = self.tables.get(q, self.measure, self.solver.columns, solve, self.robot)
        if table is not self.table:
            self.use(table, clear=clear)
        return table
