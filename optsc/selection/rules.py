"""Ranking rules over grasp costs: the paper's cascade, a weighted sum, lexicographic order.

A rule sees every object by itself. Ties (keys that differ by less than a cost's resolution) are decided by
the other costs of the rule in turn, at last by the grasp index, so that no ranking hangs on the order of the
candidates.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from optsc.checks import AtLeast, Checked, NonNegative, Positive, require
from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.selection.costs import (
    GraspCost,
    ManipulabilityLoss,
    OrientationDistance,
    PositionDistance,
    SumOfCosts,
)
from optsc.selection.grid import Situation


class Selection:
    """What a rule made of a situation; shapes (K, M) are places of the grid.

    Attributes:
        keys: one array (K, M) per cost, rounded to its resolution.
        survivors: masks (K, M): first the admissible candidates, then those left after each stage.
        counts: for every mask the number of candidates (K,) it has.
        winner: for each of K objects the column of its best candidate, -1 where none is admissible.
    """

    def __init__(self, keys: Sequence[Array], admissible: np.ndarray, keep: Sequence[int]) -> None:
        self.keys = tuple(keys)
        survivors, counts = [admissible], [np.add.reduce(admissible, axis=1, dtype=int).tolist()]
        for stage, limit in enumerate(keep):
            counts.append([min(count, limit) for count in counts[-1]])
            survivors.append(self._nearest(stage, survivors[-1], limit, sum(counts[-1])))
        self.survivors, self.counts = tuple(survivors), tuple(counts)
        # Of an object without survivors, argmax names the first column.
        columns = survivors[-1].argmax(axis=1).tolist()
        self.winner = tuple(c if count else -1 for c, count in zip(columns, counts[-1], strict=True))

    def _nearest(self, stage: int, alive: np.ndarray, limit: int, expected: int) -> np.ndarray:
        """Return the mask of the ``limit`` best of each object: ``expected`` altogether."""
        if limit >= alive.shape[1]:
            return alive
        key = np.where(alive, self.keys[stage], np.inf)
        if limit == 1:
            last = np.minimum.reduce(key, axis=1, keepdims=True)
        else:
            last = np.partition(key, limit - 1, axis=1)[:, limit - 1 : limit]
        kept = (key <= last) & alive
        # Everything up to the key of the last place is kept, so too many are kept just where keys are tied.
        if np.count_nonzero(kept) > expected:
            for k, line in enumerate(kept):
                columns = self._ordered(k, np.flatnonzero(line), stage)
                line[columns[limit:]] = False
        return kept

    def _ordered(self, k: int, columns: np.ndarray, stage: int) -> np.ndarray:
        """Return ``columns`` of object ``k``, best first by the stage's key, then by the others in turn."""
        turn = self.keys[stage:] + self.keys[:stage]
        # lexsort takes its last key first, and keeps the order of the columns where all are equal.
        return columns[np.lexsort([key[k, columns] for key in reversed(turn)])]

    def entering(self, k: int, stage: int) -> np.ndarray:
        """Return the columns of object ``k`` that came as far as ``stage``, best first by its key."""
        return self._ordered(k, np.flatnonzero(self.survivors[stage][k]), stage)

    @property
    def last_stage(self) -> int:
        """Number of the stage that names the winner."""
        return len(self.survivors) - 2

    def order(self, k: int) -> np.ndarray:
        """Return the admissible columns of object ``k``, best first: who stayed longer comes first."""
        remaining = [mask[k] for mask in self.survivors]
        left = [remaining[s] & ~remaining[s + 1] for s in range(len(remaining) - 1)]
        groups = [self._ordered(k, np.flatnonzero(remaining[-1]), self.last_stage)]
        for stage in range(self.last_stage, -1, -1):
            groups.append(self._ordered(k, np.flatnonzero(left[stage]), stage))
        return np.concatenate(groups)

    def left_at(self) -> np.ndarray:
        """Return the stage (K, M) at which each candidate was left behind.

        -1 where it was not admissible; the number of stages for the winner.
        """
        return np.sum(self.survivors, axis=0) - 1

    def finalists(self, limit: int) -> np.ndarray:
        """Return the places (F,) among which the last stage chose, at most the ``limit`` best per object."""
        mask, counts = self.survivors[-2], self.counts[-2]
        if max(counts, default=0) > limit:
            mask = self._nearest(self.last_stage, mask, limit, sum(min(c, limit) for c in counts))
        return mask.ravel().nonzero()[0]


class RankingRule(ABC):
    """Ranks the admissible candidates of every object by itself."""

    @property
    @abstractmethod
    def costs(self) -> tuple[GraspCost, ...]:
        """The costs the rule reads, in its order."""

    @property
    @abstractmethod
    def deciding_cost(self) -> GraspCost:
        """The cost that names the winner among those left at the end."""

    @property
    def stages(self) -> tuple[str, ...]:
        """What each stage is called: by default there is one, called after the deciding cost."""
        return (self.deciding_cost.name,)

    @abstractmethod
    def select(self, situation: Situation, admissible: np.ndarray) -> Selection:
        """Return the selection among the ``admissible`` candidates (K, M)."""


