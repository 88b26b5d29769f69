"""Decisions of a simulated operator: what the person intends, sees and does, sample by sample."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum
from math import radians

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.operators.sample import OperatorView
from optsc.people.motor import Movement, SimulatedHand
from optsc.people.parameters import AimParameters, HumanParameters, Intention
from optsc.people.putting_down import PlacingStage, PuttingDown
from optsc.people.ready_pose import Aim, adjust_aim, draw_aim

_REST_SPEED, _REST_TURN, _REST_WINDOW = 0.03, radians(15.0), 0.1
"""A tool slower than this over this window counts as at rest [m/s], [rad/s], [s]; tuned here."""

_HELPS = 0.8
"""A correction that leaves more than this share of the error did not help [-]; tuned here."""


class Phase(Enum):
    """What the person is about."""

    REST = "resting before the first movement"
    MOVE = "moving the hand"
    WATCH = "watching whether the tool arrives"
    DWELL = "content with the pose"
    HAND_OVER = "pressing the trigger to hand over"
    SUPERVISE = "watching the robot"
    TAKE_OVER = "pressing the trigger to take over"
    REGAIN = "waiting for the arm to follow the hand again"
    PUT_DOWN = "putting the object down"
    DONE = "resting, nothing more to do"


_LEADING = (Phase.MOVE, Phase.WATCH, Phase.DWELL, Phase.REGAIN)
"""What the person is about while the arm is expected to follow the hand."""
_UNAIDED = (Phase.REST, Phase.MOVE, Phase.WATCH, Phase.DWELL)
"""What the person is about before the robot moves by itself."""


class SimulatedPerson:
    """A person at work on a plan; see `optsc.people.Simulated`."""

    def __init__(
        self,
        rng: np.random.Generator,
        plan: Sequence[Intention],
        R_WS: Array,
        human: HumanParameters,
        aims: AimParameters,
        by_hand: bool,
        view: OperatorView,
    ) -> None:
        # What the hand does of itself must not depend on how many decisions were made.
        noise, self._rng = rng.spawn(2)
        self._plan, self._human, self._aims, self._by_hand = plan, human, aims, by_hand
        self._R_SW = rotation.conjugate(R_WS)
        self._misjudged = _misjudgement(self._rng, human)
        self._hand = SimulatedHand(noise, self._first_pose(view.X_WT), human)
        self._known = dict(view.objects)
        self._seen: deque[tuple[float, Pose]] = deque()
        self.phase, self._since = Phase.REST, view.time
        self._current = 0
        self._aim = self._new_aim(view)
        self._X_OG: Pose | None = None
        self._at_pregrasp = False
        self._wrong_since: float | None = None
        self._movement: Movement | None = None
        self._corrections = self._attempts = 0
        self._last_error = np.inf
        self._triggered = self._trigger_not_before = view.time
        self._robot_began = False
        self._let_go_until = view.time
        self._halted_since: float | None = None
        self._putting_down: PuttingDown | None = None

    def _first_pose(self, X_WT: Pose) -> Pose:
        axis = self._rng.normal(size=3)
        angle = self._human.misalignment * self._rng.uniform(0.5, 1.0)
        misaligned = rotation.exp(angle * axis / np.linalg.norm(axis))
        q = rotation.multiply(rotation.multiply(self._R_SW, X_WT.quaternion), misaligned)
        at = np.array(self._human.hand_start) + self._rng.uniform(-0.05, 0.05, 3)
        return Pose(q / np.linalg.norm(q), at)

    def step(self, time: float, view: OperatorView) -> tuple[Pose, bool, bool]:
        """Go through one sample period up to ``time``: return the reported hand, the clutch and the trigger."""
        self._observe(time, view)
        if self._putting_down is not None or (view.finished and self._plan[self._current].put_down):
            self._put_down(time, view)
        elif view.finished:
            self._enter(Phase.DONE, time)
        else:
            if view.automatic and self.phase in _UNAIDED:
                # The robot has begun by itself.
                self._triggered, self._robot_began = time, True
                self._enter(Phase.SUPERVISE, time)
            self._decide(time, view)
        X_SH = self._hand.advance(self._movement, time)
        pressed = self.phase in (Phase.HAND_OVER, Phase.TAKE_OVER)
        pressed = pressed or (self._putting_down is not None and self._putting_down.trigger)
        return X_SH, time >= self._let_go_until, pressed

    def _observe(self, time: float, view: OperatorView) -> None:
        # An object that is hidden for a while is kept where it was.
        self._known.update(view.objects)
        self._seen.append((time, view.X_WT))
        while time - self._seen[0][0] > self._human.reaction + _REST_WINDOW + 1e-9:
            self._seen.popleft()
        if self.phase in (Phase.HAND_OVER, Phase.SUPERVISE):
            self._robot_began = self._robot_began or view.automatic

        if not view.halted or time < self._let_go_until + self._human.reaction:
            self._halted_since = None
        elif self._halted_since is None:
            self._halted_since = time

    def _sees_it_halted(self, time: float) -> bool:
        return self._halted_since is not None and time - self._halted_since >= self._human.reaction

    def _put_down(self, time: float, view: OperatorView) -> None:
        """Go on with putting the object down, and with the plan afterwards."""
        putting = self._putting_down
        if putting is None:
            self._enter(Phase.PUT_DOWN, time)
            place = self._plan[self._current].place
            putting = PuttingDown(place, self._R_SW, self._human, PlacingStage.ALIGN, time)
        putting = putting.after(time, view, self._hand.X_SH)
        self._putting_down, self._movement = putting, putting.movement
        if putting.done:
            self._putting_down = None
            if view.halted:
                self._let_go_until = time + self._human.press
            self._next_intention(time, view)

    def _decide(self, time: float, view: OperatorView) -> None:
        if self.phase in _LEADING and self._sees_it_halted(time):
            # A motion that is repeated against a halted arm leads nowhere: letting go and taking hold again does.
            self._let_go_until = time + self._human.press
            self._reach_out(self._let_go_until + self._human.reaction, view, self._aim)
            return
        in_phase = time - self._since
        match self.phase:
            case Phase.REST if in_phase >= self._human.initial_rest:
                self._reach_out(time, view, self._aim)
            case Phase.MOVE if self._movement is None or time >= self._movement.end:
                # The last piece of the movement is still executed in this period.
                self.phase, self._since = Phase.WATCH, time
            case Phase.WATCH:
                self._movement = None
                self._watch(time, in_phase, view)
            case Phase.DWELL if in_phase >= self._human.dwell and time >= self._trigger_not_before:
                self._triggered, self._robot_began = time, False
                self._enter(Phase.HAND_OVER, time)
            case Phase.HAND_OVER if in_phase >= self._human.press:
                self._enter(Phase.SUPERVISE, time)
            case Phase.SUPERVISE:
                self._supervise(time, view)
            case Phase.TAKE_OVER if in_phase >= self._human.press:
                self._enter(Phase.REGAIN, time)
            case Phase.REGAIN:
                self._regain(time, view)

    def _enter(self, phase: Phase, time: float) -> None:
        if phase is not self.phase:
            self.phase, self._since, self._movement = phase, time, None

    def _watch(self, time: float, waited: float, view: OperatorView) -> None:
        """Correct the hand until the tool is seen where it is wanted; where the arm cannot get there, aim again."""
        if waited < self._human.reaction:
            return
        X_WT, at_rest = self._perceived(time)
        if not at_rest and waited < self._human.patience:
            return
        if self._by_hand and self._goes_along(view, X_WT):
            self._arrived(time, view, X_WT)
            return
        wanted, care = self._wanted_pose(), self._care()
        distance = float(np.linalg.norm(wanted.translation - X_WT.translation))
        angle = float(rotation.angle(wanted.quaternion, X_WT.quaternion))
        near = distance <= care.position_tolerance and angle <= care.rotation_tolerance
        # Whoever sees that correcting does not help does not go on with it.
        error = _nearness(wanted, X_WT)
        spent = self._corrections >= self._human.corrections or error > _HELPS * self._last_error
        if near or (spent and self._attempts >= self._human.attempts):
            self._arrived(time, view, X_WT)
        elif spent:
            self._attempts += 1
            self._reach_out(time, view, self._new_aim(view))
        else:
            self._corrections += 1
            self._last_error = error
            self._correct(time, X_WT)

    def _goes_along(self, view: OperatorView, X_WT: Pose) -> bool:
        """Tell whether the person is content with where the tool is, and take to the grasp shown there.

        Whoever grasps by hand reaches out for the object, and corrects the tool to a grasp, not to a ready pose.
        Whoever is helped on towards another grasp takes that, and does not insist on the pre-grasp.
        """
        shown = view.grasps.get(self._target())
        if self._X_OG is None:
            return shown is not None
        X_WO = self._known[self._target()]
        if shown is not None and _nearness(X_WT, shown) < _nearness(X_WT, X_WO @ self._X_OG):
            self._X_OG = X_WO.inverse() @ shown
        return not self._at_pregrasp and _nearness(X_WT, X_WO @ self._X_OG) < 0.9 * self._human.standoff

    def _arrived(self, time: float, view: OperatorView, X_WT: Pose) -> None:
        """Hand over; who grasps by hand goes on, to the pre-grasp that is shown, then to the grasp, then closes."""
        if not self._by_hand or self._at_pregrasp:
            self._enter(Phase.DWELL, time)
            return
        if self._X_OG is not None:
            self._at_pregrasp = True
        elif self._current + 1 < len(self._plan):
            self._next_intention(time, view)
            return
        else:
            X_WG = view.grasps.get(self._target())
            if X_WG is None:
                self._enter(Phase.DWELL, time)
                return
            self._X_OG = self._known[self._target()].inverse() @ X_WG
        self._corrections, self._last_error = 0, np.inf
        self._correct(time, X_WT)

    def _correct(self, time: float, X_WT: Pose) -> None:
        """Correct a seen error as an error: the hand turns on by what the tool still lacks."""
        wanted = self._wanted_pose()
        error = rotation.log(rotation.multiply(wanted.quaternion, rotation.conjugate(X_WT.quaternion)))
        self._move(time, wanted.translation - X_WT.translation, rotation.rotate(self._R_SW, error))

    def _supervise(self, time: float, view: OperatorView) -> None:
        after = self._plan[self._current].then_take_over_after
        if view.automatic:
            # A trigger is let go of for as long as it is pressed, or the second press would not be one.
            released = self._since + self._human.press
            if after is not None and time >= max(self._triggered + after, released):
                self._wrong_since = None
                self._enter(Phase.TAKE_OVER, time)
            elif self._sees_it_go_wrong(time, view) and time >= released:
                self._enter(Phase.TAKE_OVER, time)
        elif self._robot_began or time - self._triggered >= self._human.retrigger:
            self._trigger_not_before = time + self._human.retrigger
            # What the robot has refused is tried from another side; what it broke off, once more much the same.
            aim = self._adjusted_aim(view) if self._robot_began else self._new_aim(view)
            if self._robot_began:
                # Whatever halted the robot: letting go and taking hold again ends it.
                self._let_go_until = time + self._human.press
            self._reach_out(time + self._human.reaction, view, aim)

    def _sees_it_go_wrong(self, time: float, view: OperatorView) -> bool:
        """Tell whether the robot has been seen, for as long as it takes to react, to go for another object."""
        if view.target is None or view.target == self._target():
            self._wrong_since = None
        elif self._wrong_since is None:
            self._wrong_since = time
        return self._wrong_since is not None and time - self._wrong_since >= self._human.reaction

    def _regain(self, time: float, view: OperatorView) -> None:
        waited = time - self._since
        if view.automatic:
            if waited >= self._human.retrigger:
                self._enter(Phase.TAKE_OVER, time)
        elif waited >= self._human.reaction:
            if self._wrong_since is None:
                self._next_intention(time, view)
            else:
                self._wrong_since = None
                self._reach_out(time, view, self._new_aim(view))

    def _next_intention(self, time: float, view: OperatorView) -> None:
        self._current += 1
        self._attempts = 0
        if self._current == len(self._plan):
            self._enter(Phase.DONE, time)
        else:
            self._reach_out(time, view, self._new_aim(view))

    def _reach_out(self, start: float, view: OperatorView, aim: Aim) -> None:
        """Begin the primary movement: relative in position, absolute in orientation, as the mapping is."""
        self._aim, self._corrections, self._last_error = aim, 0, np.inf
        self._X_OG, self._at_pregrasp = None, False
        X_WR = self._wanted_pose()
        R_SH = rotation.multiply(self._R_SW, X_WR.quaternion)
        turn = rotation.log(rotation.multiply(R_SH, rotation.conjugate(self._hand.X_SH.quaternion)))
        self._move(start, X_WR.translation - view.X_WT.translation, turn)

    def _move(self, start: float, displacement_W: Array, turn_S: Array) -> None:
        displacement = rotation.rotate(self._R_SW, displacement_W)
        self._enter(Phase.MOVE, start)
        self._movement = Movement.towards(start, displacement, turn_S, self._care())

    def _perceived(self, time: float) -> tuple[Pose, bool]:
        """Return the tool as it was one reaction time ago, and whether it was at rest then."""
        past = [(t, X) for t, X in self._seen if t <= time - self._human.reaction + 1e-9] or [self._seen[0]]
        (t0, X0), (t1, X1) = past[0], past[-1]
        moved = float(np.linalg.norm(X1.translation - X0.translation))
        turned = float(rotation.angle(X1.quaternion, X0.quaternion))
        seen = Pose(
            rotation.multiply(self._misjudged.quaternion, X1.quaternion),
            X1.translation + self._misjudged.translation,
        )
        return seen, moved <= _REST_SPEED * (t1 - t0) and turned <= _REST_TURN * (t1 - t0)

    def _target(self) -> str:
        return self._plan[self._current].object

    def _wanted_pose(self) -> Pose:
        """Return where the tool is wanted now: the ready pose, or by hand the pre-grasp and then the grasp."""
        X_WO = self._known[self._target()]
        if self._X_OG is None:
            return self._aim.pose(X_WO, self._aims.middle)
        X_WG = X_WO @ self._X_OG
        return X_WG if self._at_pregrasp else X_WG @ Pose.from_translation([0.0, 0.0, -self._human.standoff])

    def _care(self) -> HumanParameters:
        """Return the person's habits for the movement at hand: the last one, to the grasp, is the finest."""
        if not self._at_pregrasp:
            return self._human
        position, angle = self._human.grasp_tolerance
        return replace(self._human, position_tolerance=position, rotation_tolerance=angle)

    def _new_aim(self, view: OperatorView) -> Aim:
        others = [X for name, X in sorted(self._known.items()) if name != self._target()]
        return draw_aim(self._rng, self._known[self._target()], view.X_WT, others, self._aims)

    def _adjusted_aim(self, view: OperatorView) -> Aim:
        return adjust_aim(self._rng, self._aim, self._known[self._target()], view.X_WT, self._aims)


def _nearness(X: Pose, Y: Pose) -> float:
    """Return how far apart two poses appear [m]: an angle counts as what it moves 10 cm away."""
    angle = float(rotation.angle(X.quaternion, Y.quaternion))
    return float(np.linalg.norm(X.translation - Y.translation)) + 0.1 * angle


def _misjudgement(rng: np.random.Generator, human: HumanParameters) -> Pose:
    """Return the constant offset with which the person sees the tool, of the size that ``human`` says."""
    if not any(human.misjudged):
        return Pose.identity()
    direction, axis = rng.standard_normal((2, 3))
    distance, angle = human.misjudged
    turn = rotation.exp(angle * axis / np.linalg.norm(axis))
    return Pose(turn, distance * direction / np.linalg.norm(direction))
