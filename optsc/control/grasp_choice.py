"""Grasp choice: which object is intended, and which of its grasps the robot goes to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import hypot, inf
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.control.approach import Approach
from optsc.control.arbitration import Goal, GraspPose
from optsc.control.path_feasibility import PathFeasibility, grasp_path_feasibility, most_feasible
from optsc.control.servo import Servo
from optsc.geometry import Pose, rotation, scalar
from optsc.geometry.scalar import Quaternion, Vector
from optsc.grasps import Candidates
from optsc.operators.clutch import ClutchSettings, Hand
from optsc.robot import RobotModel
from optsc.selection import GraspSelector, Ranking, Target
from optsc.selection.intent import Belief, CostToGo, Goals, IntentSettings, cost_to_go, updated, wasted
from optsc.selection.reach import ClearRows, ReachTable

RANKING_PERIOD = 0.02
"""How often the candidates are ranked against the moving hand [s]; a display shows no more."""
IDLE_ROWS = 4
"""Grasps solved again between two rankings, those from the most distant configuration first."""
DECISION_ROWS = 64
"""Finalists solved again at most when the trigger is pressed: what is chosen then must be right."""
CHOICES = 40
"""How many grasps are tried, best first, for one that the arm can go to on a straight path."""


class ChoiceState(NamedTuple):
    """What the choice remembers from tick to tick.

    Attributes:
        candidates, clear: the grasps of the scene and their collision check; None before there are any.
        ranking: the newest one; its `best` is the intended object.
        belief: over the objects, empty where none is kept.
        goals: what a policy may assist towards, likewise.
        ranked: when candidates were ranked last [s].
        refreshed: whether the time since then was used for grasps that were out of reach.
        intended, intended_since: the intended object, and since when [s].
        others: grasps that were not chosen at the last decision, best first.
        table: the reach table that ``known`` is of.
        known: the grasps of all objects that the arm can execute.
        last_hand: at the last tick, while it was coupled.
        origin: hand and tool from which motion counts for the next update of the belief.
    """

    candidates: Candidates | None = None
    clear: ClearRows | None = None
    ranking: Ranking | None = None
    belief: Belief = Belief.even(())
    goals: tuple[Goal, ...] = ()
    ranked: float = -inf
    refreshed: bool = True
    intended: str | None = None
    intended_since: float = 0.0
    others: tuple[int, ...] = ()
    table: ReachTable | None = None
    known: Goals | None = None
    last_hand: Hand | None = None
    origin: tuple[Hand, Pose] | None = None

    def intended_for(self, time: float) -> float:
        """Return for how long [s] the same object has been intended; zero while there is none."""
        return 0.0 if self.intended is None else time - self.intended_since

    @property
    def probabilities(self) -> dict[str, float] | None:
        """How likely each object is intended; None where no belief is kept."""
        belief = self.belief
        return dict(zip(belief.names, belief.probability.tolist(), strict=True)) if belief.names else None


class GraspChoice:
    """Ranks the grasps while the hand moves, keeps a belief, and decides when it is asked to.

    Args:
        robot: the arm.
        selector: ranks the grasps.
        approach: how the robot would go to one.
        intent: how a belief over objects follows from the hand; None where the intended object is the one that is
            pointed at.
        aim: which grasp of an object is shown where there is a belief; by default the nearest.
    """

    def __init__(
        self,
        robot: RobotModel,
        selector: GraspSelector,
        approach: Approach,
        intent: IntentSettings | None,
        aim: Callable[[Goal], GraspPose] = lambda goal: goal.nearest,
    ) -> None:
        self.robot, self.selector, self.approach, self.intent = robot, selector, approach, intent
        self._aim = aim

    def observed(
        self, state: ChoiceState, candidates: Candidates, q: ArrayLike, clear: ClearRows | None
    ) -> ChoiceState:
        """Return the state with the grasps of a scene, seen from configuration ``q`` (n,) [rad].

        Vetoes and beliefs begin again.
        """
        self.selector.forget()
        # After a reset nothing is taken over: a run must not depend on the one before.
        known = state.candidates is not None
        self.selector.observe(candidates, q, clear=clear, reuse=known)
        return ChoiceState(candidates, clear)

    def followed(
        self,
        state: ChoiceState,
        servo: Servo,
        hand: Hand | None,
        clutch: ClutchSettings,
        *,
        decide: bool = False,
    ) -> ChoiceState:
        """Rank against the hand if it is time to or for a decision, or use the time for grasps that were out of reach.

        ``hand`` is None while it is not coupled to the tool: what it does then says nothing.
        """
        if state.candidates is None:
            return state
        last = state.last_hand
        if hand is not last or hand is None:
            origin = state.origin
            if hand is None or last is None or hypot(*_displacement(hand, last)) > clutch.largest_step[0]:
                # What lies between was no motion of the hand: it let go, or the tracker jumped.
                origin = None
            state = state._replace(last_hand=hand, origin=origin)
        if decide or servo.time - state.ranked >= RANKING_PERIOD:
            return self._ranked(state, servo, hand, clutch, DECISION_ROWS if decide else None)
        if not state.refreshed:
            # Between two rankings, grasps that were out of reach from where the arm stood get another chance.
            self.selector.refresh_oldest(servo.guard.q, IDLE_ROWS)
            return state._replace(refreshed=True)
        return state

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

    def _ranked(
        self,
        state: ChoiceState,
        servo: Servo,
        hand: Hand | None,
        clutch: ClutchSettings,
        refresh_limit: int | None,
    ) -> ChoiceState:
        p, q = servo.reference
        X_WT = Pose(np.array(q), np.array(p))
        ranking = self.selector.rank(X_WT, servo.guard.q.copy(), refresh_limit=refresh_limit)
        if self.intent is not None:
            state = self._believed(state, self.intent, X_WT, hand, clutch)
            intended = state.belief.best
            if intended is not None and ranking.chosen.get(intended) is not None:
                ranking = replace(ranking, best=intended)
        state = state._replace(ranking=ranking, ranked=servo.time, refreshed=False)
        if ranking.best != state.intended:
            state = state._replace(intended=ranking.best, intended_since=servo.time)
        return state

    def _believed(
        self,
        state: ChoiceState,
        settings: IntentSettings,
        X_WT: Pose,
        hand: Hand | None,
        clutch: ClutchSettings,
    ) -> ChoiceState:
        """Update the belief once the hand has moved far enough to say something."""
        table = self.selector.table
        if table is not state.table or state.known is None:
            if table is None:
                return state
            state = state._replace(table=table, known=Goals.of(table, self._vetoed(table)))
        goals = state.known
        if goals is None:
            return state
        belief = state.belief.among(goals.names)
        here = cost_to_go(settings, goals, X_WT.translation, X_WT.quaternion)
        state = state._replace(belief=belief, goals=_goals(goals, here, belief))
        if hand is None or state.origin is None:
            return state._replace(origin=None if hand is None else (hand, X_WT))
        earlier, X_from = state.origin
        shift = scalar.rotate(clutch.R_WS, _displacement(hand, earlier))
        turn = scalar.log(scalar.multiply(hand.q, scalar.conjugate(earlier.q)))
        moved, turned = clutch.scale * hypot(*shift), clutch.rotation_scale * hypot(*turn)
        if moved < settings.dead_band[0] and turned < settings.dead_band[1]:
            return state
        R_turn = rotation.exp(clutch.rotation_scale * np.array(scalar.rotate(clutch.R_WS, turn)))
        before = cost_to_go(settings, goals, X_from.translation, X_from.quaternion)
        after = cost_to_go(
            settings,
            goals,
            X_from.translation + clutch.scale * np.array(shift),
            rotation.multiply(R_turn, X_from.quaternion),
        )
        belief = updated(settings, belief, wasted(settings, before, after, moved, turned))
        return state._replace(belief=belief, origin=(hand, X_WT))

    def _vetoed(self, table: ReachTable) -> np.ndarray | None:
        vetoed = self.selector.state.vetoed
        if not vetoed:
            return None
        c = table.candidates
        names = [c.object_names[int(k)] for k in c.object_index]
        pairs = zip(names, c.grasp_index.tolist(), strict=True)
        return np.array([pair in vetoed for pair in pairs], dtype=bool)

    def choose(
        self, state: ChoiceState, servo: Servo, hand: Hand | None, clutch: ClutchSettings
    ) -> tuple[ChoiceState, Target | None, str]:
        """Rank against the hand as it is now; return the state, the target, or why there is none.

        The target is the best grasp that the arm can go to, and lift from, on the straight paths it will be sent
        along; one on whose paths it touches nothing, if there is any.
        """
        if state.candidates is None:
            return state, None, "there are no grasps"
        state = self.followed(state, servo, hand, clutch, decide=True)
        ranking = state.ranking
        if ranking is None or ranking.best is None:
            return state, None, "no grasp can be reached"
        state = state._replace(others=tuple(ranking.of(ranking.best)[:CHOICES].tolist()))
        reason = f"no grasp of the {ranking.best} can be reached, and lifted from, on a straight path"
        state, target, refusal = self.next(state, servo)
        return state, target, refusal and reason

    def next(self, state: ChoiceState, servo: Servo) -> tuple[ChoiceState, Target | None, str]:
        """Take the next best grasp of the last decision; return the state, the target, or why there is none."""
        p, q = servo.reference
        start, configuration = Pose(np.array(q), np.array(p)), servo.guard.q.copy()
        ranking, candidates = state.ranking, state.candidates
        if ranking is not None and candidates is not None:

            def feasibility(row: int) -> PathFeasibility:
                target = ranking.target_of(row)
                return grasp_path_feasibility(
                    self.robot, self.approach, configuration, start, target, candidates, state.clear
                )

            chosen = most_feasible(state.others, feasibility)
            if chosen is not None:
                others = state.others[state.others.index(chosen) + 1 :]
                return state._replace(others=others), ranking.target_of(chosen), ""
        reason = "there is no other grasp that can be reached, and lifted from, on a straight path"
        return state._replace(others=()), None, reason

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
        goals = Goals.of(table, self._vetoed(table))
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


def _displacement(hand: Hand, earlier: Hand) -> Vector:
    (x, y, z), (a, b, c) = hand.p, earlier.p
    return x - a, y - b, z - c


def _goals(goals: Goals, here: CostToGo, belief: Belief) -> tuple[Goal, ...]:
    """Return the objects as a policy is given them."""
    best = [line.start + int(np.argmax(goals.manipulability[line])) for line in goals.lines()]
    rows = zip(goals.names, belief.probability.tolist(), here.row.tolist(), best, strict=True)

    def grasp(row: int) -> GraspPose:
        p, q = goals.positions[row].tolist(), goals.quaternions[row].tolist()
        return GraspPose(tuple(p), tuple(q), int(goals.candidate[row]))

    return tuple(Goal(name, b, grasp(i), grasp(j)) for name, b, i, j in rows)
