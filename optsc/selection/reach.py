"""Reach table: which grasps the arm can reach, in which configuration, and how well it can move there.

Solving it belongs to the scene clock; ranking only reads it. Rows are solved in the order in which the arm
moves: the pre-grasp from the present configuration, then the grasp from the pre-grasp's configuration. So the
manipulability of a row is the one at the configuration in which the arm would arrive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import Above, Checked, NonNegative
from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.selection.reach_columns import ReachedRows, StraightMotion, measured, require_measurable

if TYPE_CHECKING:
    from optsc.grasps import Candidates
    from optsc.robot import RobotModel
    from optsc.robot.manipulability import ManipulabilityMeasure

REACHED, UNREACHABLE, PREGRASP_UNREACHABLE, COLLISION, NO_STRAIGHT_APPROACH = range(5)
REASONS = ("", "unreachable", "pre-grasp unreachable", "collision", "no straight approach")
"""Why a row cannot be used, in words, by its status."""

HALF_TURN = Pose.from_quaternion([0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
"""The jaws' symmetry: half a turn about the tool's z axis."""

SolveIk: TypeAlias = Callable[[Pose, Array], Any]
"""Inverse kinematics ``solve(X_WT, seeds)`` of R poses from seeds (n,) or (R, n): returns a tuple that begins
with configurations (R, n) and success (R,)."""
ClearRows: TypeAlias = Callable[[Array, Array, "Candidates"], np.ndarray]
"""Collision check ``clear(q_grasp, q_pregrasp, candidates)`` of R rows: configurations (R, n), result (R,) bool."""


@dataclass(frozen=True, eq=False)
class ReachTable:
    """For each of N candidates and its T jaw twins: reachability, configurations and manipulability.

    T is 2 where a half turn about the tool's z axis is the same grasp (twin 0 is the stored pose, twin 1 the
    turned one), else 1. A *row* is one twin of one candidate: row r is candidate r // T, twin r % T.

    Attributes:
        candidates: what was solved.
        standoff: distance from the pre-grasp to the grasp along the approach axis [m].
        X_WG: tool poses at the grasps (N, T).
        X_WP: tool poses at the pre-grasps (N, T).
        q_grasp, q_pregrasp: configurations there (N, T, n) [rad]; the seed where none was found.
        status: (N, T), see `REASONS`.
        manipulability: at the grasps (N, T), 0 where not reached.
        seed: (N, T, n), the configuration of the arm from which the row was solved.
        columns: what else was asked for, by name (`optsc.selection.reach_columns`), each (N, T); 0 where not reached.
    """

    candidates: Candidates
    standoff: float
    X_WG: Pose
    X_WP: Pose
    q_grasp: Array
    q_pregrasp: Array
    status: np.ndarray
    manipulability: Array
    seed: Array
    columns: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("q_grasp", "q_pregrasp", "status", "manipulability", "seed"):
            object.__setattr__(self, name, _frozen(getattr(self, name)))
        columns = {name: _frozen(values) for name, values in self.columns.items()}
        object.__setattr__(self, "columns", MappingProxyType(columns))

    def __reduce__(self) -> tuple[Any, ...]:
        """Let a table pass to another process, which read-only views of dictionaries do not."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return type(self), tuple({**values, "columns": dict(self.columns)}.values())

    @property
    def twins(self) -> int:
        """T: 2 where a half turn is the same grasp, else 1."""
        return self.status.shape[1]

    @property
    def rows(self) -> int:
        """Number of rows, N times T."""
        return self.status.size

    @property
    def admissible(self) -> np.ndarray:
        """Which rows (N, T) the arm can execute."""
        return self.status == REACHED

    def rejected(self, reason: str) -> np.ndarray:
        """Return which rows (N, T) are rejected for ``reason``, one of `REASONS`; raise `UnknownName`."""
        if reason not in REASONS[1:]:
            raise UnknownName("reason", reason, REASONS[1:])
        return self.status == REASONS.index(reason)


class FoundRows(NamedTuple):
    """Configurations (R, n) of some rows (R,), their status (R,), and where the arm stood (R, n)."""

    rows: np.ndarray
    q_grasp: Array
    q_pregrasp: Array
    status: np.ndarray
    seeds: Array


