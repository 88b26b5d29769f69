"""Grasp costs: each one finite number with a unit for every candidate; lower is better.

A cost knows nothing of the rule that ranks by it. Shapes (K, M) are the places of `optsc.selection.grid`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from optsc.checks import Above, AtMost, Checked, Each, NonNegative
from optsc.geometry import rotation
from optsc.geometry.rotation import Array
from optsc.selection.grid import Grid, Situation
from optsc.selection.reach_columns import CLEARANCE, PATH_CLEARANCE, PATH_MANIPULABILITY, PATH_SPEED, needed

Weights = Annotated[tuple[float, float, float], Each(NonNegative)]


class GraspCost(ABC):
    """One cost term.

    Attributes:
        name: what it is called in tables and explanations.
        unit: its unit; "-" for a plain number.
        resolution: keys that differ by less are ties. Far above rounding, far below anything that matters, so
            that the ranking does not hang on the last digit.
        columns: names of what the reach table has to measure for it, see `optsc.selection.reach_columns`.
    """

    name: str
    unit: str
    resolution: float = 1e-12
    columns: frozenset[str] = frozenset()

    @abstractmethod
    def values(self, situation: Situation) -> Array:
        """Return the cost (K, M) of every candidate, in `unit`."""

    def key(self, situation: Situation) -> Array:
        """Return any strictly increasing function (K, M) of `values` that is cheaper to have."""
        return self.values(situation)

    def describe(self, value: float) -> str:
        """Return a cost in words and numbers."""
        return f"{self.name} {value:.3g}" + ("" if self.unit == "-" else f" {self.unit}")


class TableCost(GraspCost):
    """A cost that follows from the reach table alone, and hence from the hand only by the twin that suits it."""

    @abstractmethod
    def per_twin(self, grid: Grid) -> Array:
        """Return the cost (T, K, M) of every twin."""

    def values(self, situation: Situation) -> Array:
        """Return the cost (K, M) of the twins to use."""
        return situation.chosen(self.per_twin(situation.grid))


@dataclass(frozen=True)
class OrientationDistance(GraspCost):
    """d_a = min(||q - q_i||, ||q + q_i||) [-], the paper's orientation distance: 2 sin(angle / 4).

    Of unit quaternions its square is 2 - 2 |q . q_i|, which is compared instead.
    """

    name = "orientation"
    unit = "-"

    def values(self, situation: Situation) -> Array:
        """Return d_a (K, M)."""
        return np.sqrt(np.maximum(self.key(situation), 0.0))

    def key(self, situation: Situation) -> Array:
        """Return the square of d_a (K, M), up to rounding."""
        return 2.0 - 2.0 * situation.similarity


@dataclass(frozen=True)
class PositionDistance(GraspCost):
    """d_l = ||p - p_i|| [m] between the tool and the grasp."""

    name = "position"
    unit = "m"

    def values(self, situation: Situation) -> Array:
        """Return d_l (K, M) [m]."""
        return np.sqrt(self.key(situation))

    def key(self, situation: Situation) -> Array:
        """Return the square of d_l (K, M) [m^2]."""
        offset = situation.grid.positions - situation.position[:, None, None]
        return np.einsum("ikm,ikm->km", offset, offset)


@dataclass(frozen=True)
class ManipulabilityLoss(TableCost):
    """-M, the penalised manipulability at the grasp's configuration with its sign turned; a plain number.

    Its definition is that of the `optsc.robot.manipulability.ManipulabilityMeasure` that filled the table.
    """

    name = "manipulability"
    unit = "-"

    def per_twin(self, grid: Grid) -> Array:
        """Return -M (T, K, M)."""
        return -grid.manipulability

    def describe(self, value: float) -> str:
        """Return M itself, which is better when higher."""
        return f"{self.name} {-value:.3g}"


@dataclass(frozen=True)
class PoseDistance(Checked, GraspCost):
    """Weighted pose distance in the gripper frame of each candidate [m].

    xi = [R_i^T (p - p_i), log(R_i^T R)] is the hand as seen from grasp i, and the cost is the square root of
    sum_j w_j xi_j^2 with the rotational weights multiplied by length^2. The weights being fixed to the
    gripper, the cost does not depend on the world frame. z is the approach axis, y the closing axis: a lower
    weight of z forgives distance along the approach, which the gripper travels anyway; a lower weight of
    rotation z forgives roll.

    Attributes:
        position: weights of x, y, z [-].
        rotation: weights of the rotation about x, y, z [-].
        length: metres that one radian counts for.
    """

    position: Weights = (1.0, 1.0, 1.0)
    rotation: Weights = (1.0, 1.0, 1.0)
    length: Annotated[float, NonNegative] = 0.15

    name = "pose"
    unit = "m"

    def values(self, situation: Situation) -> Array:
        """Return the weighted distance (K, M) [m]."""
        return np.sqrt(self.key(situation))

    def key(self, situation: Situation) -> Array:
        """Return its square (K, M) [m^2]."""
        if "pose" not in situation.shared:
            situation.shared["pose"] = _squared_offsets(situation)
        p, v = situation.shared["pose"]
        weights = self.length**2 * np.array(self.rotation)
        return (np.array(self.position) @ p + weights @ v).reshape(situation.similarity.shape)


def _squared_offsets(situation: Situation) -> tuple[Array, Array]:
    """Return the squares of position (3, K M) [m^2] and rotation vector (3, K M) of the hand as grasps see it."""
    grid = situation.grid
    offset = situation.position[:, None, None] - grid.positions
    # A half turn changes the signs of x and y alone, which the squares do not see: any twin will do.
    p = np.add.reduce(grid.rotations * offset[:, None], axis=0).reshape(3, -1)
    # conj(q_i) q is linear in q_i: one matrix product for all candidates.
    q = situation.chosen(grid.quaternions).reshape(4, -1)
    product = _left_conjugate(situation.quaternion) @ q
    squares = np.square(product[1:])
    sine = np.sqrt(np.add.reduce(squares, axis=0))
    # The rotation vector is v times angle / sine; where the sine is zero, so is v.
    ratio = 2.0 * np.arctan2(sine, np.abs(product[0])) / np.maximum(sine, 1e-300)
    return np.square(p), squares * np.square(ratio)


def _left_conjugate(q: Array) -> Array:
    """Return the matrix A (4, 4) with A a = conj(a) q for every quaternion a (4,)."""
    w, x, y, z = q.tolist()
    return np.array([[w, x, y, z], [x, -w, -z, y], [y, z, -w, -x], [z, -y, x, -w]])


@dataclass(frozen=True)
class JointTravel(GraspCost):
    """Largest joint motion [rad] from the present configuration to the grasp's; large means another IK branch."""

    name = "joint travel"
    unit = "rad"

    def values(self, situation: Situation) -> Array:
        """Return max_j |q_j - q_grasp_j| (K, M) [rad]; endless joints go the shorter way."""
        travel = situation.grid.q_grasp - situation.q[:, None, None, None]
        for joint in situation.endless:
            travel[joint] = rotation.wrapped(travel[joint])
        return situation.chosen(np.maximum.reduce(np.abs(travel, out=travel), axis=0))


