"""Choice among the configurations of a pose: several are found and compared, and the chosen one is improved.

Where the arm has more joints than the pose asks for, the configurations of a pose are not points but surfaces
(self-motion manifolds). The chosen one is then moved along its surface, by steps towards what is better. The search
itself shows how the surface runs: from a configuration beside it, its least-norm steps lead back on the shortest path.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from optsc.geometry.rotation import Array
from optsc.ik.attempts import PoseBatch
from optsc.robot.manipulability import ManipulabilityMeasure
from optsc.robot.model import RobotModel

CHOICES = ("first", "nearest", "manipulability")
"""Which configuration of a pose is wanted, see `optsc.ik.batch.solve_ik`."""
DISTINCT = 0.05
"""Configurations count as different when a joint differs by more than this [rad or m]."""
POSES_AT_ONCE = 256
"""Poses whose configurations are found at once; bounds the memory."""
REFINEMENTS = 8
"""Steps along the surface of configurations."""
PROBE = 0.02
"""Greatest change of a joint [rad or m] in finding out how the surface runs."""
LONGEST_RETURN = 0.5
"""A search that ends further from its start [rad or m of a joint] has left for another branch."""
DIFFERENCE = 1e-6
"""Step of the difference quotients of a measure [rad or m]."""

Clear: TypeAlias = Callable[[Array], NDArray[np.bool_]]
"""Collision check of configurations (R, n); returns which (R,) touch nothing."""


class Objective(Protocol):
    """What makes one configuration of a pose better than another."""

    @property
    def step(self) -> float:
        """How much of a direction is tried first."""

    def value(self, q: Array, seeds: Array) -> Array:
        """Return the objective (R,) at configurations (R, n); lower is better."""

    def direction(self, q: Array, seeds: Array) -> Array:
        """Return directions (R, n) in which it falls."""


@dataclass(frozen=True)
class NearestToSeed:
    """Distance to the seed, √Σ (q - q_seed)²; endless joints go the shorter way."""

    robot: RobotModel
    step: float = 1.0

    def value(self, q: Array, seeds: Array) -> Array:
        """Return the distance (R,)."""
        return np.linalg.norm(self.robot.difference(q, seeds), axis=1)

    def direction(self, q: Array, seeds: Array) -> Array:
        """Return the direction to the seed (R, n)."""
        return self.robot.difference(seeds, q)


@dataclass(frozen=True)
class MostManipulable:
    """The measure with its sign turned."""

    robot: RobotModel
    measure: ManipulabilityMeasure
    step: float = 0.2

    def value(self, q: Array, seeds: Array) -> Array:
        """Return minus the measure (R,)."""
        return -np.asarray(self.measure.evaluate(self.robot, q))

    def direction(self, q: Array, seeds: Array) -> Array:
        """Return the gradient of the measure (R, n), its greatest component 1."""
        near = q[:, None, :] + DIFFERENCE * np.eye(q.shape[1])
        M = np.asarray(self.measure.evaluate(self.robot, near))
        slope = M - np.asarray(self.measure.evaluate(self.robot, q))[:, None]
        return slope / np.maximum(np.max(np.abs(slope), axis=1, keepdims=True), 1e-300)


@dataclass
class Configurations:
    """Up to K configurations of each of R poses.

    Attributes:
        robot: the arm.
        q: (R, K, n).
        usable: (R, K) bool: the pose is met, and nothing touched where that was asked for.
        found: (R,) how many of them that meet the pose are different.
    """

    robot: RobotModel
    q: Array
    usable: NDArray[np.bool_]
    found: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        apart = np.max(np.abs(self.robot.difference(self.q[:, :, None], self.q[:, None])), axis=-1) > DISTINCT
        earlier = np.tril(np.ones(apart.shape[1:], dtype=bool), -1)
        repeats = np.any(~apart & earlier & self.usable[:, None, :], axis=2)
        self.found = np.count_nonzero(self.usable & ~repeats, axis=1)


def collect(batch: PoseBatch, samples: int) -> Configurations:
    """Return the configuration that each pose of the batch has, and those that ``samples`` other starts lead to."""
    table = batch.arm.first_table
    starts = table.q[table.nearest(batch.features(), samples)]
    rows = np.repeat(np.arange(len(starts)), samples)
    others = batch.unsolved_subset(rows)
    others.attempt(starts.reshape(-1, 1, batch.arm.n))
    shape = (len(starts), samples)
    q = np.concatenate([batch.q[:, None], others.q.reshape(*shape, -1)], axis=1)
    usable = np.concatenate([batch.success[:, None], others.success.reshape(shape)], axis=1)
    return Configurations(batch.arm.robot, q, usable)


def choose(batch: PoseBatch, found: Configurations, objective: Objective | None) -> tuple[Array, NDArray[np.bool_]]:
    """Return the best usable configuration (R, n) of each pose, by default the first, and which poses have one (R,)."""
    count, each, n = found.q.shape
    value = np.broadcast_to(np.arange(float(each)), (count, each))
    if objective is not None:
        value = objective.value(found.q.reshape(-1, n), np.repeat(batch.seeds, each, axis=0))
        value = value.reshape(count, each)
    best = np.argmin(np.where(found.usable, value, np.inf), axis=1)
    return found.q[np.arange(count), best], np.any(found.usable, axis=1)


def refine(batch: PoseBatch, q: Array, objective: Objective, clear: Clear | None) -> Array:
    """Return configurations (R, n) of the same poses that are no worse than ``q`` (R, n), and as clear."""
    begin, q = q, q.copy()
    value, step = objective.value(q, batch.seeds), np.full(len(q), objective.step)
    for _ in range(REFINEMENTS):
        along = _along_the_surface(batch, q, objective.direction(q, batch.seeds))
        after, met = _nearest_on_the_surface(batch, q + step[:, None] * along)
        worth = objective.value(after, batch.seeds)
        better = met & (worth < value)
        q[better], value[better] = after[better], worth[better]
        step = np.where(better, np.minimum(1.5 * step, 2.0 * objective.step), 0.3 * step)
    if clear is not None and len(q):
        colliding = ~np.asarray(clear(q), dtype=bool)
        q[colliding] = begin[colliding]
    return q


def _nearest_on_the_surface(batch: PoseBatch, start: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the configurations (R, n) that the search leads to, and which (R,) meet the pose near their start."""
    start = batch.arm.limits.clip(start)
    trial = PoseBatch(batch.arm, batch.targets, batch.seeds)
    trial.attempt(start[:, None])
    near = np.max(np.abs(batch.arm.robot.difference(trial.q, start)), axis=1) < LONGEST_RETURN
    return trial.q, np.logical_and(trial.success, near)


def _along_the_surface(batch: PoseBatch, q: Array, direction: Array) -> Array:
    """Return what a direction (R, n) is once the part that leaves the surface is taken off."""
    size = np.max(np.abs(direction), axis=1, keepdims=True)
    small = np.minimum(1.0, PROBE / np.maximum(size, 1e-12))
    after, met = _nearest_on_the_surface(batch, q + small * direction)
    return np.where(met[:, None], batch.arm.robot.difference(after, q) / small, 0.0)


def only_clear(found: Configurations, clear: Clear) -> None:
    """Make configurations that touch something unusable."""
    rows = np.nonzero(found.usable)
    if len(rows[0]):
        found.usable[rows] = np.asarray(clear(found.q[rows]), dtype=bool)