class JudgedRows(NamedTuple):
    """What was found out about some rows (R,) of a table, see `ReachTable`; ``columns`` holds an array (R,) each."""

    rows: np.ndarray
    q_grasp: Array
    q_pregrasp: Array
    status: np.ndarray
    manipulability: Array
    seeds: Array
    columns: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class ReachSolver(Checked):
    """Solves reach tables of one arm: rows from scratch, or only those that an older table does not know.

    Attributes:
        robot: the arm.
        solve: inverse kinematics, see `SolveIk`.
        manipulability: the measure M of the rows.
        standoff: distance of the pre-grasp before the grasp [m]; X_WP = X_WG moved back along the approach axis.
        motion: how the tool is moved. With it rows have to be approached on a straight line, step by step; None
            asks only for a configuration at both its ends.
        columns: what else to measure, names of `optsc.selection.reach_columns`.
        refresh_angle: rows of an older table are kept if the arm stood at most this far away in every joint [rad].
    """

    robot: RobotModel
    solve: SolveIk
    manipulability: ManipulabilityMeasure
    standoff: Annotated[float, NonNegative] = 0.1
    motion: StraightMotion | None = None
    columns: frozenset[str] = frozenset()
    refresh_angle: Annotated[float, Above(0.0)] = 0.1

    def table(
        self,
        candidates: Candidates,
        q: ArrayLike,
        *,
        clear: ClearRows | None = None,
        known: ReachTable | None = None,
    ) -> ReachTable:
        """Return the reach table of all candidates as seen from the arm's configuration ``q`` (n,) [rad].

        ``clear`` is the collision check of rows that IK reached; None checks nothing. What an older table has ``known``
        of grasps that have not moved is kept; only what depends on other objects is checked again.

        Raises:
            InvalidValue: a configuration that is not finite, or a column that cannot be measured without a motion or
                a collision check that knows distances.
        """
        table, here = self.empty_table(candidates, q, clear=clear), _checked(q)
        rows, parts = np.arange(table.rows), []
        if known is not None:
            kept, of_known = self.rows_known(table, known)
            if len(kept):
                parts.append(self.judged_again(table, kept, known, of_known, clear))
                rows = np.setdiff1d(rows, kept)
        if len(rows):
            parts.append(self.solved(table, rows, here, clear))
        return with_rows(table, parts)

    def empty_table(self, candidates: Candidates, q: ArrayLike, *, clear: ClearRows | None = None) -> ReachTable:
        """Return the table of `table` with none of its rows solved; raise what that raises."""
        require_measurable(self.columns, self.motion, clear)
        here = _checked(q)
        X_WG = _twin_poses(candidates)
        seed = np.broadcast_to(here, (*X_WG.shape, len(here)))
        return ReachTable(
            candidates=candidates,
            standoff=self.standoff,
            X_WG=X_WG,
            X_WP=X_WG @ Pose.from_translation([0.0, 0.0, -self.standoff]),
            q_grasp=seed,
            q_pregrasp=seed,
            status=np.full(X_WG.shape, UNREACHABLE, dtype=np.int8),
            manipulability=np.zeros(X_WG.shape),
            seed=seed,
            columns={name: np.zeros(X_WG.shape) for name in self.columns},
        )

    def rows_known(self, table: ReachTable, known: ReachTable) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows of an empty table (R,) whose configurations an older one has, and its rows there (R,)."""
        if not table.rows or known.standoff != self.standoff or known.twins != table.twins:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        same, of_known = _rows_at_the_same_place(known, table)
        here = table.seed[:1, :1].reshape(-1)
        gap = np.abs(self.robot.difference(known.seed.reshape(-1, len(here))[of_known], here)).max(axis=1, initial=0.0)
        near = gap <= self.refresh_angle
        return same[near], of_known[near]

    def refresh(
        self, table: ReachTable, rows: ArrayLike, q: ArrayLike, *, clear: ClearRows | None = None
    ) -> ReachTable:
        """Return a new table in which some rows (R,) were solved again from the configuration ``q`` (n,) [rad].

        What is found replaces what was known, also when a row is no longer reached, and in all columns that the table
        has. Raises `InvalidValue` for a configuration that is not finite.
        """
        chosen = np.asarray(rows, dtype=np.int64)
        return with_rows(table, [self.solved(table, chosen, _checked(q), clear)]) if len(chosen) else table

    def solved(self, table: ReachTable, rows: np.ndarray, q: Array, clear: ClearRows | None) -> JudgedRows:
        """Return some rows (R,) of a table solved from the configuration ``q`` (n,) [rad]."""
        return self.judged(table, self.found(table, rows, q), clear)

    def found(self, table: ReachTable, rows: np.ndarray, q: Array) -> FoundRows:
        """Return the configurations of some rows (R,) of a table that the arm gets to from ``q`` (n,) [rad]."""
        seeds = np.repeat(q[None], len(rows), axis=0)
        q_pregrasp = seeds.copy()
        status = np.full(len(rows), PREGRASP_UNREACHABLE, dtype=np.int8)
        found, solution = _solve(self.solve, _flat(table.X_WP, rows), seeds[0])
        q_pregrasp[found] = solution[found]
        q_grasp = q_pregrasp.copy()
        status[found] = UNREACHABLE
        if self.motion is not None and len(found):
            # The configuration at the end of the line is the one the arm would have; another solution would not do.
            end, reached = self.motion.approach(q_pregrasp[found], _flat(table.X_WP, rows[found]), table.standoff)
            q_grasp[found[reached]] = end[reached]
            status[found[reached]] = REACHED
            found = found[~reached]
        reached, solution = _solve(self.solve, _flat(table.X_WG, rows[found]), q_pregrasp[found])
        q_grasp[found[reached]] = solution[reached]
        status[found[reached]] = REACHED if self.motion is None else NO_STRAIGHT_APPROACH
        return FoundRows(rows, q_grasp, q_pregrasp, status, seeds)

    def judged_again(
        self,
        table: ReachTable,
        rows: np.ndarray,
        known: ReachTable,
        of_old: np.ndarray,
        clear: ClearRows | None,
    ) -> JudgedRows:
        """Return some rows (R,) with what another table knows of them, its ``of_old`` (R,), judged by ``clear``."""
        n = known.seed.shape[-1]
        q_grasp, q_pregrasp, seeds = (
            values.reshape(-1, n)[of_old] for values in (known.q_grasp, known.q_pregrasp, known.seed)
        )
        status = known.status.ravel()[of_old]
        # What collided was reached, and may be clear now.
        status = np.where(status == COLLISION, REACHED, status).astype(np.int8)
        return self.judged(table, FoundRows(rows, q_grasp, q_pregrasp, status, seeds), clear)

    def judged(self, table: ReachTable, found: FoundRows, clear: ClearRows | None) -> JudgedRows:
        """Return what was found for some rows, checked for collisions and measured."""
        rows, q_grasp, q_pregrasp, status, seeds = found
        status = status.copy()
        usable = np.flatnonzero(status == REACHED)
        if clear is not None and len(usable):
            subset = _row_candidates(table, rows[usable])
            free = np.asarray(clear(q_grasp[usable], q_pregrasp[usable], subset), dtype=bool)
            status[usable[~free]] = COLLISION
            usable = usable[free]
        M = np.zeros(len(rows))
        if len(usable):
            M[usable] = self.manipulability.evaluate(self.robot, q_grasp[usable])
        # A measure that is not a number (an overflow at the edge of the model) is no reason to prefer a grasp.
        M[~np.isfinite(M)] = 0.0
        columns = self._columns(table, found, usable, clear) if table.columns else {}
        return JudgedRows(rows, q_grasp, q_pregrasp, status, M, seeds, columns)

    def _columns(
        self, table: ReachTable, found: FoundRows, usable: np.ndarray, clear: ClearRows | None
    ) -> dict[str, Array]:
        """Return the columns (R,) of the table for some rows, the ``usable`` ones measured."""
        names, new, rows = frozenset(table.columns), dict[str, Array](), found.rows
        if len(usable):
            candidates, which = table.candidates, rows[usable]
            reached = ReachedRows(
                self.robot,
                found.seeds[usable],
                found.q_pregrasp[usable],
                found.q_grasp[usable],
                _flat(table.X_WP, which),
                _flat(table.X_WG, which),
                np.array(candidates.object_names)[candidates.object_index[which // table.twins]],
            )
            new = measured(names, reached, self.manipulability, self.motion, clear)
        columns = {}
        for name in names:
            values = np.zeros(len(rows))
            values[usable] = new.get(name, 0.0)
            columns[name] = values
        return columns


def joined(parts: Sequence[JudgedRows]) -> JudgedRows:
    """Return several parts as one; there is at least one."""
    rows, q_grasp, q_pregrasp, status, M, seeds = (
        np.concatenate([part[k] for part in parts]) for k in range(len(JudgedRows._fields) - 1)
    )
    columns = {name: np.concatenate([part.columns[name] for part in parts]) for name in parts[0].columns}
    return JudgedRows(rows, q_grasp, q_pregrasp, status, M, seeds, columns)


def with_rows(table: ReachTable, parts: Sequence[JudgedRows]) -> ReachTable:
    """Return a table with what was found out about some of its rows."""
    if not parts:
        return table
    rows, q_grasp, q_pregrasp, status, M, seeds, columns = joined(parts)
    return replace(
        table,
        q_grasp=_with_rows(table.q_grasp, rows, q_grasp),
        q_pregrasp=_with_rows(table.q_pregrasp, rows, q_pregrasp),
        status=_with_rows(table.status, rows, status),
        manipulability=_with_rows(table.manipulability, rows, M),
        seed=_with_rows(table.seed, rows, seeds),
        columns={name: _with_rows(values, rows, columns[name]) for name, values in table.columns.items()},
    )


def _twin_poses(candidates: Candidates) -> Pose:
    stored = candidates.X_WG
    poses = [stored, stored @ HALF_TURN] if candidates.jaw_symmetric else [stored]
    return Pose(np.stack([p.quaternion for p in poses], axis=1), np.stack([p.translation for p in poses], axis=1))


def _checked(q: ArrayLike) -> Array:
    here = np.asarray(q, dtype=float)
    if here.ndim != 1 or not np.isfinite(here).all():
        raise InvalidValue("q", here.tolist(), "finite, shape (n,) [rad]")
    return here


def _solve(solve: SolveIk, X_WT: Pose, seeds: Array) -> tuple[np.ndarray, Array]:
    """Return the indices of the poses that were reached, and all configurations (R, n)."""
    if not len(X_WT):
        return np.zeros(0, dtype=np.int64), np.zeros((0, seeds.shape[-1]))
    solution = solve(X_WT, seeds)
    q = np.asarray(solution[0], dtype=float)
    success = np.asarray(solution[1], dtype=bool) & np.all(np.isfinite(q), axis=-1)
    return np.flatnonzero(success), q


def _rows_at_the_same_place(known: ReachTable, table: ReachTable) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of ``table`` whose grasp ``known`` has at exactly the same pose, and its rows there.

    Both have the same number of twins. Grasps are identified by the names of their objects and their numbers.
    """
    new, old = table.candidates, known.candidates
    found: list[np.ndarray] = [np.zeros((2, 0), dtype=np.int64)]
    for name in new.object_names:
        if name not in old.object_names:
            continue
        here = np.flatnonzero(new.object_index == new.object_names.index(name))
        there = np.flatnonzero(old.object_index == old.object_names.index(name))
        _, first, second = np.intersect1d(new.grasp_index[here], old.grasp_index[there], return_indices=True)
        found.append(np.stack([here[first], there[second]]))
    mine, its = np.concatenate(found, axis=1)
    same = np.all(new.X_WG.quaternion[mine] == old.X_WG.quaternion[its], axis=1)
    same &= np.all(new.X_WG.translation[mine] == old.X_WG.translation[its], axis=1)
    twin = np.arange(table.twins)
    rows, of_known = (candidates[same, None] * table.twins + twin for candidates in (mine, its))
    return rows.ravel(), of_known.ravel()


def _frozen(values: ArrayLike) -> np.ndarray:
    array = np.asarray(values)
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


def _flat(poses: Pose, rows: np.ndarray) -> Pose:
    return Pose(poses.quaternion.reshape(-1, 4)[rows], poses.translation.reshape(-1, 3)[rows])


def _with_rows(values: np.ndarray, rows: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return values (N, T, ...) with those of ``rows`` replaced by ``new`` (R, ...)."""
    changed = np.array(values)
    changed.reshape(-1, *new.shape[1:])[rows] = new
    changed.flags.writeable = False
    return changed


def _row_candidates(table: ReachTable, rows: np.ndarray) -> Candidates:
    """Return one candidate per row, with the pose of the row's twin."""
    return table.candidates.select(rows // table.twins, _flat(table.X_WG, rows))
