"""State of the choice of a grasp: what is known of the grasps, the hand and the intended object from tick to tick."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from optsc.control.arbitration import Goal
from optsc.control.belief_watch import moved_by_hand
from optsc.control.deciding import Deciding
from optsc.control.modes import Event
from optsc.geometry import Pose
from optsc.grasps import Candidates
from optsc.operators.clutch import ClutchSettings, Hand
from optsc.selection import Ranking, Target
from optsc.selection.intent import Belief, Goals
from optsc.selection.reach import ClearRows, ReachTable


class ChoiceState(NamedTuple):
    """What the choice remembers from tick to tick.

    Attributes:
        candidates, clear: the grasps of the scene and their collision check; None before there are any.
        ranking: the newest one; its `best` is the intended object.
        belief: over the objects, empty where none is kept.
        goals: what a policy may assist towards, likewise.
        ranked: when candidates were ranked last [s].
        believed: whether the belief is newer than the ranking.
        rounds: how often grasps were solved again since then.
        intended, intended_since: the intended object, and since when [s].
        others: grasps that were not chosen at the last decision, best first.
        table: the reach table that ``known`` is of.
        known: the grasps of all objects that the arm can execute.
        last_hand: at the last tick, while it was coupled.
        origin: hand and tool from which motion counts for the next update of the belief.
        deciding: the decision in the making, None while there is none.
        spent: number of the tick whose work is done already.
    """

    candidates: Candidates | None = None
    clear: ClearRows | None = None
    ranking: Ranking | None = None
    belief: Belief = Belief.even(())
    goals: tuple[Goal, ...] = ()
    ranked: float = -inf
    believed: bool = False
    rounds: int = 0
    intended: str | None = None
    intended_since: float = 0.0
    others: tuple[int, ...] = ()
    table: ReachTable | None = None
    known: Goals | None = None
    last_hand: Hand | None = None
    origin: tuple[Hand, Pose] | None = None
    deciding: Deciding | None = None
    spent: int = -1

    def intended_for(self, time: float) -> float:
        """Return for how long [s] the same object has been intended; zero while there is none."""
        return 0.0 if self.intended is None else time - self.intended_since

    @property
    def probabilities(self) -> dict[str, float] | None:
        """How likely each object is intended; None where no belief is kept."""
        belief = self.belief
        return dict(zip(belief.names, belief.probability.tolist(), strict=True)) if belief.names else None


class Decided(NamedTuple):
    """What came of a decision: what it was for, the grasp, if there is any, what was done, and what is to be said."""

    purpose: Event
    target: Target | None
    done: str
    reason: str


class SceneError(Exception):
    """A new scene cannot be used; the one before stays in use."""


def followed(state: ChoiceState, hand: Hand | None, clutch: ClutchSettings) -> ChoiceState:
    """Return the state after a tick of the hand: what no hand has done is no motion to infer anything from."""
    last = state.last_hand
    if hand is last and hand is not None:
        return state
    goes_on = hand is not None and last is not None and moved_by_hand(last, hand, clutch)
    return state._replace(last_hand=hand, origin=state.origin if goes_on else None)


def with_ranking(state: ChoiceState, ranking: Ranking, time: float) -> ChoiceState:
    """Return the state with a new ranking, made at ``time`` [s]."""
    state = state._replace(ranking=ranking, ranked=time)
    return state if ranking.best == state.intended else state._replace(intended=ranking.best, intended_since=time)
