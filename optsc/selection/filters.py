"""Grasp filters: which candidates may be ranked at all, and why the others may not.

Reachability is always the first filter (`optsc.selection.reach`); these come after it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from optsc.grasps import Candidates
from optsc.selection.costs import GraspCost
from optsc.selection.grid import Situation
from optsc.selection.reach_columns import PATH


class GraspFilter(ABC):
    """A mask with a reason.

    Attributes:
        columns: names of what the reach table has to measure for it, see `optsc.selection.reach_columns`.
    """

    columns: frozenset[str] = frozenset()

    @property
    @abstractmethod
    def reason(self) -> str:
        """Why a candidate that does not pass is rejected, in words."""

    @abstractmethod
    def passes(self, situation: Situation) -> np.ndarray:
        """Return which candidates (K, M) may be ranked."""


@dataclass(frozen=True)
class AtMost(GraspFilter):
    """Only candidates whose cost is not above a limit, in the cost's unit."""

    cost: GraspCost
    limit: float

    @property
    def columns(self) -> frozenset[str]:  # type: ignore[override]
        """What the cost reads."""
        return self.cost.columns

    @property
    def reason(self) -> str:
        """Why: the cost and its limit."""
        return f"beyond {self.cost.describe(self.limit)}"

    def passes(self, situation: Situation) -> np.ndarray:
        """Return which candidates (K, M) cost at most the limit."""
        return self.cost.values(situation) <= self.limit


@dataclass(frozen=True)
class StraightPathFilter(GraspFilter):
    """Only grasps that the arm gets to on the straight path from where it stands."""

    columns = frozenset({PATH})

    @property
    def reason(self) -> str:
        """Why: there is no such path."""
        return "no straight path from here"

    def passes(self, situation: Situation) -> np.ndarray:
        """Return which candidates (K, M) the arm gets to."""
        return situation.chosen(situation.grid.column(PATH)) > 0.5


@dataclass(frozen=True)
class Vetoed(GraspFilter):
    """The operator's veto: leaves out single grasps.

    Attributes:
        grasps: pairs of object name and grasp index; what is not among the candidates is ignored.
    """

    grasps: frozenset[tuple[str, int]]

    @property
    def reason(self) -> str:
        """Why: a person said so."""
        return "vetoed"

    def barred(self, candidates: Candidates) -> np.ndarray:
        """Return which candidates (N,) are vetoed."""
        barred = np.zeros(len(candidates), dtype=bool)
        for name, index in self.grasps:
            if name in candidates.object_names:
                own = candidates.object_index == candidates.object_names.index(name)
                barred |= own & (candidates.grasp_index == index)
        return barred

    def passes(self, situation: Situation) -> np.ndarray:
        """Return which candidates (K, M) nobody vetoed."""
        layout = situation.grid.layout
        return ~layout.spread(self.barred(layout.candidates), False)


@dataclass(frozen=True, eq=False)
class Gone(GraspFilter):
    """Leaves out grasps that a newer observation of the scene no longer has, until its reach table is there.

    Attributes:
        candidates: which candidates (N,) are gone.
    """

    candidates: np.ndarray

    def barred(self, candidates: Candidates) -> np.ndarray:
        """Return which candidates (N,) are gone."""
        return self.candidates

    @property
    def reason(self) -> str:
        """Why: the object is not there any more."""
        return "no longer there"

    def passes(self, situation: Situation) -> np.ndarray:
        """Return which candidates (K, M) are there."""
        return ~situation.grid.layout.spread(self.candidates, False)
