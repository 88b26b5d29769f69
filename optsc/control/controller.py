"""The shared controller: the operator leads, and on a trigger the robot grasps what suits them both."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.control.activities import Activity, Closing, Following, HandInput, Resting, Standing, Travelling
from optsc.control.approach import Approach
from optsc.control.modes import Event, Mode, next_mode
from optsc.control.rollout import can_travel
from optsc.control.servo import Command, Servo, ServoSettings
from optsc.errors import InvalidValue
from optsc.followers.protocol import FollowerState
from optsc.geometry import Pose
from optsc.geometry.scalar import Quaternion, Vector
from optsc.grasps import Candidates
from optsc.operators import ClutchSettings, OperatorSample, fault_of
from optsc.operators.clutch import Hand, recentred
from optsc.operators.smoothing import Smoothing
from optsc.robot import RobotModel
from optsc.selection import GraspSelector, Ranking, Target
from optsc.selection.reach import ClearRows

RANKING_PERIOD = 0.02
"""How often the candidates are ranked against the moving hand [s]; a display shows no more."""
IDLE_ROWS = 4
"""Grasps solved anew between two rankings, those from the most distant posture first."""
DECISION_ROWS = 64
"""Finalists solved anew at most when the trigger is pressed: what is chosen then must be right."""
CHOICES = 40
"""How many grasps are looked at, best first, for one that the arm can go to on a straight way."""
LARGEST_LAG = 0.3
"""Difference of measured and commanded joint position [rad] that means the arm does not follow."""


class ControlStep(NamedTuple):
    """What the controller decided at one tick.

    Attributes:
        time: since the reset [s].
        mode: the mode of this tick.
        event: what happened at this tick, if anything.
        command: the joint command.
        opening: commanded distance of the jaws [m].
        ranking: the newest ranking, None before there are candidates.
        target: the grasp that is being executed, None in manual mode.
        reason: why motion is held back or a wish refused, in words; empty when all is well.
    """

    time: float
    mode: Mode
    event: Event | None
    command: Command
    opening: float
    ranking: Ranking | None
    target: Target | None
    reason: str


class SharedController:
    """Alternating shared control after Chen et al. 2023: manual and automatic mode, changed over by a trigger.

    Args:
        robot: the arm, with a gripper.
        selector: ranks the candidate grasps.
        approach: how the robot moves by itself.
        clutch: how the hand's motion maps to the tool's.
        smoothing: how the hand is smoothed before that, if at all.
        servo: how targets are followed.
        solver: name of the QP solver.

    Raises:
        InvalidValue: the robot has no gripper, or the selector's standoff differs from the approach's.
    """

    def __init__(
        self,
        robot: RobotModel,
        selector: GraspSelector,
        *,
        approach: Approach | None = None,
        clutch: ClutchSettings | None = None,
        smoothing: Smoothing | None = None,
        servo: ServoSettings | None = None,
        solver: str = "daqp",
    ) -> None:
        if robot.gripper is None:
            raise InvalidValue("robot.gripper", None, "a gripper")
        self.robot, self.selector = robot, selector
        self.approach, self.clutch = approach or Approach(), clutch or ClutchSettings()
        self._smoothing = smoothing
        self._servo_settings, self._solver = servo or ServoSettings(), solver
        self._open = robot.gripper.max_opening
        self.reset(robot.home)

    def reset(self, q: ArrayLike, rate: float = 500.0) -> None:
        """Start at rest in posture ``q`` (n,) [rad], in hold, for ticks at ``rate`` [Hz]; raise `InvalidValue`."""
        self.servo = Servo(self.robot, rate, self._servo_settings, self._solver)
        self.servo.reset(q)
        self.mode = Mode.HOLD
        self._activity: Activity = Resting()
        self._entered = 0.0
        self._hand: Hand | None = None
        self._clutch = self._trigger = False
        self._stamp: float | None = None
        self._candidates: Candidates | None = None
        self.ranking: Ranking | None = None
        self._ranked, self._refreshed = -np.inf, True
        self._target: Target | None = None
        self._opening = self._open

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self.servo.time

    @property
    def finished(self) -> bool:
        """Whether an object has been carried long enough."""
        return self.mode is Mode.CARRY and self.time - self._entered >= self.approach.carry_time

    def observe(self, candidates: Candidates, clear: ClearRows | None = None) -> None:
        """Take in the candidate grasps of the scene as it is now: solves and scores them all, which takes a while.

        ``clear`` tells which of them the arm can carry out without touching what it should not, see
        `optsc.selection.GraspClearance`.
        """
        self._candidates = candidates
        self.selector.observe(candidates, self.servo.guard.q.copy(), clear=clear)
        self._ranked = -np.inf

    def recentre(self) -> None:
        """Turn the operator's station about the vertical so that the hand now heads where the tool does.

        Without effect before the first sample. In manual mode the hand is coupled anew, so the target stays.
        """
        if self._hand is None:
            return
        self.clutch = recentred(self.clutch, self._hand, self.servo.reference[1])
        if self.mode is Mode.MANUAL:
            self._activity = self._activity_for(Mode.MANUAL)

    def step(self, sample: OperatorSample | None, measured: FollowerState) -> ControlStep:
        """Do one tick; never raises on bad input.

        Args:
            sample: the operator's newest sample, None when there is none since the last tick.
            measured: the follower's state.
        """
        event, reason, new = self._read(sample)
        fault = self._fault(measured)
        if fault:
            event, reason = Event.FAULT, fault
        if event is Event.TRIGGERED and self.mode is Mode.MANUAL:
            refusal = self._choose()
            event, reason = (None, refusal) if refusal else (event, reason)
        if (
            self.mode is Mode.HOLD
            and next_mode(self.mode, event) is not Mode.HOLD
            and self._lag(measured) > LARGEST_LAG
        ):
            # Something stopped the arm. It goes on from where it is: its old command would push it there again.
            self.servo.reset_posture(measured.q)
        self._change(event)
        time, mode = self.time, self.mode
        outcome = self._activity.step(self.servo, HandInput(self._hand, new, self._clutch), measured.opening)
        if outcome.event is not None:
            event = outcome.event
            self._change(event)
        reason = outcome.reason or reason
        if not mode.automatic:
            self._rank_if_due()
        return ControlStep(
            time,
            mode,
            event,
            outcome.command,
            self._opening,
            self.ranking,
            self._target,
            reason or outcome.command.reason,
        )

    def _read(self, sample: OperatorSample | None) -> tuple[Event | None, str, bool]:
        """Take in a sample: the event in it, what is wrong with it, and whether it moved the hand."""
        if sample is None:
            lost = self._stamp is not None and self.time - self._stamp > self.servo.settings.timeout
            if lost and self.mode.automatic:
                # Whoever cannot be heard cannot step in.
                return Event.FAULT, "the operator's samples have stopped", False
            return None, "", False
        fault = fault_of(sample, self._stamp)
        if fault:
            return Event.FAULT, f"operator sample refused: {fault}", False
        engaged, triggered = sample.clutch and not self._clutch, sample.trigger and not self._trigger
        self._clutch, self._trigger, self._stamp = bool(sample.clutch), bool(sample.trigger), sample.stamp
        p, q = sample.X_SH.translation.tolist(), sample.X_SH.quaternion.tolist()
        self._hand = Hand(tuple(p), tuple(q), sample.stamp)
        return Event.TRIGGERED if triggered else Event.ENGAGED if engaged else None, "", True

    def _fault(self, measured: FollowerState) -> str:
        lag = self._lag(measured)
        if lag != lag:
            return "the measured posture is not finite"
        # While holding it is known already, and must not keep the operator from leading the arm away.
        if lag > LARGEST_LAG and self.mode is not Mode.HOLD:
            return f"the arm is {lag:.2f} rad off its command"
        return ""

    def _lag(self, measured: FollowerState) -> float:
        return float(np.abs(measured.q - self.servo.guard.q).max())

    def _rank_if_due(self) -> None:
        if self._candidates is None:
            return
        if self.time - self._ranked >= RANKING_PERIOD:
            self._rank()
        elif not self._refreshed:
            # Between two rankings, grasps that were out of reach from where the arm stood get another chance.
            self.selector.refresh_oldest(self.servo.guard.q, IDLE_ROWS)
            self._refreshed = True

    def _rank(self, refresh_limit: int | None = None) -> None:
        p, q = self.servo.reference
        X_WT = Pose(np.array(q), np.array(p))
        self.ranking = self.selector.rank(X_WT, self.servo.guard.q.copy(), refresh_limit=refresh_limit)
        self._ranked, self._refreshed = self.time, False

    def _choose(self) -> str:
        """Rank against the hand as it is now and fix the target; otherwise say why there is none.

        The target is the best grasp that the arm can go to on the straight way it will be sent along.
        """
        if self._candidates is None:
            return "there are no grasps"
        self._rank(refresh_limit=DECISION_ROWS)
        ranking = self.ranking
        if ranking is None or ranking.best is None:
            return "no grasp can be reached"
        p, q = self.servo.reference
        start, posture = Pose(np.array(q), np.array(p)), self.servo.guard.q.copy()
        for candidate in ranking.of(ranking.best)[:CHOICES]:
            target = ranking.target_of(int(candidate))
            if can_travel(self.robot, self.approach, posture, [start, target.X_WP, target.X_WG]):
                self._target = target
                return ""
        return f"no grasp of the {ranking.best} can be reached on a straight way"

    def _change(self, event: Event | None) -> None:
        mode = next_mode(self.mode, event)
        if mode is self.mode and not (event is Event.FAULT and mode is Mode.HOLD):
            return
        self.mode, self._entered = mode, self.time
        self._activity = self._activity_for(mode)

    def _activity_for(self, mode: Mode) -> Activity:
        servo, target = self.servo, self._target
        if mode is Mode.HOLD:
            servo.forget()
            self._target = None
            return Resting()
        if mode is Mode.MANUAL or target is None:
            servo.forget()
            self._target = None
            servo.ik.prefer(self.robot.home)
            return Following(self.clutch, self._smoothing)
        if mode is Mode.APPROACH:
            self._opening = self._open
            servo.ik.prefer(target.q)
            return Travelling(self.approach, servo, *_pose(target.X_WP))
        if mode is Mode.ADVANCE:
            return Travelling(self.approach, servo, *_pose(target.X_WG))
        if mode is Mode.CLOSE:
            self._opening = 0.0
            return Closing(servo)
        if mode is Mode.LIFT:
            (x, y, z), q = servo.reference
            return Travelling(self.approach, servo, (x, y, z + self.approach.lift), q)
        return Standing(servo)


def _pose(X: Pose) -> tuple[Vector, Quaternion]:
    return tuple(X.translation.tolist()), tuple(X.quaternion.tolist())
