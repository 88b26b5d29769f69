"""Global inverse kinematics for many poses at once.

Every pose is first tried from its seed, so that the branch found is the one that the arm would be driven to.
What is left starts again from postures that already hold the tool near the pose: the nearest of a table of
random postures. Each round takes all poses that are left through one compiled loop
(`optsc.robot.kernels.search`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.robot.kernels.inverse import STARTS, search
from optsc.robot.kernels.kernel import BatchKernel, build_batch_kernel
from optsc.robot.kernels.kinematics import axis_of, forward_kinematics
from optsc.robot.kernels.reach import Reach, reach
from optsc.robot.limits import JointLimits
from optsc.robot.model import RobotModel

RESTARTS = 32
"""Attempts after the first: about one in 50 000 reachable poses needs more, and every impossible one pays for all."""
LOOP = 64
"""Poses in one compiled loop."""
TABLE = 512
"""Postures in a table of starts."""
FIRST_TABLE_SEED = (2307, 16523)
"""Unlike any single number, so that the tables that a caller's generator draws do not repeat the first one."""
BLOCK = 1024
"""Poses that are compared with a table at once; bounds the memory."""
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
        """Return the indices (N, STARTS) of the nearest postures, nearest first."""
        blocks = [self._nearest(features[i : i + BLOCK]) for i in range(0, max(1, len(features)), BLOCK)]
        return np.concatenate(blocks)

    def _nearest(self, features: Array) -> NDArray[np.intp]:
        distance = self.half_square - features @ self.features.T
        row = np.arange(len(features))[:, None]
        first = np.argpartition(distance, STARTS, axis=1)[:, :STARTS]
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
    search: BatchKernel
    forward: BatchKernel
    reach: Reach
    limits: JointLimits
    bounds: Array  # (2 n,) lower and upper limits, without those of joints that can make a full turn in them
    shared: tuple[Array, Array]  # bounds and limits as `search` takes them
    endless: tuple[Array, Array]  # the same where no joint has any

    def table(self, rng: np.random.Generator) -> _Table:
        """Draw a table of starts."""
        q = self.limits.clip(rng.uniform(*self.limits.sampling, size=(TABLE, self.n)))
        R, p = self.forward(q)
        quaternion = rotation.from_matrix(np.swapaxes(R.reshape(-1, 3, 3), 1, 2))
        features = _features(quaternion, p, self.folded(q))
        return _Table(q, features, 0.5 * np.einsum("ij,ij->i", features, features))

    @cached_property
    def first_table(self) -> _Table:
        """The table that every call begins with, so that drawing it costs nothing."""
        return self.table(np.random.default_rng(FIRST_TABLE_SEED))

    def folded(self, q: Array) -> Array:
        """Return the postures with turning joints in [-π, π), so that equal postures have equal numbers."""
        turns = np.isinf(self.bounds[: self.n])
        return np.where(turns, (q + np.pi) % (2.0 * np.pi) - np.pi, q)


@lru_cache(maxsize=16)
def _solver(robot: RobotModel) -> _Solver:
    lower, upper = robot.limits.lower, robot.limits.upper
    slides = np.array([axis_of(robot, i)[1] for i in range(robot.n)])
    turns = (upper - lower >= 2.0 * np.pi) & ~slides
    bounds = np.concatenate([np.where(turns, -np.inf, lower), np.where(turns, np.inf, upper)])
    return _Solver(
        n=robot.n,
        search=build_batch_kernel(search(robot), LOOP, shared=2),
        forward=build_batch_kernel(forward_kinematics(robot), LOOP),
        reach=reach(robot),
        limits=robot.limits,
        bounds=bounds,
        shared=(bounds, np.concatenate([lower, upper])),
        endless=(np.repeat([-np.inf, np.inf], robot.n),) * 2,
    )


