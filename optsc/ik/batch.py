"""Global inverse kinematics for many poses at once.

Every pose is first tried from its seed, so that the branch found is the one that the arm would be driven to.
What is left starts again from postures that already hold the tool near the pose: the nearest of a table of
random postures. Each round takes all poses that are left through one compiled loop
(`optsc.robot.kernels.attempt`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.robot.kernels import inverse
from optsc.robot.kernels.kernel import BatchKernel, build_batch_kernel
from optsc.robot.kernels.kinematics import axis_of, forward_kinematics
from optsc.robot.kernels.reach import Reach, reach
from optsc.robot.limits import JointLimits
from optsc.robot.model import RobotModel

RESTARTS = 48
"""Attempts after the first, for poses that need them."""
LOOP = 64
"""Poses in one compiled loop."""
TABLE = 512
"""Postures in a table of starts."""
BLOCK = 1024
"""Poses that are compared with a table at once; bounds the memory."""
STARTS_PER_TABLE = 8
"""How many of the nearest postures of a table are tried before a new table is drawn."""
TURN_LENGTH = 0.4
"""In choosing starts, a turn of the tool by one radian weighs as much as this distance [m] of it."""
JOINT_LENGTH = 0.1
"""In choosing starts, a joint one radian off the seed weighs as much as this distance [m] of the tool."""
TOLERANCE = 1e-5
"""Greatest component of the pose error of a solution [m and rad], as in the protocol of TRAC-IK."""
LIMIT_PROBES = 4
"""Attempts without limits, which tell poses behind the limits from poses that were not found."""

_REASON = "<U12"


class IkSolutions(NamedTuple):
    """Postures for N poses.

    Attributes:
        q: (N, n), inside the limits; where there was no success, the posture of least residual that was met.
        success: (N,) bool: the residual is within tolerance.
        residual: (N,) largest component of the pose error (p* - p, log(R* Rᵀ)) at q [m and rad].
        reason: (N,) text: empty on success; "out of reach": further away than the arm is long; "joint
            limits": only postures outside the limits were found; "not found": none at all.
    """

    q: Array
    success: NDArray[np.bool_]
    residual: Array
    reason: NDArray[np.str_]


@dataclass(frozen=True, eq=False)
class _Table:
    """Postures to start from, and what tells how near they are to a pose and a seed."""

    q: Array  # (M, n)
    features: Array  # (M, 19 + n)
    half_square: Array  # (M,)

    def nearest(self, features: Array) -> NDArray[np.intp]:
        """Return the indices (N, STARTS_PER_TABLE) of the nearest postures, nearest first."""
        blocks = [self._nearest(features[i : i + BLOCK]) for i in range(0, max(1, len(features)), BLOCK)]
        return np.concatenate(blocks)

    def _nearest(self, features: Array) -> NDArray[np.intp]:
        distance = self.half_square - features @ self.features.T
        row = np.arange(len(features))[:, None]
        first = np.argpartition(distance, STARTS_PER_TABLE, axis=1)[:, :STARTS_PER_TABLE]
        return first[row, np.argsort(distance[row, first], axis=1, kind="stable")]


def _features(quaternion: Array, p: Array, q: Array) -> Array:
    """Return vectors (N, 19 + n) [m] whose distance is small where tools and postures are near.

    Rotations enter as c cᵀ of their quaternions c, which has no sign; two are √2 sin(angle / 2) apart.
    """
    c = quaternion * np.sqrt(np.sqrt(2.0) * TURN_LENGTH)
    square = (c[:, :, None] * c[:, None, :]).reshape(-1, 16)
    return np.concatenate([square, p, np.broadcast_to(q * JOINT_LENGTH, (len(p), q.shape[1]))], axis=1)


@dataclass(frozen=True, eq=False)
class _Solver:
    """What is built once for an arm."""

    n: int
    limits: JointLimits
    attempt: BatchKernel
    forward: BatchKernel
    reach: Reach
    turns: NDArray[np.bool_]  # (n,) joints that can make a full turn inside their limits
    bounds: Array  # (2 n,) lower and upper limits, without those of joints that can make a full turn
    endless: Array  # (2 n,) the same without any

    def run(self, targets: Array, starts: Array, bounds: Array) -> Array:
        """Return the states (N, n + STATE_ROWS) in which the attempts end, see `inverse.attempt`."""
        states = np.empty((len(targets), self.n + inverse.STATE_ROWS))
        states[:, : self.n] = starts
        states[:, self.n :] = (inverse.RUNNING, np.inf, 0.0, 0.0, np.inf)
        return self.attempt(states, targets, shared=(bounds,))[0]

    def table(self, rng: np.random.Generator) -> _Table:
        """Draw a table of starts."""
        lower, upper = self.limits.sampling
        q = rng.uniform(lower, upper, size=(TABLE, self.n))
        R, p = self.forward(q)
        quaternion = rotation.from_matrix(np.swapaxes(R.reshape(-1, 3, 3), 1, 2))
        features = _features(quaternion, p, self.folded(q))
        return _Table(q, features, 0.5 * np.einsum("ij,ij->i", features, features))

    @cached_property
    def first_table(self) -> _Table:
        """The table that every call begins with, so that drawing it costs nothing."""
        return self.table(np.random.default_rng(0))

    def inside(self, q: Array) -> NDArray[np.bool_]:
        """Tell which postures (N, n) are inside the bounds."""
        return np.all((q >= self.bounds[: self.n]) & (q <= self.bounds[self.n :]), axis=1)

    def folded(self, q: Array) -> Array:
        """Return the postures with turning joints in [-π, π), so that equal postures have equal numbers."""
        return np.where(self.turns, (q + np.pi) % (2.0 * np.pi) - np.pi, q)

    def unwound(self, q: Array, seeds: Array) -> Array:
        """Return the same postures inside the limits, turning joints as near to the seeds as they permit."""
        lower, upper = self.limits.lower, self.limits.upper
        if not self.turns.any():
            return q
        turn = 2.0 * np.pi
        near = q - turn * np.round((q - seeds) / turn)
        near += turn * np.ceil(np.maximum(lower - near, 0.0) / turn)
        near -= turn * np.ceil(np.maximum(near - upper, 0.0) / turn)
        return np.clip(np.where(self.turns, near, q), lower, upper)


@lru_cache(maxsize=16)
def _solver(robot: RobotModel) -> _Solver:
    lower, upper = robot.limits.lower, robot.limits.upper
    slides = np.array([axis_of(robot, i)[1] for i in range(robot.n)])
    turns = (upper - lower >= 2.0 * np.pi) & ~slides
    return _Solver(
        n=robot.n,
        limits=robot.limits,
        attempt=build_batch_kernel(inverse.attempt(robot), LOOP, shared=1),
        forward=build_batch_kernel(forward_kinematics(robot), LOOP),
        reach=reach(robot),
        turns=turns,
        bounds=np.concatenate([np.where(turns, -np.inf, lower), np.where(turns, np.inf, upper)]),
        endless=np.repeat([-np.inf, np.inf], robot.n),
    )


class _Search:
    """The poses of one call that their seeds did not solve, and the best that was found for each so far."""

    def __init__(self, solver: _Solver, targets: Array, seeds: Array, best: Array) -> None:
        self.solver, self.targets, self.best = solver, targets, best
        quaternion, p = targets[:, :4], targets[:, 4:7]
        self.features = _features(quaternion, p, solver.folded(seeds))
        self.out_of_reach = solver.reach.excludes(quaternion, p)

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Which poses (N,) have a solution by now."""
        return self.best[:, self.solver.n] == inverse.SOLVED

    @property
    def left(self) -> NDArray[np.intp]:
        """Indices of the poses that another attempt may solve."""
        return np.flatnonzero(~(self.solved | self.out_of_reach))

    def restart(self, table: _Table, times: int) -> None:
        """Try the poses that are left from the nearest ``times`` starts of a table."""
        index = self.left
        starts = table.nearest(self.features[index])
        for start in range(times):
            after = self.solver.run(self.targets[index], table.q[starts[:, start]], self.solver.bounds)
            better = after[:, -1] < self.best[index, -1]
            self.best[index[better]] = after[better]
            pending = after[:, self.solver.n] != inverse.SOLVED
            index, starts = index[pending], starts[pending]
            if not len(index):
                return

    def beyond_limits(self, table: _Table) -> NDArray[np.bool_]:
        """Tell for each pose whether ignoring the limits gives a posture, and that posture lies outside them.

        One that lies inside is a solution after all.
        """
        index, n = self.left, self.solver.n
        beyond = np.zeros(len(self.best), dtype=bool)
        starts = table.nearest(self.features[index])[:, :LIMIT_PROBES]
        for start in starts.T:
            after = self.solver.run(self.targets[index], table.q[start], self.solver.endless)
            found = after[:, n] == inverse.SOLVED
            inside = found & self.solver.inside(after[:, :n])
            self.best[index[inside]] = after[inside]
            beyond[index[found & ~inside]] = True
        return beyond