@dataclass(frozen=True)
class ClearanceLoss(Checked, TableCost):
    """How much the clearance at pre-grasp and grasp falls short of ``enough`` [m].

    It saturates, so that of two grasps in free space neither is better: 0 from ``enough`` on.

    Attributes:
        enough: clearance from which more is worth nothing [m].
    """

    enough: Annotated[float, Above(0.0), AtMost(0.2)] = 0.05

    name = "clearance"
    unit = "m"
    columns = frozenset({CLEARANCE})

    def per_twin(self, grid: Grid) -> Array:
        """Return enough - min(clearance, enough) (T, K, M) [m]."""
        (column,) = self.columns
        return self.enough - np.minimum(grid.column(column), self.enough)

    def describe(self, value: float) -> str:
        """Return the clearance itself, which is better when higher."""
        return f"{self.name} {'' if value > 0.0 else 'at least '}{self.enough - value:.3g} m"


@dataclass(frozen=True)
class PathLength(GraspCost):
    """Length of the tool's path [m]: straight to the pre-grasp, and the standoff on to the grasp."""

    name = "way length"
    unit = "m"

    def values(self, situation: Situation) -> Array:
        """Return |p_P - p| + standoff (K, M) [m]."""
        offset = situation.grid.pregrasp_positions - situation.position[:, None, None]
        return np.sqrt(np.einsum("ikm,ikm->km", offset, offset)) + situation.grid.table.standoff


@dataclass(frozen=True)
class PathSpeed(TableCost):
    """Greatest share of its velocity limit [-] that any joint needs on the straight path at the speed of the approach.

    Twice the limit stands for a path that the arm cannot complete.
    """

    name = "peak joint speed"
    unit = "-"
    columns = frozenset({PATH_SPEED})

    def per_twin(self, grid: Grid) -> Array:
        """Return the share (T, K, M)."""
        return grid.column(PATH_SPEED)


@dataclass(frozen=True)
class PathManipulabilityLoss(ManipulabilityLoss):
    """Least penalised manipulability on the straight path with its sign turned; 0 where the arm cannot complete it."""

    name = "manipulability on the way"
    columns = frozenset({PATH_MANIPULABILITY})

    def per_twin(self, grid: Grid) -> Array:
        """Return minus the least M (T, K, M)."""
        return -grid.column(PATH_MANIPULABILITY)


@dataclass(frozen=True)
class PathClearanceLoss(ClearanceLoss):
    """How much the least clearance on the straight path falls short of ``enough`` [m]; see `ClearanceLoss`."""

    name = "clearance on the way"
    columns = frozenset({PATH_CLEARANCE})


@dataclass(frozen=True)
class QualityLoss(TableCost):
    """1 - quality [-] of the stored grasp."""

    name = "quality"
    unit = "-"

    def per_twin(self, grid: Grid) -> Array:
        """Return 1 - quality (T, K, M)."""
        return np.broadcast_to(1.0 - grid.quality, grid.status.shape)

    def describe(self, value: float) -> str:
        """Return the quality itself, which is better when higher."""
        return f"{self.name} {1.0 - value:.3g}"


@dataclass(frozen=True)
class SumOfCosts(GraspCost):
    """Weighted sum of costs [-]; a weight has the inverse unit of its cost."""

    terms: tuple[tuple[GraspCost, float], ...]

    name = "weighted sum"
    unit = "-"
    resolution = 1e-9

    @property
    def columns(self) -> frozenset[str]:  # type: ignore[override]
        """What the terms with a weight read."""
        return needed(cost for cost, weight in self.terms if weight)

    def values(self, situation: Situation) -> Array:
        """Return the sum (K, M); a term of weight zero is not even computed."""
        grid = situation.grid
        total = situation.chosen(grid.cached(self.terms, self._of_the_table))
        for cost, weight in self.terms:
            if weight != 0.0 and not isinstance(cost, TableCost):
                total = total + weight * cost.values(situation)
        return total

    def _of_the_table(self, grid: Grid) -> Array:
        """Return the part of the sum (T, K, M) that stays the same until the table changes."""
        total = np.zeros(grid.status.shape)
        for cost, weight in self.terms:
            if weight != 0.0 and isinstance(cost, TableCost):
                total += weight * cost.per_twin(grid)
        return total
