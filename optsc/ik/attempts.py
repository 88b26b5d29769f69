"""Attempts at the poses of a call: what is compiled and drawn once for an arm, and the best that was found."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from optsc.geometry import rotation
from optsc.geometry.rotation import Array
from optsc.ik.reach import Reach, reach
from optsc.ik.starts import FIRST_TABLE_SEED, TABLE, StartTable, features
from optsc.kernels.chain import forward_kinematics
from optsc.kernels.kernel import BatchKernel, Kernel, build_batch_kernel, build_kernel
from optsc.kernels.search import STARTS, search
from optsc.robot.limits import JointLimits
from optsc.robot.model import RobotModel

LOOP = 64
"""Poses in one compiled loop."""


@dataclass(frozen=True, eq=False)
class Solver:
    """What is built once for an arm; its parts when they are first needed.

    Attributes:
        robot: the arm.
        reach: how far it can be reached at most.
        bounds: lower and upper limits (2 n,), without those of joints that can make a full turn in them.
        shared: bounds and limits as the compiled search takes them.
        endless: the same where no joint has any.
    """

    robot: RobotModel
    reach: Reach
    bounds: Array
    shared: tuple[Array, Array]
    endless: tuple[Array, Array]

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    @property
    def limits(self) -> JointLimits:
        """The limits of the arm."""
        return self.robot.limits

    @cached_property
    def search(self) -> BatchKernel:
        """Attempts with one tolerance for all components."""
        return build_batch_kernel(search(self.robot.chain), LOOP, shared=2)

    @cached_property
    def search_by_component(self) -> BatchKernel:
        """Attempts with six tolerances."""
        return build_batch_kernel(search(self.robot.chain, by_component=True), LOOP, shared=2)

    @cached_property
    def search_one(self) -> Kernel:
        """Attempts at a single pose with one tolerance, without the way into and out of a loop."""
        kernel = build_kernel(search(self.robot.chain))
        kernel.inputs[5][:], kernel.inputs[6][:] = self.shared
        return kernel

    @cached_property
    def lock(self) -> threading.Lock:
        """To be held while the memory of `search_one` is in use."""
        return threading.Lock()

    @cached_property
    def nothing(self) -> Array:
        """What was found for a pose (n + 3,) before the first attempt."""
        return np.concatenate([np.zeros(self.n), [np.inf, 0.0, 0.0]])

    @cached_property
    def forward(self) -> BatchKernel:
        """Forward kinematics."""
        return build_batch_kernel(forward_kinematics(self.robot.chain), LOOP)

    def table(self, rng: np.random.Generator) -> StartTable:
        """Draw a table of starts."""
        q = self.limits.clip(rng.uniform(*self.limits.sampling, size=(TABLE, self.n)))
        R, p = self.forward(q)
        quaternion = rotation.from_matrix(np.swapaxes(R.reshape(-1, 3, 3), 1, 2))
        found = features(quaternion, p, self.folded(q))
        return StartTable(q, found, 0.5 * np.einsum("ij,ij->i", found, found))

    @cached_property
    def first_table(self) -> StartTable:
        """The table that every call begins with, so that drawing it costs nothing."""
        return self.table(np.random.default_rng(FIRST_TABLE_SEED))

    @cached_property
    def turns(self) -> NDArray[np.bool_]:
        """Which joints (n,) can make a full turn within their limits."""
        return np.isinf(self.bounds[: self.n])

    def folded(self, q: Array) -> Array:
        """Return the postures with turning joints in [-π, π), so that equal postures have equal numbers."""
        if not self.turns.any():
            return q
        return np.where(self.turns, (q + np.pi) % (2.0 * np.pi) - np.pi, q)


@lru_cache(maxsize=16)
def solver_of(robot: RobotModel) -> Solver:
    """Return the solver of an arm."""
    lower, upper = robot.limits.lower, robot.limits.upper
    slides = np.array(robot.chain.slides)
    turns = (upper - lower >= 2.0 * np.pi) & ~slides
    bounds = np.concatenate([np.where(turns, -np.inf, lower), np.where(turns, np.inf, upper)])
    return Solver(
        robot=robot,
        reach=reach(robot),
        bounds=bounds,
        shared=(bounds, np.concatenate([lower, upper])),
        endless=(np.repeat([-np.inf, np.inf], robot.n),) * 2,
    )


class Batch:
    """The poses of one call, and the best posture that was found for each so far.

    Attributes:
        solver: of the arm.
        targets: (N, 8) or (N, 13), as `optsc.kernels.search` takes them.
        seeds: (N, n), the postures near which turning joints end.
        best: (N, n + 3): posture, residual, success, iterations.
    """

    def __init__(self, solver: Solver, targets: Array, seeds: Array) -> None:
        self.solver, self.targets, self.seeds = solver, targets, seeds
        self.best = np.tile(solver.nothing, (len(targets), 1))

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
        """Which postures (N,) are solutions."""
        return self.best[:, self.solver.n + 1] > 0.0

    @property
    def by_component(self) -> bool:
        """Whether there is a tolerance for each component."""
        return self.targets.shape[1] > 8

    def of(self, index: NDArray[np.intp]) -> Batch:
        """Return some of the poses, with what was found."""
        part = self.fresh(index)
        part.best = self.best[index]
        return part

    def fresh(self, index: NDArray[np.intp]) -> Batch:
        """Return some of the poses, with nothing found."""
        return Batch(self.solver, self.targets[index], self.seeds[index])

    def wanted(self) -> Array:
        """Return the features (N, ...) that starts should have."""
        return features(self.targets[:, :4], self.targets[:, 4:7], self.solver.folded(self.seeds))

    def attempt(self, starts: Array, shared: tuple[Array, Array] | None = None) -> None:
        """Try the starts (N, S, n) one after another, for the poses without success."""
        count, each, n = starts.shape
        for tried in range(0, each, STARTS):
            now = min(STARTS, each - tried)
            rows = np.zeros((count, STARTS * n))
            rows[:, : now * n] = starts[:, tried : tried + now].reshape(count, now * n)
            times = np.full((count, 1), float(now))
            kernel = self.solver.search_by_component if self.by_component else self.solver.search
            bounds = self.solver.shared if shared is None else shared
            (self.best,) = kernel(self.best, self.targets, self.seeds, rows, times, shared=bounds)
