"""Costs of the motion ahead: the straight way from where the arm stands to the pre-grasp and on to the grasp.

But for the length of the way, which is known at every tick, they were rolled out through the kinematics when the row
of the reach table was solved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.selection import columns
from optsc.selection.costs import GraspCost, TableCost, shortfall
from optsc.selection.filters import GraspFilter
from optsc.selection.grid import Grid, Situation


@dataclass(frozen=True)
class WayLength(GraspCost):
    """Length of the tool's way [m]: straight to the pre-grasp, and the standoff on to the grasp."""

    name = "way length"
    unit = "m"

    def values(self, situation: Situation) -> Array:
        """Return |p_P - p| + standoff (K, M) [m]."""
        offset = situation.grid.pregrasp_positions - situation.position[:, None, None]
        return np.sqrt(np.einsum("ikm,ikm->km", offset, offset)) + situation.grid.table.standoff


@dataclass(frozen=True)
class WaySpeed(TableCost):
    """Greatest share of its velocity limit [-] that any joint needs on the way at the speed of the approach.

    Twice the limit stands for a way that the arm does not get along.
    """

    name = "peak joint speed"
    unit = "-"
    columns = frozenset({columns.WAY_SPEED})

    def per_twin(self, grid: Grid) -> Array:
        """Return the share (T, K, M)."""
        return grid.column(columns.WAY_SPEED)


@dataclass(frozen=True)
class WayManipulabilityLoss(TableCost):
    """Least penalised manipulability on the way with its sign turned; 0 where the arm does not get along it."""

    name = "manipulability on the way"
    unit = "-"
    columns = frozenset({columns.WAY_MANIPULABILITY})

    def per_twin(self, grid: Grid) -> Array:
        """Return minus the least M (T, K, M)."""
        return -grid.column(columns.WAY_MANIPULABILITY)

    def describe(self, value: float) -> str:
        """Return M itself, which is better when higher."""
        return f"{self.name} {-value:.3g}"


@dataclass(frozen=True)
class WayClearanceLoss(TableCost):
    """How much the least clearance on the way falls short of ``enough`` [m]; see `ClearanceLoss`.

    Attributes:
        enough: clearance from which more is worth nothing [m].
    """

    enough: float = 0.05

    name = "clearance on the way"
    unit = "m"
    columns = frozenset({columns.WAY_CLEARANCE})

    def __post_init__(self) -> None:
        if not 0.0 < self.enough <= 0.2:
            raise InvalidValue("enough", self.enough, "above 0, up to 0.2 m")

    def per_twin(self, grid: Grid) -> Array:
        """Return enough - min(clearance, enough) (T, K, M) [m]."""
        return shortfall(grid.column(columns.WAY_CLEARANCE), self.enough)

    def describe(self, value: float) -> str:
        """Return the clearance itself, which is better when higher."""
        return f"{self.name} {'' if value > 0.0 else 'at least '}{self.enough - value:.3g} m"


@dataclass(frozen=True)
class StraightWay(GraspFilter):
    """Only grasps that the arm gets to on the straight way from where it stands."""

    columns = frozenset({columns.WAY})

    @property
    def reason(self) -> str:
        """Why: there is no such way."""
        return "no straight way from here"

    def passes(self, situation: Situation) -> np.ndarray:
        """Return which candidates (K, M) the arm gets to."""
        return situation.chosen(situation.grid.column(columns.WAY)) > 0.5