def _rounded(cost: GraspCost, situation: Situation) -> Array:
    return np.rint(cost.key(situation) * (1.0 / cost.resolution))


@dataclass(frozen=True)
class Stage(Checked):
    """Keep the best candidates by one cost, all where there are fewer."""

    cost: GraspCost
    keep: Annotated[int, AtLeast(1)] = 1


@dataclass(frozen=True)
class Cascade(RankingRule):
    """Stage after stage keeps the best candidates by its cost; the last keeps one.

    Attributes:
        steps: the stages in their order. A single one is nothing but sorting by its cost.
    """

    steps: tuple[Stage, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", tuple(self.steps))
        if not self.steps:
            raise InvalidValue("stages of the cascade", (), "at least one")
        if self.steps[-1].keep != 1:
            raise InvalidValue("candidates kept by the last stage", self.steps[-1].keep, "1")

    @classmethod
    def paper(cls, orientation: int = 30, position: int = 6) -> Cascade:
        """Return the paper's rule (Chen et al. 2023, section II.B).

        Of the candidates the 30 nearest in orientation, of them the 6 nearest in position, of them the one
        of the highest manipulability.
        """
        return cls(
            (
                Stage(OrientationDistance(), orientation),
                Stage(PositionDistance(), position),
                Stage(ManipulabilityLoss()),
            )
        )

    @classmethod
    def manipulability_only(cls) -> Cascade:
        """Return the older strategy, which ignores the hand: the highest manipulability of all."""
        return cls((Stage(ManipulabilityLoss()),))

    @property
    def costs(self) -> tuple[GraspCost, ...]:
        """The costs of the stages."""
        return tuple(stage.cost for stage in self.steps)

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages, called after their costs."""
        return tuple(f"{stage.cost.name} stage" for stage in self.steps)

    @property
    def deciding_cost(self) -> GraspCost:
        """The last stage's cost."""
        return self.steps[-1].cost

    def select(self, situation: Situation, admissible: np.ndarray) -> Selection:
        """Return what is left after each stage."""
        keys = [_rounded(stage.cost, situation) for stage in self.steps]
        return Selection(keys, admissible, [stage.keep for stage in self.steps])


@dataclass(frozen=True)
class WeightedSum(RankingRule):
    """Sort by the weighted sum of costs; a weight of zero equals leaving the term out.

    Attributes:
        terms: pairs of cost and weight; a weight is 0 or more and has the inverse unit of its cost.
    """

    terms: tuple[tuple[GraspCost, float], ...]

    def __post_init__(self) -> None:
        terms = tuple((cost, float(weight)) for cost, weight in self.terms)
        for cost, weight in terms:
            require(f"weight of {cost.name}", weight, NonNegative)
        if not any(weight for _, weight in terms):
            raise InvalidValue("weights", [weight for _, weight in terms], "at least one above 0")
        object.__setattr__(self, "terms", terms)

    @property
    def costs(self) -> tuple[GraspCost, ...]:
        """The costs whose weight is not zero."""
        return tuple(cost for cost, weight in self.terms if weight)

    @property
    def deciding_cost(self) -> GraspCost:
        """The sum."""
        return SumOfCosts(self.terms)

    def select(self, situation: Situation, admissible: np.ndarray) -> Selection:
        """Return the candidate of the smallest sum."""
        return Selection([_rounded(self.deciding_cost, situation)], admissible, [1])


@dataclass(frozen=True)
class Lexicographic(RankingRule):
    """Sort by the first cost in coarse steps, within a step by the second, and so on.

    Attributes:
        steps: pairs of cost and step width, in the unit of the cost: values within one step count as equal.
    """

    steps: tuple[tuple[GraspCost, float], ...]

    def __post_init__(self) -> None:
        steps = tuple((cost, float(width)) for cost, width in self.steps)
        for cost, width in steps:
            require(f"step width of {cost.name}", width, Positive)
        if not steps:
            raise InvalidValue("costs in lexicographic order", (), "at least one")
        object.__setattr__(self, "steps", steps)

    @property
    def costs(self) -> tuple[GraspCost, ...]:
        """The costs, the most important first."""
        return tuple(cost for cost, _ in self.steps)

    @property
    def stages(self) -> tuple[str, ...]:
        """The one stage."""
        return ("lexicographic order",)

    @property
    def deciding_cost(self) -> GraspCost:
        """The first cost."""
        return self.steps[0][0]

    def select(self, situation: Situation, admissible: np.ndarray) -> Selection:
        """Return the first candidate in lexicographic order."""
        keys = [np.floor(cost.values(situation) / width) for cost, width in self.steps]
        return Selection(keys, admissible, [1])
