"""Choosing: which object is meant, and which of its grasps the robot goes to.

Has what the robot is on its way to moved in the meantime? Then it must not drive on blindly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import hypot

import numpy as np
from numpy.typing import ArrayLike

from optsc.control.approach import Approach
from optsc.control.arbitration import Goal, GraspPose
from optsc.control.modes import Mode
from optsc.control.rollout import Outlook, best_way, outlook
from optsc.control.servo import Servo
from optsc.geometry import Pose, rotation, scalar
from optsc.grasps import Candidates
from optsc.operators.clutch import ClutchSettings, Hand
from optsc.robot import RobotModel
from optsc.selection import GraspSelector, Ranking, Target
from optsc.selection.intent import Belief, CostToGo, Goals, IntentSettings, cost_to_go, updated, wasted
from optsc.selection.reach import ClearRows, ReachTable

RANKING_PERIOD = 0.02
"""How often the candidates are ranked against the moving hand [s]; a display shows no more."""
IDLE_ROWS = 4
"""Grasps solved anew between two rankings, those from the most distant posture first."""
DECISION_ROWS = 64
"""Finalists solved anew at most when the trigger is pressed: what is chosen then must be right."""
CHOICES = 40
"""How many grasps are looked at, best first, for one that the arm can go to on a straight way."""


class Choosing:
    """Ranks the grasps while the hand moves, believes, and decides when it is asked to.

    Args:
        robot: the arm.
        selector: ranks the grasps.
        approach: how the robot would go to one.
        intent: how a belief over objects follows from the hand; None where the object that is pointed at is meant.
        aim: which grasp of an object is shown where there is a belief; by default the nearest.

    Attributes:
        candidates, clear: the grasps of the scene and their collision check; None before there are any.
        ranking: the newest one; its `best` is the object that is meant.
        belief: over the objects, empty without ``intent``.
        goals: what a policy may assist towards, likewise.
        target: the grasp that was chosen last.
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
        self.forget()

    def forget(self) -> None:
        """Forget the scene, and all that was chosen in it."""
        self.candidates: Candidates | None = None
        self.clear: ClearRows | None = None
        self._begin()

    def _begin(self) -> None:
        self.selector.forget()
        self.ranking: Ranking | None = None
        self.belief = Belief.even(())
        self.goals: tuple[Goal, ...] = ()
        self.target: Target | None = None
        self._ranked, self._refreshed = -np.inf, True
        self._meant: str | None = None
        self._meant_since = 0.0
        self._others: list[int] = []
        self._table: ReachTable | None = None
        self._all: Goals | None = None
        self._seen: Hand | None = None
        self._from: tuple[Hand, Pose] | None = None

    def observe(self, candidates: Candidates, q: ArrayLike, clear: ClearRows | None) -> None:
        """Take in the grasps of a scene, seen from posture ``q`` (n,) [rad]; vetoes and beliefs begin anew."""
        self._begin()
        # After a reset nothing is taken over: a run must not depend on the one before.
        known = self.candidates is not None
        self.candidates, self.clear = candidates, clear
        self.selector.observe(candidates, q, clear=clear, reuse=known)

    def follow(
        self, servo: Servo, hand: Hand | None, clutch: ClutchSettings, *, everything: bool = False
    ) -> None:
        """Rank against the hand if it is time to, or use the time for grasps that were out of reach.

        ``hand`` is None while it is not coupled to the tool: what it does then says nothing.
        """
        if self.candidates is None:
            return
        if hand is None or self._seen is None or hypot(*_way(hand, self._seen)) > clutch.largest_step[0]:
            # What lies between was no motion of the hand: it let go, or the tracker jumped.
            self._from = None
        self._seen = hand
        if everything or servo.time - self._ranked >= RANKING_PERIOD:
            self._rank(servo, hand, clutch, DECISION_ROWS if everything else None)
        elif not self._refreshed:
            # Between two rankings, grasps that were out of reach from where the arm stood get another chance.
            self.selector.refresh_oldest(servo.guard.q, IDLE_ROWS)
            self._refreshed = True

    @property
    def shown(self) -> dict[str, Pose]:
        """The grasp to mark for each object: what a policy helps towards, or else the chosen one."""
        if self.goals:
            aims = {goal.name: self._aim(goal) for goal in self.goals}
            return {name: Pose(np.array(aim.q), np.array(aim.p)) for name, aim in aims.items()}
        ranking = self.ranking
        targets = {} if ranking is None else {name: ranking.target(name) for name in ranking.object_names}
        return {name: target.X_WG for name, target in targets.items() if target is not None}

    def meant_for(self, time: float) -> float:
        """Return for how long [s] the same object has been meant; zero while there is none."""
        return 0.0 if self._meant is None else time - self._meant_since

    def _rank(
        self, servo: Servo, hand: Hand | None, clutch: ClutchSettings, refresh_limit: int | None
    ) -> None:
        p, q = servo.reference
        X_WT = Pose(np.array(q), np.array(p))
        ranking = self.selector.rank(X_WT, servo.guard.q.copy(), refresh_limit=refresh_limit)
        if self.intent is not None:
            self._believe(self.intent, X_WT, hand, clutch)
            meant = self.belief.best
            if meant is not None and ranking.chosen.get(meant) is not None:
                ranking = replace(ranking, best=meant)
        self.ranking = ranking
        self._ranked, self._refreshed = servo.time, False
        if ranking.best != self._meant:
            self._meant, self._meant_since = ranking.best, servo.time

    def _believe(
        self, settings: IntentSettings, X_WT: Pose, hand: Hand | None, clutch: ClutchSettings
    ) -> None:
        """Update the belief once the hand has moved far enough to say something."""
        table = self.selector.table
        if table is not self._table or self._all is None:
            if table is None:
                return
            self._table, self._all = table, Goals.of(table, self._barred(table))
        goals = self._all
        self.belief = self.belief.among(goals.names)
        here = cost_to_go(settings, goals, X_WT.translation, X_WT.quaternion)
        self.goals = _goals(goals, here, self.belief)
        if hand is None or self._from is None:
            self._from = None if hand is None else (hand, X_WT)
            return
        earlier, X_from = self._from
        shift = scalar.rotate(clutch.R_WS, _way(hand, earlier))
        turn = scalar.log(scalar.multiply(hand.q, scalar.conjugate(earlier.q)))
        moved, turned = clutch.scale * hypot(*shift), clutch.rotation_scale * hypot(*turn)
        if moved < settings.dead_band[0] and turned < settings.dead_band[1]:
            return
        R_turn = rotation.exp(clutch.rotation_scale * np.array(scalar.rotate(clutch.R_WS, turn)))
        before = cost_to_go(settings, goals, X_from.translation, X_from.quaternion)
        after = cost_to_go(
            settings,
            goals,
            X_from.translation + clutch.scale * np.array(shift),
            rotation.multiply(R_turn, X_from.quaternion),
        )
        self.belief = updated(settings, self.belief, wasted(settings, before, after, moved, turned))
        self._from = hand, X_WT

    def _barred(self, table: ReachTable) -> np.ndarray | None:
        if not self.selector.vetoed:
            return None
        c = table.candidates
        names = [c.object_names[int(k)] for k in c.object_index]
        pairs = zip(names, c.grasp_index.tolist(), strict=True)
        return np.array([pair in self.selector.vetoed for pair in pairs], dtype=bool)

    def choose(self, servo: Servo, hand: Hand | None, clutch: ClutchSettings) -> str:
        """Rank against the hand as it is now and fix the target; otherwise say why there is none.

        The target is the best grasp that the arm can go to, and lift from, on the straight ways it will be sent
        along; one on whose ways it touches nothing, if there is any.
        """
        if self.candidates is None:
            return "there are no grasps"
        self.follow(servo, hand, clutch, everything=True)
        ranking = self.ranking
        if ranking is None or ranking.best is None:
            return "no grasp can be reached"
        self._others = ranking.of(ranking.best)[:CHOICES].tolist()
        words = f"no grasp of the {ranking.best} can be reached, and lifted from, on a straight way"
        return self.next(servo) and words

    def next(self, servo: Servo) -> str:
        """Take the next best grasp of the choice that was made last; say why where there is none left."""
        p, q = servo.reference
        start, posture = Pose(np.array(q), np.array(p)), servo.guard.q.copy()
        ranking, candidates = self.ranking, self.candidates
        if ranking is not None and candidates is not None:

            def seen(row: int) -> Outlook:
                target = ranking.target_of(row)
                return outlook(self.robot, self.approach, posture, start, target, candidates, self.clear)

            chosen = best_way(self._others, seen)
            if chosen is not None:
                self._others = self._others[self._others.index(chosen) + 1 :]
                self.target = ranking.target_of(chosen)
                return ""
        self._others = []
        return "there is no other grasp that can be reached, and lifted from, on a straight way"

    def veto(self, target: Target | None) -> str:
        """Offer this grasp no more until the scene changes; by default the one that is shown. Say what was done."""
        if target is None and self.ranking is not None:
            target = self._marked(self.ranking)
        if target is None:
            return "there is no grasp to refuse"
        self.selector.veto(target.object_name, target.grasp_index)
        self._table, self._ranked = None, -np.inf
        return f"grasp {target.grasp_index} of the {target.object_name} is refused"

    def _marked(self, ranking: Ranking) -> Target | None:
        """Return the grasp that is shown of the object that is meant."""
        for goal in self.goals:
            if goal.name == ranking.best:
                return ranking.target_of(self._aim(goal).candidate)
        return ranking.target()

    def near(self, servo: Servo, within: tuple[float, float] | None) -> str:
        """Fix as target the grasp that the tool is at, within a distance and an angle; say why there is none."""
        self.target = None
        table = self.selector.table
        if within is None:
            return ""
        if table is None or self.ranking is None:
            return "there are no grasps"
        goals = Goals.of(table, self._barred(table))
        if not goals.names:
            return "no grasp can be reached"
        p, q = servo.reference
        here = cost_to_go(self.intent or IntentSettings(), goals, np.array(p), np.array(q))
        k = int(np.argmin(here.value))
        distance, angle = float(here.distance[k]), float(here.angle[k])
        if distance > within[0] or angle > within[1]:
            return (
                f"the nearest grasp, of the {goals.names[k]}, is {1e3 * distance:.0f} mm and "
                f"{np.degrees(angle):.0f}° away"
            )
        self.target = self.ranking.target_of(int(goals.candidate[here.row[k]]))
        return ""


