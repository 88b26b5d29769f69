"""The reach table: which grasps the arm can carry out, how it would stand, and how well it could move there.

Solving it belongs to the scene clock; ranking only reads it. Rows are solved in the order in which the arm
moves: the pre-grasp from the posture at hand, then the grasp from the pre-grasp's posture. So the
manipulability of a row is the one at the posture that would be driven to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.geometry.rotation import Array

if TYPE_CHECKING:
    from optsc.grasps import Candidates
    from optsc.robot import RobotModel

REACHED, UNREACHABLE, PREGRASP_UNREACHABLE, COLLISION = range(4)
REASONS = ("", "unreachable", "pre-grasp unreachable", "collision")
"""Why a row cannot be used, in words, by its status."""

HALF_TURN = Pose.from_quaternion([0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
"""The jaws' symmetry: half a turn about the tool's z axis."""

SolveIk: TypeAlias = Callable[[Pose, Array], Any]
"""Inverse kinematics ``solve(X_WT, seeds)`` of R poses from seeds (n,) or (R, n): returns a tuple that begins
with postures (R, n) and success (R,)."""
ClearRows: TypeAlias = Callable[[Array, Array, "Candidates"], np.ndarray]
"""Collision check ``clear(q_grasp, q_pregrasp, candidates)`` of R rows: postures (R, n), result (R,) bool."""


class Measure(Protocol):
    """How well the arm can move: `optsc.robot.manipulability.Manipulability`, or anything alike."""

    def evaluate(self, robot: RobotModel, q: Array) -> Array:
        """Return the measure (...) at postures ``q`` (..., n); higher is better."""


def _frozen(values: ArrayLike) -> np.ndarray:
    array = np.asarray(values)
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class ReachTable:
    """For each of N candidates and its T jaw twins: reachability, postures and manipulability.

    T is 2 where a half turn about the tool's z axis is the same grasp (twin 0 is the stored pose, twin 1 the
    turned one), else 1. A *row* is one twin of one candidate: row r is candidate r // T, twin r % T.

    Attributes:
        candidates: what was solved.
        standoff: distance from the pre-grasp to the grasp along the approach axis [m].
        X_WG: tool poses at the grasps (N, T).
        X_WP: tool poses at the pre-grasps (N, T).
        q_grasp, q_pregrasp: postures there (N, T, n) [rad]; the seed where none was found.
        status: (N, T), see `REASONS`.
        manipulability: at the grasps (N, T), 0 where not reached.
        seed: (N, T, n), the posture of the arm from which the row was solved.
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

    def __post_init__(self) -> None:
        for name in ("q_grasp", "q_pregrasp", "status", "manipulability", "seed"):
            object.__setattr__(self, name, _frozen(getattr(self, name)))

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
        """Which rows (N, T) the arm can carry out."""
        return self.status == REACHED

    def rejected(self, reason: str) -> np.ndarray:
        """Return which rows (N, T) are rejected for ``reason``, one of `REASONS`; raise `UnknownName`."""
        if reason not in REASONS[1:]:
            raise UnknownName("reason", reason, REASONS[1:])
        return self.status == REASONS.index(reason)


def _twin_poses(candidates: Candidates) -> Pose:
    stored = candidates.X_WG
    poses = [stored, stored @ HALF_TURN] if candidates.jaw_symmetric else [stored]
    return Pose(
        np.stack([p.quaternion for p in poses], axis=1), np.stack([p.translation for p in poses], axis=1)
    )


def solve_reach(
    robot: RobotModel,
    candidates: Candidates,
    q: ArrayLike,
    *,
    solve: SolveIk,
    manipulability: Measure,
    standoff: float = 0.10,
    clear: ClearRows | None = None,
) -> ReachTable:
    """Return the reach table of all candidates as seen from the arm's posture.

    Args:
        robot: the arm.
        candidates: the grasps, placed in the world.
        q: the arm's present posture (n,) [rad].
        solve: inverse kinematics, see `SolveIk`.
        manipulability: the measure M of the rows.
        standoff: distance of the pre-grasp before the grasp [m]; X_WP = X_WG moved back along the approach
            axis.
        clear: collision check of rows that IK reached; None checks nothing.

    Raises:
        InvalidValue: a posture that is not finite, or a negative standoff.
    """
    if not 0.0 <= standoff < np.inf:
        raise InvalidValue("standoff", standoff, "0 m or more")
    posture = np.asarray(q, dtype=float)
    X_WG = _twin_poses(candidates)
    seed = np.broadcast_to(posture, (*X_WG.shape, posture.shape[-1]))
    table = ReachTable(
        candidates=candidates,
        standoff=standoff,
        X_WG=X_WG,
        X_WP=X_WG @ Pose.from_translation([0.0, 0.0, -standoff]),
        q_grasp=seed,
        q_pregrasp=seed,
        status=np.full(X_WG.shape, UNREACHABLE, dtype=np.int8),
        manipulability=np.zeros(X_WG.shape),
        seed=seed,
    )
    rows = np.arange(table.rows)
    return refresh(table, rows, posture, robot=robot, solve=solve, manipulability=manipulability, clear=clear)


