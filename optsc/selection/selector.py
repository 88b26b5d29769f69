"""The grasp selector: keeps the reach table of placed candidates and ranks them against the moving hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import NonNegative, Whole, require
from optsc.errors import InvalidValue
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.ik.batch import solve_ik
from optsc.selection.decision import RankingInputs, decide
from optsc.selection.filters import GraspFilter
from optsc.selection.grid import Grid, Situation
from optsc.selection.hysteresis import Hysteresis, Viewpoint
from optsc.selection.ranking import Ranking
from optsc.selection.reach import ClearRows, ReachSolver, ReachTable, SolveIk, with_rows
from optsc.selection.reach_columns import StraightMotion, needed, require_measurable
from optsc.selection.rules import Cascade, RankingRule
from optsc.selection.scene_change import filters_in_force, given_up, gone_on, with_table
from optsc.selection.selector_state import SelectorState, unusable
from optsc.selection.table_build import NewScene

if TYPE_CHECKING:
    from optsc.grasps import Candidates
    from optsc.robot import RobotModel
    from optsc.robot.manipulability import ManipulabilityMeasure

FINALISTS = 6
"""How many of the best grasps of each object must be judged from the arm's present configuration."""
ROWS_AGAIN = 3
"""Rows that one piece of work solves again, or checks for collision."""


RESTARTS = 0
"""A grasp has to be reached from the present configuration: the arm moves straight, in the IK branch it is in."""


def _solver(robot: RobotModel) -> SolveIk:
    """Return this library's inverse kinematics as a selector asks for it."""

    def solve(X_WT: Pose, seeds: Array) -> tuple[Array, np.ndarray]:
        solutions = solve_ik(robot, X_WT, seeds=seeds, restarts=RESTARTS)
        return solutions.q, solutions.success

    # What a single pose needs is compiled now, not in the middle of a control tick.
    solve(robot.forward(robot.home[None]), robot.home)
    return solve