def _checked_targets(X_WT: Pose, tolerance: float) -> Array:
    """Return rows (N, 8) as the attempts take them."""
    if not 0.0 < tolerance < np.inf:
        raise InvalidValue("tolerance", tolerance, "positive and finite [m and rad]")
    targets = np.empty((int(np.prod(X_WT.shape)), 8))
    targets[:, :4] = X_WT.quaternion.reshape(-1, 4)
    targets[:, 4:7] = X_WT.translation.reshape(-1, 3)
    targets[:, 7] = tolerance
    if not np.isfinite(targets).all():
        raise InvalidValue("X_WT", X_WT.matrix().tolist(), "finite")
    return targets


def _checked_seeds(robot: RobotModel, seeds: ArrayLike | None, shape: tuple[int, ...]) -> Array:
    """Return one seed (1, n) for all poses, or one each (N, n)."""
    if seeds is None:
        return robot.home[None]
    q = robot.checked(seeds, "seeds")
    if q.shape[:-1] not in ((), shape):
        raise InvalidValue("shape of seeds", q.shape, f"({robot.n},) or {(*shape, robot.n)}")
    return robot.limits.clip(q).reshape(-1, robot.n)


def _restarted(search: _Search, restarts: int, rng: np.random.Generator | None) -> NDArray[np.str_]:
    """Solve what the seeds left, in the search's own rows; return the reasons of failure."""
    reason = np.where(search.out_of_reach, "out of reach", "not found")
    table = search.solver.first_table
    for tried in range(0, restarts, STARTS_PER_TABLE):
        if tried:
            rng = np.random.default_rng(0) if rng is None else rng
            table = search.solver.table(rng)
        search.restart(table, min(STARTS_PER_TABLE, restarts - tried))
        if not len(search.left):
            break
    else:
        if restarts:
            reason[search.beyond_limits(search.solver.first_table)] = "joint limits"
    reason[search.solved] = ""
    return reason


