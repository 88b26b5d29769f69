"""Grasp ranking: per object the chosen grasp, and on request everything that led to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.selection import explanation
from optsc.selection.costs import GraspCost, PoseDistance
from optsc.selection.decision import Decision, RankingInputs, decide
from optsc.selection.explanation import CandidateRow
from optsc.selection.rules import RankingRule

AIM = PoseDistance(position=(1.0, 1.0, 0.1), rotation=(1.0, 1.0, 0.25))
"""How far a grasp is from what the hand points at (tuned here): the path along the approach is travelled anyway, and
counts little; so does roll. The object with the least is the intended one."""
TIE = 1e-9
"""Objects whose squared distances differ by less than this share are equally near."""


class Target(NamedTuple):
    """A chosen grasp, ready to be approached.

    Attributes:
        object_name: which object.
        candidate: index into the candidates.
        grasp_index: index into the object's grasp set.
        half_turn: whether X_WG is the stored pose turned by half a turn about its z axis (the jaws'
            symmetry).
        X_WG, X_WP: tool poses at the grasp and at the pre-grasp.
        q, q_pregrasp: configurations (n,) found there [rad].
        opening: distance between the pads when they hold the object [m]; NaN where that is not known.
        manipulability: the measure at ``q``.
    """

    object_name: str
    candidate: int
    grasp_index: int
    half_turn: bool
    X_WG: Pose
    X_WP: Pose
    q: Array
    q_pregrasp: Array
    opening: float
    manipulability: float


@dataclass(frozen=True, eq=False)
class Ranking:
    """The candidates of every object as ranked for one pose of the hand.

    A value: it keeps the inputs of the ranking, and computes order, costs and explanation from them when
    asked.

    Attributes:
        chosen: object name -> candidate index of its best grasp, None where none is admissible.
        best: the object that the hand points at: the one with the admissible grasp of least `AIM` distance; None
            where nothing is chosen. Of two equally near the first by name.
        stale: whether some grasp in the final choice was judged from another configuration of the arm than the
            present one, because the work of one call is bounded; the next calls catch up.
        reason: "" or why this ranking is empty or that of an earlier call.
    """

    chosen: Mapping[str, int | None]
    best: str | None
    stale: bool = False
    reason: str = ""
    _inputs: RankingInputs | None = None
    _twins: tuple[int, ...] = ()  # of each object the jaw twin of the chosen grasp

    @classmethod
    def empty(cls, reason: str) -> Ranking:
        """Return a ranking of nothing."""
        return cls(MappingProxyType({}), None, reason=reason)

    @classmethod
    def of_decision(cls, decision: Decision, stale: bool) -> Ranking:
        """Return the ranking by what was decided; it keeps no more than the inputs of it."""
        layout, situation, selection = decision.layout, decision.situation, decision.selection
        width = layout.index.shape[1]
        places = [k * width + max(column, 0) for k, column in enumerate(selection.winner)]
        candidates = layout.index.ravel()[places].tolist()
        turned = situation.turned
        twins = (0,) * len(places) if turned is None else turned.ravel()[places].astype(int).tolist()
        won = [column >= 0 for column in selection.winner]
        chosen = {name: candidates[k] if won[k] else None for k, name in enumerate(layout.names)}
        # Which object is intended must not depend on the rule that chooses among its grasps.
        squares = np.where(selection.survivors[0], AIM.key(situation), np.inf).min(axis=1, initial=np.inf)
        # Rounding must not decide between equals: it depends on the world frame, and the first by name does not.
        equal = squares <= squares.min(initial=np.inf) * (1.0 + TIE)
        best = layout.names[int(np.argmax(equal))] if any(won) else None
        return cls(MappingProxyType(chosen), best, stale, "", decision.inputs, tuple(twins))

    def follows_from(self, inputs: RankingInputs) -> bool:
        """Tell whether ranking these very inputs again would change nothing; they are compared by identity."""
        known = self._inputs
        same = known is not None and all(a is b for a, b in zip(known, inputs, strict=True))
        return same and not self.stale and not self.reason

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the ranked objects, sorted."""
        return tuple(self.chosen)

    def target(self, object_name: str | None = None) -> Target | None:
        """Return the chosen grasp of an object, by default of `best`; None where there is none.

        Raises:
            UnknownName: no such object was ranked.
        """
        name = self.best if object_name is None else object_name
        if name is None:
            return None
        candidate = self.chosen[self._checked(name)]
        twin = self._twins[self.object_names.index(name)]
        return None if candidate is None else self._target_of(name, candidate, twin)

    def target_of(self, i: int) -> Target:
        """Return candidate ``i`` as a target, chosen or not; the jaw twin is the one that suits the hand."""
        decision = self.decision
        name = decision.candidates.object_names[int(decision.candidates.object_index[self._candidate(i)])]
        return self._target_of(name, i, int(decision.half_turn(i)))

    def _target_of(self, name: str, i: int, t: int) -> Target:
        table = self._known.grid.table
        return Target(
            object_name=name,
            candidate=int(i),
            grasp_index=int(table.candidates.grasp_index[i]),
            half_turn=bool(t),
            X_WG=table.X_WG[i, t],
            X_WP=table.X_WP[i, t],
            q=table.q_grasp[i, t],
            q_pregrasp=table.q_pregrasp[i, t],
            opening=float(table.candidates.opening[i]),
            manipulability=float(table.manipulability[i, t]),
        )

    @property
    def order(self) -> np.ndarray:
        """Admissible candidates of all objects, best first: object by object, `best` first, then by name."""
        names = sorted(self.chosen, key=lambda name: name != self.best)
        lines = [self.of(name) for name in names]
        return np.concatenate(lines) if lines else np.zeros(0, dtype=np.int64)

    def of(self, object_name: str) -> np.ndarray:
        """Return the admissible candidates of one object, best first; raise `UnknownName`."""
        return self.decision.order(self.object_names.index(self._checked(object_name)))

    @property
    def total(self) -> Array:
        """The cost (N,) that decides in the end: the weighted sum, or that of a cascade's last stage."""
        return np.zeros(0) if self._inputs is None else self.cost_of(self.rule.deciding_cost)

    @property
    def costs(self) -> dict[str, Array]:
        """Every cost of the rule by name, each (N,) in its unit, for all candidates."""
        return {} if self._inputs is None else {c.name: self.cost_of(c) for c in self.rule.costs}

    def cost_of(self, cost: GraspCost) -> Array:
        """Return any cost term (N,) for all candidates at this pose of the hand."""
        return self.decision.cost_of(cost)

    @property
    def rejected_by(self) -> np.ndarray:
        """Why each candidate (N,) is not the one chosen: a filter's reason or a stage; "" where it is."""
        return np.zeros(0, dtype=object) if self._inputs is None else self.decision.rejected_by()

    @property
    def rule(self) -> RankingRule:
        """The rule that ranked."""
        return self._known.rule

    @cached_property
    def decision(self) -> Decision:
        """What the rule made of the candidates, in full: decided again from the inputs when it is asked for."""
        return decide(self._known)

    def explain(self, i: int | None = None) -> str:
        """Return in words and numbers what was chosen and why, or why candidate ``i`` was or was not."""
        if self._inputs is None:
            return f"No ranking: {self.reason}."
        if i is not None:
            return explanation.of_candidate(self.decision, self._candidate(i))
        lines = [] if not self.reason else [f"Kept from an earlier call: {self.reason}."]
        if self.best is not None:
            lines.append(f"The hand points at: {self.best}.")
        lines += [explanation.of_object(self.decision, k) for k in range(len(self.chosen))]
        if self.stale:
            lines.append("Some grasps are judged by where the arm stood a moment ago.")
        return "\n".join(lines)

    def rows(self) -> tuple[CandidateRow, ...]:
        """Return every candidate with its costs, its rank, and what removed it: the best of each object first."""
        return explanation.rows(self.decision) if self.chosen else ()

    def table(self, limit: int | None = None) -> str:
        """Return `rows` as text in columns, at most ``limit`` of each object."""
        rows = self.rows()
        return explanation.table(rows, limit) if rows else f"No ranking: {self.reason}."

    @property
    def _known(self) -> RankingInputs:
        if self._inputs is None:
            raise InvalidValue("ranking", f"empty: {self.reason}", "a ranking of at least one candidate")
        return self._inputs

    def _checked(self, name: str) -> str:
        if name not in self.chosen:
            raise UnknownName("ranked object", name, self.chosen)
        return name

    def _candidate(self, i: int) -> int:
        count = len(self._known.grid.layout.place)
        if not 0 <= i < count:
            raise InvalidValue("candidate index", i, f"0 to {count - 1}")
        return int(i)