class GraspSelector:
    """Ranks the grasps of every object for the pose of the hand.

    On the scene clock `observe` solves the reach table; on the control clock `rank` reads it. Two kinds of
    numbers depend on where the arm stands, the configurations and their manipulability; so before the final choice
    the best grasps of every object that were solved from a configuration further away than ``refresh_angle`` are
    solved again, at most ``refresh_limit`` of them in one call.

    Unreachable candidates are filtered out before any stage, so that a stage of 30 means 30 grasps that the
    arm can reach. Where jaws are symmetric, a candidate also stands for its half-turned twin: of those
    twins the arm can reach, the one nearer to the hand in orientation.

    Attributes:
        robot: the arm.
        solver: how reach tables are solved.
        rule: how candidates are ranked.
        filters: which candidates may be ranked, besides reachability and the operator's vetoes.
        hysteresis: how far hand and arm move before the ranking takes notice; None for at once.
        state: all that observing, ranking and vetoing change.
        candidates, table: what was observed last, and its reach table; None before.
    """

    def __init__(
        self,
        robot: RobotModel,
        rule: RankingRule | None = None,
        manipulability: ManipulabilityMeasure | None = None,
        *,
        standoff: float = 0.1,
        filters: Sequence[GraspFilter] = (),
        hysteresis: Hysteresis | None = None,
        speed: float = 0.1,
        angular_speed: float = 0.5,
        solve: SolveIk | None = None,
        motion: StraightMotion | None = None,
        refresh_angle: float = 0.1,
        refresh_limit: int = 6,
    ) -> None:
        """Make a selector without candidates.

        Args:
            robot: the arm.
            rule: by default the paper's cascade.
            manipulability: the measure M; by default `optsc.robot.manipulability.Manipulability()`.
            standoff: distance from the pre-grasp to the grasp along the approach axis [m].
            filters: which candidates may be ranked, besides reachability.
            hysteresis: how far hand and arm move before the ranking takes notice; None, as in the paper, for at once.
            speed, angular_speed: of the tool on the approach [m/s, rad/s], by which straight paths are judged.
            solve: inverse kinematics, see `optsc.selection.reach.SolveIk`; by default `optsc.solve_ik`.
            motion: how the tool is moved to a grasp, see `ReachSolver`; by default, with the default ``solve``,
                straight at those speeds.
            refresh_angle: how far a joint may be [rad] from where a finalist was solved before it is solved
                again.
            refresh_limit: rows solved again in one call of `rank`, at most.

        Raises:
            InvalidValue: a setting out of range.
        """
        require("refresh_limit", refresh_limit, Whole, NonNegative)
        if manipulability is None:
            from optsc.robot.manipulability import Manipulability

            manipulability = Manipulability()
        if solve is None:
            solve, motion = _solver(robot), motion or StraightMotion(robot, speed, angular_speed)
        self.endless = tuple(np.flatnonzero(robot.endless).tolist())
        self.robot, self.filters, self.hysteresis = robot, tuple(filters), hysteresis
        self._refresh_limit = refresh_limit
        self.solver = ReachSolver(
            robot, solve, manipulability, standoff=standoff, motion=motion, refresh_angle=refresh_angle
        )
        self.rank_by(Cascade.paper() if rule is None else rule, manipulability)
        self.state = SelectorState(filters=self.filters)

    def rank_by(self, rule: RankingRule, manipulability: ManipulabilityMeasure) -> None:
        """Rank by another rule and definition of M from now on; tables are solved with it from the next scene on."""
        self.rule: RankingRule = rule
        columns = needed((*rule.costs, *self.filters))
        self.solver = replace(self.solver, manipulability=manipulability, columns=columns)

    def forget(self) -> None:
        """Start again: without vetoes, and with the next hand pose as if it were the first."""
        self.state = SelectorState(self.state.grid, self.state.clear, filters=self.filters)

    def veto(self, object_name: str, grasp_index: int) -> None:
        """Offer this grasp no more, until `forget`."""
        vetoed = self.state.vetoed | {(object_name, int(grasp_index))}
        state = self.state._replace(vetoed=vetoed)
        self.state = state._replace(filters=filters_in_force(state, self.filters))

    @property
    def table(self) -> ReachTable | None:
        """The reach table in use."""
        return None if self.state.grid is None else self.state.grid.table

    @property
    def candidates(self) -> Candidates | None:
        """The candidates in use."""
        return None if self.state.grid is None else self.state.grid.table.candidates

    def observe(
        self, candidates: Candidates, q: ArrayLike, *, clear: ClearRows | None = None, reuse: bool = True
    ) -> ReachTable:
        """Solve, keep and return the reach table of ``candidates``, seen from the configuration ``q`` (n,) [rad].

        To be called when an object moved or grasps were stored; ``clear`` checks rows for collisions in this
        scene. Grasps that have not moved, while no joint did by more than ``refresh_angle``, are not solved again
        but only judged in the new scene; with ``reuse`` off all are, so that nothing depends on what came before.

        Raises:
            InvalidValue: a configuration that is not finite, or a column that the rule or a filter reads and that
                cannot be measured without ``clear`` or without a motion.
        """
        table = self.solver.table(candidates, q, clear=clear, known=self.table if reuse else None)
        self.use(table, clear=clear)
        return table

    def use(self, table: ReachTable, *, clear: ClearRows | None = None) -> None:
        """Keep a table that was solved elsewhere, and the collision check of its scene.

        Raises `InvalidValue` where it lacks a column that the rule or a filter reads.
        """
        self.require_fits(table, table.candidates)
        self.state = with_table(self.state, table, clear)

    def require_fits(self, table: ReachTable, candidates: Candidates) -> None:
        """Raise `InvalidValue` for a table of other candidates, or without a column that the rule or a filter reads."""
        if table.candidates is not candidates:
            raise InvalidValue("candidates of the table", len(table.candidates), "those that are observed")
        if missing := self.solver.columns - set(table.columns):
            raise InvalidValue("columns of the table", sorted(table.columns), f"also {sorted(missing)}")

    def announce(
        self,
        candidates: Candidates,
        q: ArrayLike,
        *,
        clear: ClearRows | None = None,
        table: ReachTable | None = None,
    ) -> None:
        """Take in a scene as `observe` does, but leave its reach table to be solved piece by piece by `go_on`.

        A ``table`` that was solved elsewhere (`ReachSolver.table`) is in use after a few pieces.

        Until that is whole, the table at hand stays in use, but for the grasps that are no longer there. A table in the
        making is finished first; of several scenes that wait the newest counts. Vetoes begin again. Raises
        `InvalidValue` as `observe` does, and whatever the collision check raises for the grasp that it is tried on.
        """
        here = np.array(q, dtype=float)
        if table is not None:
            self.require_fits(table, candidates)
        else:
            require_measurable(self.solver.columns, self.solver.motion, clear)
        if clear is not None and len(candidates) and table is None:
            clear(here[None], here[None], candidates.select(np.zeros(1, dtype=np.int64)))
        state = self.state._replace(
            waiting=NewScene(candidates, clear, table), vetoed=frozenset(), filters=self.filters
        )
        self.state = state._replace(filters_known=False)

    @property
    def observing(self) -> bool:
        """Whether the reach table of a newer scene is in the making."""
        return self.state.build is not None or self.state.waiting is not None

    @property
    def announced(self) -> Candidates | None:
        """The candidates of the newest scene, whether or not its table is whole; None before there is one."""
        state = self.state
        if state.waiting is not None:
            return state.waiting.candidates
        return self.candidates if state.build is None else state.build.candidates

    def go_on(self, q: ArrayLike) -> bool:
        """Work out another piece of a new reach table, from configuration ``q`` (n,) [rad] where it is the first.

        Return whether it was the last, and the table is in use from now on. Where this raises, as a collision check
        may, the new scene is given up.
        """
        try:
            self.state, whole = gone_on(self.state, self.solver, self.filters, q)
        except Exception:
            self.state = given_up(self.state)
            raise
        return whole

    def rank(
        self,
        X_WT: Pose,
        q: Array,
        candidates: Candidates | None = None,
        *,
        refresh_limit: int | None = None,
    ) -> Ranking:
        """Return the candidates ranked for the pose of the tool that the hand moves; made for every tick.

        Args:
            X_WT: pose of the tool.
            q: present configuration of the arm (n,) [rad].
            candidates: observed first when they are not those at hand (without a collision check).
            refresh_limit: in place of the selector's for this call: more at a moment of decision, 0 for none.

        A pose, a configuration or candidates that are not usable give the previous ranking, or an empty one, with
        the reason; nothing is raised for them.
        """
        reason = unusable(X_WT, q, self.robot.n)
        if not reason and candidates is not None and candidates is not self.candidates:
            try:
                self.observe(candidates, q)
            except InvalidValue as error:
                reason = f"the candidates cannot be used: {error}"
        last = self._taken_over(self.state)
        if reason or last.grid is None:
            reason = reason or "no candidates were observed"
            return Ranking.empty(reason) if last.ranking is None else replace(last.ranking, reason=reason)
        configuration = np.array(q, dtype=float)
        w, x, y, z = X_WT.quaternion.tolist()
        quaternion = X_WT.quaternion / sqrt(w * w + x * x + y * y + z * z)
        budget = self._refresh_limit if refresh_limit is None else refresh_limit
        viewpoint = Viewpoint(quaternion, X_WT.translation, configuration)
        if self.hysteresis is not None:
            viewpoint = self.hysteresis.dragged(last.viewpoint, viewpoint)
        inputs = RankingInputs(last.grid, self.rule, last.filters, *viewpoint, self.endless)
        if last.ranking is not None and viewpoint is last.viewpoint and last.ranking.follows_from(inputs):
            return last.ranking
        grid, ranking, outdated = self._ranked(inputs, budget, refresh_limit is not None)
        self.state = last._replace(grid=grid, viewpoint=viewpoint, ranking=ranking, outdated=outdated)
        return ranking

    def _ranked(self, inputs: RankingInputs, budget: int, thorough: bool) -> tuple[Grid, Ranking, np.ndarray]:
        """Return the grid, the ranking, and what is outdated; such rows are solved again: once, or within the budget.

        Every round has its price, so at an ordinary tick there is one, and the next ticks catch up.
        """
        while True:
            decision = decide(inputs)
            rows = self._outdated(decision.situation, decision.selection.finalists(FINALISTS))
            if not len(rows) or budget <= 0:
                return inputs.grid, Ranking.of_decision(decision, stale=len(rows) > 0), rows
            table = self.solver.refresh(inputs.grid.table, rows[:budget], inputs.q, clear=self.state.clear)
            grid = inputs.grid.with_table(table)
            inputs = inputs._replace(grid=grid)
            budget = budget - len(rows) if thorough else 0

    def _outdated(self, situation: Situation, places: np.ndarray) -> np.ndarray:
        """Return the rows at ``places`` that were solved too far away, those nearest to the hand first."""
        grid = situation.grid
        rows = grid.first_rows[places]
        if situation.turned is not None:
            rows = rows + situation.turned.ravel()[places]
        gaps = np.abs(self.robot.difference(grid.seeds[rows], situation.q))
        if np.maximum.reduce(gaps, axis=None, initial=0.0) <= self.solver.refresh_angle:
            return rows[:0]
        gap = gaps.max(axis=1)
        offset = grid.positions.reshape(3, -1)[:, places] - situation.position[:, None]
        order = np.argsort(np.linalg.norm(offset, axis=0), kind="stable")
        return rows[order[gap[order] > self.solver.refresh_angle]]

    def decides_from(self, q: Array) -> None:
        """Be told that a decision begins, with the arm in configuration ``q`` (n,) [rad]: for selectors that care."""

    def is_outdated(self, object_name: str | None) -> bool:
        """Tell whether a finalist of the newest ranking, of an object, is still to be solved again."""
        return self.state.found is not None or bool(len(self._outdated_places(object_name)))

    def _outdated_places(self, object_name: str | None) -> np.ndarray:
        grid, outdated = self.state.grid, self.state.outdated
        if object_name is None or grid is None:
            return np.arange(len(outdated))
        candidates = grid.table.candidates
        index = candidates.object_names.index(object_name)
        return np.flatnonzero(candidates.object_index[outdated // grid.table.twins] == index)

    def refresh_piece(self, q: ArrayLike, object_name: str | None = None, *, finalists_only: bool = False) -> bool:
        """Do a piece of work on rows that were solved from too far away; return whether there was any.

        One piece solves up to `ROWS_AGAIN` rows from configuration ``q`` (n,) [rad], the next one checks them for
        collision; the table has them from the next ranking on. First come outdated finalists of the newest ranking, of
        an object where an ``object_name`` is given, the nearest first; then, unless it is for ``finalists_only``, those
        of all rows that were solved furthest away. Raises `InvalidValue` for a configuration that is not finite.
        """
        state = self.state
        if state.grid is None:
            return False
        table, solver = state.grid.table, self.solver
        if state.found is not None:
            part = solver.judged(table, state.found, state.clear)
            self.state = state._replace(found=None, judged=(*state.judged, part))
            return True
        places = self._outdated_places(object_name)[:ROWS_AGAIN]
        here = np.asarray(q, dtype=float)
        rows = state.outdated[places]
        if not len(rows) and not finalists_only and not state.judged:
            rows = self._oldest(state.grid, here, ROWS_AGAIN)
        if len(rows):
            found = solver.found(table, rows, here)
            self.state = state._replace(found=found, outdated=np.delete(state.outdated, places))
        return len(rows) > 0

    def take_over(self) -> bool:
        """Put rows that were solved again into the table, as `rank` does otherwise; return whether there were any."""
        before = self.state
        self.state = self._taken_over(before)
        return self.state is not before

    def _taken_over(self, state: SelectorState) -> SelectorState:
        """Return the state with the rows that were solved again in its table."""
        if state.grid is None or not state.judged:
            return state
        grid = state.grid.with_table(with_rows(state.grid.table, state.judged))
        return state._replace(grid=grid, judged=())

    def refresh_oldest(self, q: ArrayLike, limit: int) -> int:
        """Solve again up to ``limit`` rows of all, those solved furthest from ``q`` first; return how many.

        For idle time: it also gives another chance to rows that collided, or were not reached, from where
        the arm stood before. Raises `InvalidValue` for a configuration that is not finite.
        """
        grid = self.state.grid
        if grid is None:
            return 0
        here = np.asarray(q, dtype=float)
        rows = self._oldest(grid, here, limit)
        if len(rows):
            table = self.solver.refresh(grid.table, rows, here, clear=self.state.clear)
            self.state = self.state._replace(grid=grid.with_table(table))
        return len(rows)

    def _oldest(self, grid: Grid, here: Array, limit: int) -> np.ndarray:
        """Return up to ``limit`` rows that were solved too far from ``here`` (n,), those furthest away first."""
        gap = np.abs(self.robot.difference(grid.seeds, here)).max(axis=1, initial=0.0)
        oldest = np.argsort(-gap, kind="stable")[:limit]
        return oldest[gap[oldest] > self.solver.refresh_angle]