def solve_ik(
    robot: RobotModel,
    X_WT: Pose,
    *,
    rng: np.random.Generator | None = None,
    seeds: ArrayLike | None = None,
    restarts: int = RESTARTS,
    tolerance: float = TOLERANCE,
) -> IkSolutions:
    """Return a posture inside the limits for each pose of the tool.

    The results depend on the arguments and the state of ``rng`` alone.

    Args:
        robot: the arm.
        X_WT: the poses, of any batch shape (N,); the results have the same.
        rng: draws further starts for the few poses that the fixed first table of starts does not solve; None
            stands for a generator of fixed seed.
        seeds: posture(s) (n,) or (N, n) to start from, by default the robot's home; moved into the limits. A
            joint that can make full turns ends within half a turn of its seed, as far as limits permit.
        restarts: greatest number of attempts from other starts, for poses that their seeds do not solve.
        tolerance: greatest component of the pose error that counts as success [m and rad].

    Raises:
        InvalidValue: a pose or seed is not finite, or a shape, the tolerance or ``restarts`` is impossible.
    """
    if restarts < 0:
        raise InvalidValue("restarts", restarts, "zero or more")
    shape, targets = X_WT.shape, _checked_targets(X_WT, tolerance)
    start = _checked_seeds(robot, seeds, shape)
    solver = _solver(robot)
    n = solver.n
    best = solver.run(targets, start, solver.bounds)
    reason = np.zeros(len(targets), dtype=_REASON)
    unsolved = np.flatnonzero(best[:, n] != inverse.SOLVED)
    if len(unsolved):
        own = start if len(start) == 1 else start[unsolved]
        search = _Search(solver, targets[unsolved], own, best[unsolved])
        reason[unsolved] = _restarted(search, restarts, rng)
        best[unsolved] = search.best
    return IkSolutions(
        q=solver.unwound(best[:, :n], start).reshape(*shape, n),
        success=(best[:, n] == inverse.SOLVED).reshape(shape),
        residual=best[:, -1].reshape(shape),
        reason=reason.reshape(shape),
    )
