"""A simulated person: reaches for objects by hand, hands over to the robot, steps in again."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from math import isfinite, radians, sqrt

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.operators.aiming import Aim, AimParameters, adjust_aim, draw_aim
from optsc.operators.human_motion import Hand, HumanParameters, Movement
from optsc.operators.sample import OperatorSample, OperatorView

R_WS_DEFAULT = (sqrt(0.5), 0.0, 0.0, sqrt(0.5))
"""The station turned by 90 degrees about the vertical (w, x, y, z): the operator sits beside the robot."""

_CATCH_UP = 900
"""Most samples lived through in one call: who is not asked for longer than that has sat still."""
_REST_SPEED, _REST_TURN, _REST_WINDOW = 0.03, radians(15.0), 0.1
"""A tool slower than this over this window looks at rest [m/s], [rad/s], [s]; ours."""


@dataclass(frozen=True)
class Reach:
    """One intention: bring the tool near an object and let the robot take over.

    Attributes:
        object: name of the object.
        then_take_over_after: how long after the trigger the person takes over again [s]; None: not at all.
    """

    object: str
    then_take_over_after: float | None = None

    def __post_init__(self) -> None:
        after = self.then_take_over_after
        if after is not None and not (isfinite(after) and after > 0.0):
            raise InvalidValue("then_take_over_after", after, "finite, above 0 s, or None")


class Simulated:
    """An `Operator` that plays a person with the habits of ``human``.

    The person thinks in the paper's mapping: the tool turns as the hand does, R_WT = R_WS R_SH, and moves as
    the hand moves, by R_WS times its displacement. A ready pose near the object is reached with one primary
    movement; as long as the tool is seen elsewhere, corrective movements follow one after another (move and
    wait, Ferrell 1965). The trigger hands over. If the robot gives up, or never starts, the person aims a
    little differently and triggers again; where the plan says so, takes over and goes on with the next Reach.
    When the task is finished, or the plan is, the hand rests for good.

    Everything random comes from ``seed``: the same views give the same samples, bit for bit. One object
    plays one run.

    Args:
        seed: of everything random.
        plan: intentions in order; None: one object of the first view, chosen at random.
        R_WS: orientation of the station frame S in the world (w, x, y, z); the controller is told the same.
        human: motor habits.
        aims: which ready poses the person likes.

    Raises `InvalidValue` for an empty plan or a quaternion that is not unit; the first `read` raises
    `UnknownName` when the view lacks an object of the plan, and `InvalidValue` when it has no object at all.
    """

    def __init__(
        self,
        seed: int,
        plan: Sequence[Reach] | None = None,
        R_WS: ArrayLike = R_WS_DEFAULT,
        human: HumanParameters | None = None,
        aims: AimParameters | None = None,
    ) -> None:
        if plan is not None and len(plan) == 0:
            raise InvalidValue("plan", plan, "at least one Reach, or None")
        self.R_WS = rotation.checked(R_WS, "R_WS")
        self.human = human or HumanParameters()
        self.aims = aims or AimParameters()
        self._plan = None if plan is None else tuple(plan)
        self._rng = np.random.default_rng(seed)
        self._person: _Person | None = None
        self._start, self._next = 0.0, 0

    @property
    def plan(self) -> tuple[Reach, ...] | None:
        """The intentions; with none given, the one chosen at the first view, and None before it."""
        return self._plan

    @property
    def doing(self) -> str:
        """What the person is about, in words."""
        return _Phase.REST.value if self._person is None else self._person.phase.value

    def read(self, view: OperatorView) -> OperatorSample | None:
        """Return the newest sample of the tracker if its time has come since the last call, else None."""
        if self._person is None:
            self._plan = _plan_for(self._rng, self._plan, view)
            self._person = _Person(self._rng, self._plan, self.R_WS, self.human, self.aims, view)
            self._start = view.time
        # The thousandth of a period absorbs the rounding of a clock that adds up its ticks.
        due = int((view.time - self._start) * self.human.sample_rate + 1e-3)
        if due < self._next:
            return None
        for index in range(max(self._next, due - _CATCH_UP), due):
            self._person.live(self._start + index / self.human.sample_rate, view)
        stamp = self._start + due / self.human.sample_rate
        X_SH, trigger = self._person.live(stamp, view)
        self._next = due + 1
        return OperatorSample(stamp, X_SH, clutch=True, trigger=trigger)


def _plan_for(
    rng: np.random.Generator, plan: tuple[Reach, ...] | None, view: OperatorView
) -> tuple[Reach, ...]:
    names = sorted(view.objects)
    if not names:
        raise InvalidValue("objects in the operator's view", names, "at least one object to reach for")
    if plan is None:
        return (Reach(names[int(rng.integers(len(names)))]),)
    for reach in plan:
        if reach.object not in view.objects:
            raise UnknownName("object", reach.object, names)
    return plan


class _Phase(Enum):
    REST = "resting before the first movement"
    MOVE = "moving the hand"
    WATCH = "watching whether the tool arrives"
    DWELL = "content with the pose"
    HAND_OVER = "pressing the trigger to hand over"
    SUPERVISE = "watching the robot"
    TAKE_OVER = "pressing the trigger to take over"
    REGAIN = "waiting for the arm to follow the hand again"
    DONE = "resting, nothing more to do"


class _Person:
    """What the person has in mind, does and sees, sample by sample."""

    def __init__(
        self,
        rng: np.random.Generator,
        plan: tuple[Reach, ...],
        R_WS: Array,
        human: HumanParameters,
        aims: AimParameters,
        view: OperatorView,
    ) -> None:
        self._rng, self._plan, self._human, self._aims = rng, plan, human, aims
        self._R_SW = rotation.conjugate(R_WS)
        self._hand = Hand(rng, self._first_pose(view.X_WT), human)
        self._known = dict(view.objects)
        self._seen: deque[tuple[float, Pose]] = deque()
        self.phase, self._since = _Phase.REST, view.time
        self._reach = 0
        self._aim = self._fresh_aim(view)
        self._movement: Movement | None = None
        self._corrections = self._attempts = 0
        self._triggered = self._trigger_not_before = view.time
        self._robot_began = False

    def _first_pose(self, X_WT: Pose) -> Pose:
        axis = self._rng.normal(size=3)
        angle = self._human.misalignment * self._rng.uniform(0.5, 1.0)
        misaligned = rotation.exp(angle * axis / np.linalg.norm(axis))
        q = rotation.multiply(rotation.multiply(self._R_SW, X_WT.quaternion), misaligned)
        at = np.array(self._human.hand_start) + self._rng.uniform(-0.05, 0.05, 3)
        return Pose(q / np.linalg.norm(q), at)

    def live(self, time: float, view: OperatorView) -> tuple[Pose, bool]:
        """Live through one sample period up to ``time``: return the reported hand and the trigger."""
        self._look(time, view)
        if view.finished:
            self._enter(_Phase.DONE, time)
        else:
            self._decide(time, view)
        X_SH = self._hand.advance(self._movement, time)
        return X_SH, self.phase in (_Phase.HAND_OVER, _Phase.TAKE_OVER)

    def _look(self, time: float, view: OperatorView) -> None:
        # An object that is hidden for a while is remembered where it was.
        self._known.update(view.objects)
        self._seen.append((time, view.X_WT))
        while time - self._seen[0][0] > self._human.reaction + _REST_WINDOW + 1e-9:
            self._seen.popleft()
        if self.phase in (_Phase.HAND_OVER, _Phase.SUPERVISE):
            self._robot_began = self._robot_began or view.automatic

    def _decide(self, time: float, view: OperatorView) -> None:
        in_phase = time - self._since
        match self.phase:
            case _Phase.REST if in_phase >= self._human.initial_rest:
                self._reach_out(time, view, self._aim)
            case _Phase.MOVE if self._movement is None or time >= self._movement.end:
                # The last piece of the movement is still carried out in this period.
                self.phase, self._since = _Phase.WATCH, time
            case _Phase.WATCH:
                self._movement = None
                self._watch(time, in_phase, view)
            case _Phase.DWELL if in_phase >= self._human.dwell and time >= self._trigger_not_before:
                self._triggered, self._robot_began = time, False
                self._enter(_Phase.HAND_OVER, time)
            case _Phase.HAND_OVER if in_phase >= self._human.press:
                self._enter(_Phase.SUPERVISE, time)
            case _Phase.SUPERVISE:
                self._supervise(time, view)
            case _Phase.TAKE_OVER if in_phase >= self._human.press:
                self._enter(_Phase.REGAIN, time)
            case _Phase.REGAIN:
                self._regain(time, view)

    def _enter(self, phase: _Phase, time: float) -> None:
        if phase is not self.phase:
            self.phase, self._since, self._movement = phase, time, None

    def _watch(self, time: float, waited: float, view: OperatorView) -> None:
        """Correct the hand until the tool is seen where it is wanted; where the arm cannot get there, aim anew."""
        if waited < self._human.reaction:
            return
        X_WT, at_rest = self._perceived(time)
        if not at_rest and waited < self._human.patience:
            return
        X_WR = self._ready_pose()
        distance = float(np.linalg.norm(X_WR.translation - X_WT.translation))
        angle = float(rotation.angle(X_WR.quaternion, X_WT.quaternion))
        near = distance <= self._human.position_tolerance and angle <= self._human.rotation_tolerance
        if near or (self._corrections >= self._human.corrections and self._attempts >= self._human.attempts):
            self._enter(_Phase.DWELL, time)
            return
        if self._corrections >= self._human.corrections:
            self._attempts += 1
            self._reach_out(time, view, self._fresh_aim(view))
            return
        self._corrections += 1
        # Seen errors are corrected as errors: the hand turns on by what the tool still lacks.
        error = rotation.log(rotation.multiply(X_WR.quaternion, rotation.conjugate(X_WT.quaternion)))
        self._move(time, X_WR.translation - X_WT.translation, rotation.rotate(self._R_SW, error))

    def _supervise(self, time: float, view: OperatorView) -> None:
        after = self._plan[self._reach].then_take_over_after
        if view.automatic:
            # A trigger is let go of for as long as it is pressed, or the second press would not be one.
            released = self._since + self._human.press
            if after is not None and time >= max(self._triggered + after, released):
                self._enter(_Phase.TAKE_OVER, time)
        elif self._robot_began or time - self._triggered >= self._human.retrigger:
            self._trigger_not_before = time + self._human.retrigger
            # What the robot has refused is tried from another side; what it broke off, once more much the same.
            aim = self._adjusted_aim(view) if self._robot_began else self._fresh_aim(view)
            self._reach_out(time + self._human.reaction, view, aim)

    def _regain(self, time: float, view: OperatorView) -> None:
        waited = time - self._since
        if view.automatic:
            if waited >= self._human.retrigger:
                self._enter(_Phase.TAKE_OVER, time)
        elif waited >= self._human.reaction:
            self._reach += 1
            self._attempts = 0
            if self._reach == len(self._plan):
                self._enter(_Phase.DONE, time)
            else:
                self._reach_out(time, view, self._fresh_aim(view))

    def _reach_out(self, start: float, view: OperatorView, aim: Aim) -> None:
        """Begin the primary movement: relative in position, absolute in orientation, as the mapping is."""
        self._aim, self._corrections = aim, 0
        X_WR = self._ready_pose()
        R_SH = rotation.multiply(self._R_SW, X_WR.quaternion)
        turn = rotation.log(rotation.multiply(R_SH, rotation.conjugate(self._hand.X_SH.quaternion)))
        self._move(start, X_WR.translation - view.X_WT.translation, turn)

    def _move(self, start: float, displacement_W: Array, turn_S: Array) -> None:
        displacement = rotation.rotate(self._R_SW, displacement_W)
        self._enter(_Phase.MOVE, start)
        self._movement = Movement.towards(start, displacement, turn_S, self._human)

    def _perceived(self, time: float) -> tuple[Pose, bool]:
        """Return the tool as it was one reaction time ago, and whether it was at rest then."""
        past = [(t, X) for t, X in self._seen if t <= time - self._human.reaction + 1e-9] or [self._seen[0]]
        (t0, X0), (t1, X1) = past[0], past[-1]
        moved = float(np.linalg.norm(X1.translation - X0.translation))
        turned = float(rotation.angle(X1.quaternion, X0.quaternion))
        return X1, moved <= _REST_SPEED * (t1 - t0) and turned <= _REST_TURN * (t1 - t0)

    def _target(self) -> str:
        return self._plan[self._reach].object

    def _ready_pose(self) -> Pose:
        return self._aim.pose(self._known[self._target()], self._aims.middle)

    def _fresh_aim(self, view: OperatorView) -> Aim:
        others = [X for name, X in sorted(self._known.items()) if name != self._target()]
        return draw_aim(self._rng, self._known[self._target()], view.X_WT, others, self._aims)

    def _adjusted_aim(self, view: OperatorView) -> Aim:
        return adjust_aim(self._rng, self._aim, self._known[self._target()], view.X_WT, self._aims)
