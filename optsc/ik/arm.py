"""What inverse kinematics of whole poses needs of an arm: bound of its reach, table of starts, compiled search."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from optsc.geometry import rotation
from optsc.geometry.rotation import Array
from optsc.ik.reach_bound import ReachBound
from optsc.kernels.chain import forward_kinematics
from optsc.kernels.kernel import BatchKernel, Kernel, build_batch_kernel, build_kernel
from optsc.kernels.search import search
from optsc.robot.limits import JointLimits
from optsc.robot.model import RobotModel

POSES_PER_LOOP = 64
"""Poses in one compiled loop."""
TABLE_SIZE = 512
"""Configurations in a table of starts."""
FIRST_TABLE_SEED = (2307, 16523)
"""Unlike any single number, so that the tables that a caller's generator draws do not repeat the first one."""
ROWS, HALF = 16, TABLE_SIZE // 2
"""Poses, and for a single pose starts, that are compared at once: products so small that no BLAS library shares them
among threads, whose meeting takes longer than the product."""
TURN_LENGTH = 0.4
"""In choosing starts, a turn of the tool by one radian weighs as much as this distance [m] of it."""
JOINT_LENGTH = 0.1
"""In choosing starts, a joint one radian off the seed weighs as much as this distance [m] of the tool."""

_I, _J = np.triu_indices(4)
_WEIGHTS = np.sqrt(2.0) * TURN_LENGTH * np.where(_I == _J, 1.0, np.sqrt(2.0))


def features(quaternion: Array, p: Array, q: Array) -> Array:
    """Return vectors (N, 13 + n) [m] whose distance is small where tools and configurations are near.

    Rotations enter as c cᵀ of their quaternions c, which has no sign; two are √2 sin(angle / 2) apart. It is
    symmetric, so one triangle will do, in which what stands for two entries is weighted by √2.
    """
    square = quaternion[:, _I] * quaternion[:, _J] * _WEIGHTS
    return np.concatenate([square, p, np.broadcast_to(q * JOINT_LENGTH, (len(p), q.shape[1]))], axis=1)


@dataclass(frozen=True, eq=False)
class StartTable:
    """Random configurations to start from; those near a pose already hold the tool near it.

    Attributes:
        q: the configurations (M, n).
        features: their `features` (M, 13 + n).
        half_square: half the square of the features' lengths (M,).
    """

    q: Array
    features: Array
    half_square: Array

    def nearest(self, wanted: Array, count: int) -> NDArray[np.intp]:
        """Return the indices (N, count) of the starts nearest to features (N, 13 + n), nearest first."""
        blocks = [self._nearest(wanted[i : i + ROWS], count) for i in range(0, max(1, len(wanted)), ROWS)]
        return np.concatenate(blocks)

    def _nearest(self, wanted: Array, count: int) -> NDArray[np.intp]:
        distance = self.half_square - wanted @ self.features.T
        row = np.arange(len(wanted))[:, None]
        first = np.argpartition(distance, count, axis=1)[:, :count]
        return first[row, np.argsort(distance[row, first], axis=1, kind="stable")]

    def nearest_to_one(self, quaternion: Array, p: Array, q: Array, count: int) -> Array:
        """Return the starts (count, n) nearest to one pose (4,), (3,) and seed (n,), without the cost of many."""
        wanted = np.concatenate((quaternion[_I] * quaternion[_J] * _WEIGHTS, p, q * JOINT_LENGTH))
        distance = self.half_square.copy()
        distance[:HALF] -= self.features[:HALF].dot(wanted)
        distance[HALF:] -= self.features[HALF:].dot(wanted)
        first = distance.argpartition(count)[:count]
        return self.q[first[distance[first].argsort(kind="stable")]]


@dataclass(frozen=True, eq=False)
class ArmSearch:
    """The compiled search of an arm; its parts are built when they are first needed.

    Attributes:
        robot: the arm.
        reach: which poses it cannot possibly reach.
        bounds: lower and upper limits (2 n,), without those of joints that can make a full turn in them.
        shared: bounds and limits as the compiled search takes them.
        endless: the same where no joint has any.
        lock: to be held while the buffers of `search_one` are in use.
    """

    robot: RobotModel
    reach: ReachBound
    bounds: Array
    shared: tuple[Array, Array]
    endless: tuple[Array, Array]
    lock: threading.Lock

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
        return build_batch_kernel(search(self.robot.chain), POSES_PER_LOOP, shared=2)

    @cached_property
    def search_by_component(self) -> BatchKernel:
        """Attempts with six tolerances."""
        return build_batch_kernel(search(self.robot.chain, by_component=True), POSES_PER_LOOP, shared=2)

    @cached_property
    def search_one(self) -> Kernel:
        """Attempts at a single pose with one tolerance, without the cost of a loop."""
        kernel = build_kernel(search(self.robot.chain))
        kernel.inputs[5][:], kernel.inputs[6][:] = self.shared
        return kernel

    @cached_property
    def nothing(self) -> Array:
        """What was found for a pose (n + 3,) before the first attempt."""
        return np.concatenate([np.zeros(self.n), [np.inf, 0.0, 0.0]])

    @cached_property
    def _forward(self) -> BatchKernel:
        return build_batch_kernel(forward_kinematics(self.robot.chain), POSES_PER_LOOP)

    def table(self, rng: np.random.Generator) -> StartTable:
        """Draw a table of starts."""
        q = self.limits.clip(rng.uniform(*self.limits.sampling, size=(TABLE_SIZE, self.n)))
        R, p = self._forward(q)
        quaternion = rotation.from_matrix(np.swapaxes(R.reshape(-1, 3, 3), 1, 2))
        found = features(quaternion, p, self.folded(q))
        return StartTable(q, found, 0.5 * np.einsum("ij,ij->i", found, found))

    @cached_property
    def first_table(self) -> StartTable:
        """The table that every call begins with, so that drawing it costs nothing."""
        return self.table(np.random.default_rng(FIRST_TABLE_SEED))

    def further_tables(self, rng: np.random.Generator | None) -> Iterator[StartTable]:
        """Draw tables of starts, by a generator of fixed seed where none is given."""
        if rng is None:
            yield self._second_table
            rng = np.random.default_rng(0)
            self.table(rng)  # that one again
        while True:
            yield self.table(rng)

    @cached_property
    def _second_table(self) -> StartTable:
        """What a generator of fixed seed draws first: hardly any pose needs more."""
        return self.table(np.random.default_rng(0))

    @cached_property
    def turns(self) -> NDArray[np.bool_]:
        """Which joints (n,) can make a full turn within their limits."""
        return np.isinf(self.bounds[: self.n])

    def folded(self, q: Array) -> Array:
        """Return configurations with turning joints in [-π, π), so that equal ones have equal numbers."""
        if not self.turns.any():
            return q
        return np.where(self.turns, (q + np.pi) % (2.0 * np.pi) - np.pi, q)


@lru_cache(maxsize=16)
def arm_search(robot: RobotModel) -> ArmSearch:
    """Return the search of an arm, built once."""
    lower, upper = robot.limits.positions
    turns = (upper - lower >= 2.0 * np.pi) & ~np.array(robot.chain.slides)
    bounds = np.concatenate([np.where(turns, -np.inf, lower), np.where(turns, np.inf, upper)])
    return ArmSearch(
        robot=robot,
        reach=ReachBound.of(robot),
        bounds=bounds,
        shared=(bounds, np.concatenate([lower, upper])),
        endless=(np.repeat([-np.inf, np.inf], robot.n),) * 2,
        lock=threading.Lock(),
    )