def refresh(
    table: ReachTable,
    rows: ArrayLike,
    q: ArrayLike,
    *,
    robot: RobotModel,
    solve: SolveIk,
    manipulability: Measure,
    clear: ClearRows | None = None,
) -> ReachTable:
    """Return a new table in which some rows (R,) were solved anew from the posture ``q`` (n,) [rad].

    What is found replaces what was known, also when a row is no longer reached. Raises `InvalidValue` for a
    posture that is not finite.
    """
    posture, rows = np.asarray(q, dtype=float), np.asarray(rows, dtype=np.int64)
    if posture.ndim != 1 or not np.all(np.isfinite(posture)):
        raise InvalidValue("q", posture.tolist(), "finite, shape (n,) [rad]")
    n = len(posture)
    q_pregrasp = np.tile(posture, (len(rows), 1))
    status = np.full(len(rows), PREGRASP_UNREACHABLE, dtype=np.int8)
    found, solution = _solved(solve, _flat(table.X_WP, rows), posture)
    q_pregrasp[found] = solution[found]
    q_grasp = q_pregrasp.copy()
    status[found] = UNREACHABLE
    reached, solution = _solved(solve, _flat(table.X_WG, rows[found]), q_pregrasp[found])
    q_grasp[found[reached]] = solution[reached]
    found = found[reached]
    status[found] = REACHED
    if clear is not None and len(found):
        subset = _row_candidates(table, rows[found])
        free = np.asarray(clear(q_grasp[found], q_pregrasp[found], subset), dtype=bool)
        status[found[~free]] = COLLISION
        found = found[free]
    M = np.zeros(len(rows))
    if len(found):
        M[found] = manipulability.evaluate(robot, q_grasp[found])
    # A measure that is not a number (an overflow at the edge of the model) is no reason to prefer a grasp.
    M[~np.isfinite(M)] = 0.0
    return replace(
        table,
        q_grasp=_with_rows(table.q_grasp, rows, q_grasp, (-1, n)),
        q_pregrasp=_with_rows(table.q_pregrasp, rows, q_pregrasp, (-1, n)),
        status=_with_rows(table.status, rows, status, (-1,)),
        manipulability=_with_rows(table.manipulability, rows, M, (-1,)),
        seed=_with_rows(table.seed, rows, posture, (-1, n)),
    )


def _solved(solve: SolveIk, X_WT: Pose, seeds: Array) -> tuple[np.ndarray, Array]:
    """Return the indices of the poses that were reached, and all postures (R, n)."""
    if not len(X_WT):
        return np.zeros(0, dtype=np.int64), np.zeros((0, seeds.shape[-1]))
    solution = solve(X_WT, seeds)
    postures = np.asarray(solution[0], dtype=float)
    success = np.asarray(solution[1], dtype=bool) & np.all(np.isfinite(postures), axis=-1)
    return np.flatnonzero(success), postures


def _flat(poses: Pose, rows: np.ndarray) -> Pose:
    return Pose(poses.quaternion.reshape(-1, 4)[rows], poses.translation.reshape(-1, 3)[rows])


def _with_rows(values: np.ndarray, rows: np.ndarray, new: ArrayLike, flat: tuple[int, ...]) -> np.ndarray:
    changed = np.array(values)
    changed.reshape(flat)[rows] = new
    changed.flags.writeable = False
    return changed


def _row_candidates(table: ReachTable, rows: np.ndarray) -> Candidates:
    """Return one candidate per row, with the pose of the row's twin."""
    candidates, index = table.candidates, rows // table.twins
    return replace(
        candidates,
        object_index=candidates.object_index[index],
        grasp_index=candidates.grasp_index[index],
        X_WG=_flat(table.X_WG, rows),
        opening=candidates.opening[index],
        quality=candidates.quality[index],
    )