def _way(hand: Hand, earlier: Hand) -> tuple[float, float, float]:
    (x, y, z), (a, b, c) = hand.p, earlier.p
    return x - a, y - b, z - c


def _goals(goals: Goals, here: CostToGo, belief: Belief) -> tuple[Goal, ...]:
    """Return the objects as a policy sees them."""
    best = [line.start + int(np.argmax(goals.manipulability[line])) for line in goals.lines()]
    rows = zip(goals.names, belief.probability.tolist(), here.row.tolist(), best, strict=True)

    def grasp(row: int) -> GraspPose:
        p, q = goals.positions[row].tolist(), goals.quaternions[row].tolist()
        return GraspPose(tuple(p), tuple(q), int(goals.candidate[row]))

    return tuple(Goal(name, b, grasp(i), grasp(j)) for name, b, i, j in rows)


FARTHEST = 0.01
"""A grasp that has moved by more than this is no longer the one that was set out for [m]: half a pad's width."""
ON_THE_WAY = (Mode.APPROACH, Mode.ADJUST, Mode.ADVANCE)
"""Where the jaws have not closed yet. Later the object moves with the hand."""


def displaced(target: Target, before: Candidates | None, now: Candidates) -> str:
    """Return what has become of the object of a grasp, in words; empty where the grasp is where it was.

    Args:
        target: the grasp that the robot goes to, one of ``before``.
        before, now: the grasps of the scene when it was chosen, and after a look.
    """
    name = target.object_name
    if name not in now.object_names:
        return f"the {name} is gone"
    was = None if before is None else _place(target, before)
    place = _place(target, now)
    if was is None or place is None:
        return f"the {name} has other grasps now"
    distance = float(np.linalg.norm(place - was))
    return f"the {name} has moved by {1e3 * distance:.0f} mm" if distance > FARTHEST else ""


def _place(target: Target, candidates: Candidates) -> np.ndarray | None:
    """Return where a grasp is (3,) [m]; None where there is no such one."""
    if target.object_name not in candidates.object_names:
        return None
    index = candidates.object_names.index(target.object_name)
    rows = np.flatnonzero((candidates.object_index == index) & (candidates.grasp_index == target.grasp_index))
    return candidates.X_WG.translation[rows[0]] if len(rows) else None
