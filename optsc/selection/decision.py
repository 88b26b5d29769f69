"""Decision of a rule: filters, stages and winner among the candidates at one pose of the hand, in full."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optsc.geometry.rotation import Array
from optsc.selection.costs import GraspCost
from optsc.selection.filters import GraspFilter
from optsc.selection.grid import Grid, Layout, Situation, situate
from optsc.selection.reach import REASONS
from optsc.selection.rules import RankingRule, Selection

if TYPE_CHECKING:
    from optsc.grasps import Candidates


class RankingInputs(NamedTuple):
    """What a ranking follows from: unit quaternion (4,), position (3,) [m], configuration (n,) [rad], finite.

    ``endless`` are the indices of the joints that turn without limits.
    """

    grid: Grid
    rule: RankingRule
    filters: tuple[GraspFilter, ...]
    quaternion: Array
    position: Array
    q: Array
    endless: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Decision:
    """What a rule made of the candidates; shapes (K, M) are places of the grid, (N,) candidates.

    Attributes:
        inputs: what it follows from.
        situation: the grid as seen from the hand.
        selection: who was left after each stage of the rule.
    """

    inputs: RankingInputs
    situation: Situation
    selection: Selection

    @property
    def rule(self) -> RankingRule:
        """The rule that ranked."""
        return self.inputs.rule

    @property
    def layout(self) -> Layout:
        """Which candidate stands where."""
        return self.inputs.grid.layout

    @property
    def candidates(self) -> Candidates:
        """The candidates that were ranked."""
        return self.layout.candidates

    @cached_property
    def reasons(self) -> tuple[str, ...]:
        """Why a candidate may not be ranked: "", those of the reach table, those of the filters."""
        return (*REASONS, *(one.reason for one in self.inputs.filters))

    @cached_property
    def rejected(self) -> np.ndarray:
        """Index (K, M) into `reasons` of the first that applies; 0 where a candidate is admissible."""
        grid = self.inputs.grid
        rejected = np.where(grid.reachable, 0, self.situation.chosen(grid.status)).astype(np.int64)
        for number, one in enumerate(self.inputs.filters, start=len(REASONS)):
            rejected = np.where((rejected == 0) & ~one.passes(self.situation), number, rejected)
        return rejected

    def rejected_by(self) -> np.ndarray:
        """Return why each candidate (N,) is not the chosen one: a filter's reason or a stage; "" where it is."""
        left = self.selection.left_at()
        words = np.array([*self.reasons, *self.rule.stages, ""], dtype=object)
        return self.layout.gather(words[np.where(left < 0, self.rejected, len(self.reasons) + left)])

    def order(self, k: int) -> np.ndarray:
        """Return the admissible candidates of object ``k``, best first."""
        return self.layout.index[k, self.selection.order(k)]

    def cost_of(self, cost: GraspCost) -> Array:
        """Return any cost term (N,) of all candidates at this pose of the hand."""
        return self.layout.gather(cost.values(self.situation))

    def half_turn(self, i: int) -> bool:
        """Tell whether candidate ``i`` stands for its half-turned jaw twin."""
        turned = self.situation.turned
        return turned is not None and bool(self.layout.gather(turned)[i])


def decide(inputs: RankingInputs) -> Decision:
    """Return what the rule makes of the candidates that all filters pass: the heart of a control tick."""
    grid, rule, filters, quaternion, position, q, endless = inputs
    situation = situate(grid, quaternion, position, q, endless)
    admissible = grid.reachable
    for one in filters:
        admissible = admissible & one.passes(situation)
    return Decision(inputs, situation, rule.select(situation, admissible))
