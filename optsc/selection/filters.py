"""Filters: which candidates may be ranked at all, and why the others may not.

Reachability is always the first filter (`optsc.selection.reach`); these come after it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from optsc.selection.costs import GraspCost
from optsc.selection.grid import Situation


class GraspFilter(ABC):
    """A mask with a reason.

    Attributes:
        columns: names of what the reach table has to measure for it, see `optsc.selection.columns`.
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
