"""Grasp choice: which object is intended, and which of its grasps the robot goes to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import ceil, inf
from types import MappingProxyType

import numpy as np

from optsc.control.approach import Approach
from optsc.control.arbitration import Goal, GraspPose
from optsc.control.belief_watch import BeliefWatch, believed
from optsc.control.choice_state import ChoiceState, Decided, SceneError, followed, with_ranking
from optsc.control.deciding import PIECE_TIME, SHORT, Deciding, worked
from optsc.control.displacement import displaced
from optsc.control.modes import Event
from optsc.control.servo import Servo
from optsc.control.status import error_text
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Quaternion, Vector
from optsc.grasps import Candidates
from optsc.operators.clutch import ClutchSettings, Hand
from optsc.robot import RobotModel
from optsc.selection import GraspSelector, Ranking, Target
from optsc.selection.filters import Gone, Vetoed
from optsc.selection.intent import Goals, IntentSettings, cost_to_go
from optsc.selection.reach import ClearRows, ReachTable

RANKING_PERIOD = 0.02
"""How often the candidates are ranked against the moving hand [s]; a display shows no more."""
ROUNDS_AGAIN = 6
"""Pieces of work between two rankings on grasps solved from too far away: finalists first, then the others."""


class GraspChoice:
    """Ranks the grasps while the hand moves, keeps a belief, and decides when it is asked to.

    Args:
        robot: the arm.
        selector: ranks the grasps.
        approach: how the robot would go to one.
        intent: how a belief over objects follows from the hand; None where the intended object is the one that is
            pointed at.
        aim: which grasp of an object is shown where there is a belief; by default the nearest.
        real_time: whether no tick may take long: a decision and the reach table of a new scene are then spread over
            ticks, and a decision ends after `optsc.control.deciding.DECISION_TIME` with what was found.
    """

    def __init__(
        self,
        robot: RobotModel,
        selector: GraspSelector,
        approach: Approach,
        intent: IntentSettings | None,
        aim: Callable[[Goal], GraspPose] = lambda goal: goal.nearest,
        *,
        real_time: bool = True,
    ) -> None:
        self.robot, self.selector, self.approach, self.intent = robot, selector, approach, intent
        self._aim, self._real_time = aim, real_time

    def observed(
        self,
        state: ChoiceState,
        servo: Servo,
        candidates: Candidates,
        clear: ClearRows | None,
        table: ReachTable | None = None,
    ) -> ChoiceState:
        """Return the state with the grasps of a scene, and their reach ``table``, where it was solved elsewhere.

        Vetoes and beliefs begin again. In real time the grasps before stay in use until those of the new scene are
        solved, see `worked`, but for the first scene after a reset.
        """
        q = servo.guard.q.copy()
        if self._real_time and servo.state.ticks:
            self.selector.announce(candidates, q, clear=clear, table=table)
            # What the tick that follows may do is done already.
            return state._replace(table=None, spent=servo.state.ticks)
        self.selector.forget()
        # After a reset nothing is taken over: a run must not depend on the one before.
        known = state.candidates is not None
        if table is not None:
            self.selector.require_fits(table, candidates)
            self.selector.use(table, clear=clear)
        else:
            self.selector.observe(candidates, q, clear=clear, reuse=known)
        return ChoiceState(candidates, clear)

    def worked(
        self,
        state: ChoiceState,
        servo: Servo,
        hand: Hand | None,
        clutch: ClutchSettings,
        *,
        ranks: bool,
        spent: bool = False,
    ) -> tuple[ChoiceState, str]:
        """Return the state after a tick's work on ranking, belief and reach table, and what went wrong, in words.

        What one tick does is bounded by counts; nothing where a decision has ``spent`` it. ``hand`` is None while it is
        not coupled to the tool: what it does then says nothing. While the robot moves, nothing ``ranks``: only the
        reach table of a new scene is worked on.
        """
        ranks = ranks and state.candidates is not None
        if ranks:
            state = followed(state, hand, clutch)
        for _ in range(0 if spent else self.pieces(servo)):
            try:
                after = self._piece(state, servo, hand, clutch, ranks)
            except SceneError as error:
                return state, str(error)
            if after is None:
                break
            state = after
        return state, ""

    def pieces(self, servo: Servo) -> int:
        """Return how many pieces of work a tick does: as many as there are `PIECE_TIME` in it, at least one."""
        return max(1, ceil(servo.period / PIECE_TIME - 1e-9))

    def _piece(
        self, state: ChoiceState, servo: Servo, hand: Hand | None, clutch: ClutchSettings, ranks: bool
    ) -> ChoiceState | None:
        """Do what is due next: ranking, a new reach table, rows that are outdated. Return None where nothing is."""
        selector, q = self.selector, servo.guard.q
        if ranks and servo.time - state.ranked >= RANKING_PERIOD:
            if selector.take_over():
                return state
            if self.intent is not None and not state.believed:
                state = self._believed(state, servo, hand, clutch)._replace(believed=True)
                if servo.state.ticks > 1:
                    return state
            return self._ranked(state, servo)
        if selector.observing:
            return self._scene_piece(state, q)
        if not ranks or state.rounds >= ROUNDS_AGAIN:
            return None
        return state._replace(rounds=state.rounds + 1) if selector.refresh_piece(q) else None

    def _scene_piece(self, state: ChoiceState, q: Array) -> ChoiceState:
        """Do a piece of a new reach table; where it is whole, its grasps are those of the choice from now on."""
        try:
            whole = self.selector.go_on(q)
        except Exception as error:
            raise SceneError(f"the new scene cannot be used: {error_text(error)}") from error
        return ChoiceState(self.selector.candidates, self.selector.state.clear) if whole else state

    def shown(self, state: ChoiceState) -> Mapping[str, Pose]:
        """Return the grasp to mark for each object: what a policy helps towards, or else the chosen one."""
        if state.goals:
            aims = {goal.name: self._aim(goal) for goal in state.goals}
            return {name: Pose(np.array(aim.q), np.array(aim.p)) for name, aim in aims.items()}
        ranking = state.ranking
        if ranking is None:
            return MappingProxyType({})
        targets = {name: ranking.target(name) for name in ranking.object_names}
        return {name: target.X_WG for name, target in targets.items() if target is not None}

    def _ranked(self, state: ChoiceState, servo: Servo) -> ChoiceState:
        ranking = self.selector.rank(_tool(servo), servo.guard.q.copy(), refresh_limit=0)
        best = None if self.intent is None else state.belief.best
        if best is not None and ranking.chosen.get(best) is not None:
            ranking = replace(ranking, best=best)
        return with_ranking(state._replace(believed=False, rounds=0), ranking, servo.time)

    def _believed(self, state: ChoiceState, servo: Servo, hand: Hand | None, clutch: ClutchSettings) -> ChoiceState:
        """Return the state with the belief as the hand's motion has it now."""
        table = self.selector.table
        if self.intent is None or table is None:
            return state
        known = state.known
        if table is not state.table or known is None:
            known = Goals.of(table, self._barred(table))
            state = state._replace(table=table, known=known)
        watch = BeliefWatch(state.belief, state.goals, state.origin)
        watch = believed(watch, self.intent, known, _tool(servo), hand, clutch)
        return state._replace(belief=watch.belief, goals=watch.goals, origin=watch.origin)

    def _barred(self, table: ReachTable) -> np.ndarray | None:
        """Return which candidates (N,) are not offered; None for all."""
        filters = [one for one in self.selector.state.filters if isinstance(one, (Vetoed, Gone))]
        if not filters:
            return None
        return np.logical_or.reduce([one.barred(table.candidates) for one in filters])

    def begin(
        self,
        state: ChoiceState,
        servo: Servo,
        hand: Hand | None,
        clutch: ClutchSettings,
        purpose: Event,
    ) -> tuple[ChoiceState, str]:
        """Begin to decide from this moment which grasp the robot goes to; return the state, or why it cannot be.

        It will be the best grasp that the arm can go to, and lift from, on the straight paths it will be sent along;
        one on whose paths it touches nothing, if there is any. See `decided`.
        """
        candidates = state.candidates
        if candidates is None:
            return state, "there are no grasps"
        best = None
        if self.intent is not None:
            state = self._believed(state, servo, hand, clutch)
            best = state.belief.best
        q = servo.guard.q.copy()
        # The belief was the first piece of work.
        spent = 0 if self.intent is None else 1
        deciding = Deciding(purpose, _tool(servo), q, candidates, state.clear, best=best, pieces=spent, spent=spent)
        return state._replace(deciding=deciding), ""

    def begin_next(self, state: ChoiceState, servo: Servo, target: Target | None, done: str = "") -> ChoiceState:
        """Begin to decide on the next best grasp of the last decision, after ``done``, in words; see `decided`."""
        if state.candidates is None:
            return state
        q, name = servo.guard.q.copy(), None if target is None else target.object_name
        deciding = Deciding(
            Event.RETARGETED,
            _tool(servo),
            q,
            state.candidates,
            state.clear,
            done=done,
            best=name,
            instead_of=target,
            # The tick at which a button is pressed has enough to do.
            pieces=1,
            spent=1,
        )
        if state.ranking is not None:
            deciding = deciding.among(state.ranking, state.others)
        return state._replace(deciding=deciding)

    def decided(self, state: ChoiceState, servo: Servo) -> tuple[ChoiceState, Decided | None]:
        """Work on the decision as much as one tick may; return the state, and what came of it, where it is over."""
        deciding, thorough = state.deciding, not self._real_time
        if deciding is None:
            return state, None
        pieces = self.pieces(servo) - deciding.spent
        begun = deciding._replace(spent=0)
        deciding = begun
        while not deciding.over(thorough) and (thorough or pieces > 0):
            deciding = worked(deciding, self.robot, self.approach, self.selector, thorough)
            pieces -= 1
        if not deciding.over(thorough):
            return state._replace(deciding=deciding), None
        target, others, reason = deciding.chosen()
        if target is not None and deciding is not begun and servo.period <= SHORT and not thorough:
            # To set out is enough for a tick, too.
            return state._replace(deciding=deciding), None
        ranking = deciding.ranking
        state = state._replace(deciding=None, others=others)
        if ranking is not None and deciding.purpose is not Event.RETARGETED:
            state = with_ranking(state._replace(rounds=0), ranking, servo.time)
        elif ranking is not None:
            state = state._replace(ranking=ranking)
        announced = self.selector.announced
        if target is not None and announced is not None and announced is not deciding.candidates:
            moved = displaced(target, deciding.candidates, announced)
            if moved:
                target, reason = None, moved
        elif target is None:
            reason = _refusal(deciding)
        return state, Decided(deciding.purpose, target, deciding.done, reason)

    def veto(self, state: ChoiceState, target: Target | None) -> tuple[ChoiceState, str]:
        """Offer this grasp no more until the scene changes; by default the one that is shown. Say what was done."""
        if target is None and state.ranking is not None:
            target = self._marked(state, state.ranking)
        if target is None:
            return state, "there is no grasp to refuse"
        self.selector.veto(target.object_name, target.grasp_index)
        reason = f"grasp {target.grasp_index} of the {target.object_name} is refused"
        return state._replace(table=None, ranked=-inf), reason

    def _marked(self, state: ChoiceState, ranking: Ranking) -> Target | None:
        """Return the grasp that is shown of the intended object."""
        for goal in state.goals:
            if goal.name == ranking.best:
                return ranking.target_of(self._aim(goal).candidate)
        return ranking.target()

    def near(
        self, state: ChoiceState, p: Vector, q: Quaternion, within: tuple[float, float] | None
    ) -> tuple[Target | None, str]:
        """Return the grasp that a tool at ``p``, ``q`` is at, within a distance and an angle, or why there is none."""
        if within is None:
            return None, ""
        table = self.selector.table
        if table is None or state.ranking is None:
            return None, "there are no grasps"
        goals = Goals.of(table, self._barred(table))
        if not goals.names:
            return None, "no grasp can be reached"
        here = cost_to_go(self.intent or IntentSettings(), goals, np.array(p), np.array(q))
        k = int(np.argmin(here.value))
        distance, angle = float(here.distance[k]), float(here.angle[k])
        if distance > within[0] or angle > within[1]:
            reason = (
                f"the nearest grasp, of the {goals.names[k]}, is {1e3 * distance:.0f} mm and "
                f"{np.degrees(angle):.0f}° away"
            )
            return None, reason
        return state.ranking.target_of(int(goals.candidate[here.row[k]])), ""


def _refusal(deciding: Deciding) -> str:
    """Return why there is no grasp to go to."""
    ranking = deciding.ranking
    if deciding.purpose is Event.RETARGETED:
        return "there is no other grasp that can be reached, and lifted from, on a straight path"
    if ranking is None or ranking.best is None:
        return "no grasp can be reached"
    return f"no grasp of the {ranking.best} can be reached, and lifted from, on a straight path"


def _tool(servo: Servo) -> Pose:
    """Return the pose that the tool is led along."""
    p, q = servo.reference
    return Pose(np.array(q), np.array(p))