class _Batch:
    """The poses of one call, and the best posture that was found for each so far."""

    def __init__(self, solver: _Solver, targets: Array, seeds: Array) -> None:
        self.solver, self.targets, self.seeds = solver, targets, seeds
        self.best = np.zeros((len(targets), solver.n + 3))
        self.best[:, solver.n] = np.inf

    @property
    def q(self) -> Array:
        """The postures (N, n)."""
        return self.best[:, : self.solver.n]

    @property
    def residual(self) -> Array:
        """The residuals (N,) of the postures."""
        return self.best[:, self.solver.n]

    @property
    def success(self) -> NDArray[np.bool_]:
        """Which residuals (N,) are within tolerance."""
        return self.best[:, self.solver.n + 1] > 0.0

    def of(self, index: NDArray[np.intp]) -> _Batch:
        """Return some of the poses, with what was found."""
        part = _Batch(self.solver, self.targets[index], self.seeds[index])
        part.best = self.best[index]
        return part

    def attempt(self, starts: Array, shared: tuple[Array, Array]) -> None:
        """Try the starts (N, S, n) one after another, for the poses without success; S is up to `STARTS`."""
        count, each, n = starts.shape
        rows = np.zeros((count, STARTS * n))
        rows[:, : each * n] = starts.reshape(count, each * n)
        times = np.full((count, 1), float(each))
        (self.best,) = self.solver.search(self.best, self.targets, self.seeds, rows, times, shared=shared)

    def restart(self, restarts: int, rng: np.random.Generator | None) -> NDArray[np.str_]:
        """Solve by other starts what the seeds left; return the reasons (N,) of failure."""
        solver, table = self.solver, self.solver.first_table
        quaternion, p = self.targets[:, :4], self.targets[:, 4:7]
        features = _features(quaternion, p, solver.folded(self.seeds))
        reason = np.where(solver.reach.excludes(quaternion, p), "out of reach", "not found")
        left = np.flatnonzero(reason == "not found")
        for tried in range(0, restarts, STARTS):
            if not len(left):
                break
            if tried:
                rng = np.random.default_rng(0) if rng is None else rng
                table = solver.table(rng)
            part = self.of(left)
            starts = table.q[table.nearest(features[left])[:, : restarts - tried]]
            part.attempt(starts, solver.shared)
            self.best[left] = part.best
            left = left[~part.success]
        if restarts and len(left):
            reason[self._behind_limits(left, features[left])] = "joint limits"
        reason[self.success] = ""
        return reason

    def _behind_limits(self, index: NDArray[np.intp], features: Array) -> NDArray[np.intp]:
        """Return those of the poses ``index`` that are solved only when the limits are ignored."""
        solver = self.solver
        free = _Batch(solver, self.targets[index], self.seeds[index])
        table = solver.first_table
        free.attempt(table.q[table.nearest(features)[:, :LIMIT_PROBES]], solver.endless)
        found = index[free.success]
        # From a posture outside the way may still lead inside; then the pose is solved after all.
        inside = np.clip(free.q[free.success], solver.bounds[: solver.n], solver.bounds[solver.n :])
        part = self.of(found)
        part.attempt(inside[:, None], solver.shared)
        self.best[found] = part.best
        return found[~part.success]


def _checked_targets(X_WT: Pose, tolerance: float) -> Array:
    """Return rows (N, 8) as the attempts take them."""
    if not 0.0 < tolerance < np.inf:
        raise InvalidValue("tolerance", tolerance, "positive and finite [m and rad]")
    targets = np.empty((math.prod(X_WT.shape), 8))
    targets[:, :4] = X_WT.quaternion.reshape(-1, 4)
    targets[:, 4:7] = X_WT.translation.reshape(-1, 3)
    targets[:, 7] = tolerance
    if not np.isfinite(targets).all():
        raise InvalidValue("X_WT", X_WT.matrix().tolist(), "finite")
    return targets


def _checked_seeds(robot: RobotModel, seeds: ArrayLike | None, shape: tuple[int, ...]) -> Array:
    """Return one seed (N, n) for each pose, inside the limits."""
    q, n = robot.home, len(robot.home)
    if seeds is not None:
        q = robot.checked(seeds, "seeds")
        if q.ndim != 1 and q.shape[:-1] != shape:
            raise InvalidValue("shape of seeds", q.shape, f"({n},) or {(*shape, n)}")
        q = robot.limits.clip(q)
    return q.reshape(-1, n) if q.ndim > 1 else np.repeat(q[None], math.prod(shape), axis=0)


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
    solver = _solver(robot)
    batch = _Batch(solver, targets, _checked_seeds(robot, seeds, shape))
    batch.attempt(batch.seeds[:, None], solver.shared)
    reason = np.zeros(len(targets), dtype=_REASON)
    if not batch.success.all():
        unsolved = np.flatnonzero(~batch.success)
        part = batch.of(unsolved)
        reason[unsolved] = part.restart(restarts, rng)
        batch.best[unsolved] = part.best
    return IkSolutions(
        q=batch.q.copy().reshape(*shape, solver.n),
        success=batch.success.reshape(shape),
        residual=batch.residual.reshape(shape),
        reason=reason.reshape(shape),
    )
