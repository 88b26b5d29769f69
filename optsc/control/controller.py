"""The shared controller: the operator leads, and on a trigger the robot grasps what suits them both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.control.activities import (
    Activity,
    Adjusting,
    Assistance,
    Closing,
    Following,
    HandInput,
    Resting,
    Standing,
    Travelling,
)
from optsc.control.approach import Approach
from optsc.control.arbitration import Arbitration, Trigger
from optsc.control.assisted import Assisted
from optsc.control.choosing import ON_THE_WAY, Choosing, displaced
from optsc.control.fine_tuning import FineTuning, Scene, Shift, Tuner, hand_nudge
from optsc.control.listening import Heard, Listener
from optsc.control.modes import TRANSITIONS, Event, Mode, next_mode
from optsc.control.policies import Alternating
from optsc.control.servo import Command, Servo, ServoSettings
from optsc.control.touching import Touching
from optsc.errors import InvalidValue
from optsc.followers.protocol import FollowerState
from optsc.geometry import Pose
from optsc.geometry.scalar import Quaternion, Vector
from optsc.grasps import Candidates
from optsc.ik import Avoidance
from optsc.operators import Button, ClutchSettings, OperatorSample
from optsc.operators.clutch import Hand, recentred
from optsc.operators.smoothing import Smoothing
from optsc.robot import RobotModel
from optsc.selection import GraspSelector, Ranking, Target
from optsc.selection.intent import IntentSettings
from optsc.selection.reach import ClearRows

LARGEST_LAG = 0.3
"""Difference of measured and commanded joint position [rad] that means the arm does not follow."""
RETRY = 1.0
"""Time [s] after which a robot that begins by itself tries again, where it found no way."""
_TUNABLE = (Mode.APPROACH, Mode.ADJUST)


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
        belief: how likely each object is meant, where a belief is kept.
        assistance: how the hand's wish and the robot's were blended, where they were.
    """

    time: float
    mode: Mode
    event: Event | None
    command: Command
    opening: float
    ranking: Ranking | None
    target: Target | None
    reason: str
    belief: Mapping[str, float] | None = None
    assistance: Assistance | None = None


class SharedController:
    """Shared control: the operator leads, and the robot helps, as an arbitration policy has it.

    By default alternating control after Chen et al. 2023: manual and automatic mode, changed over by a trigger.

    Args:
        robot: the arm, with a gripper.
        selector: ranks the candidate grasps.
        arbitration: how hand and robot share the motion, see `optsc.control.arbitration`.
        intent: how a belief over objects follows from the hand's motion; the most probable object is then the one
            that is meant. None: the one that is pointed at, but where the hand grasps or the robot helps it.
        fine_tuning: how far the operator may shift the grasp that the robot goes to; None for not at all.
        approach: how the robot moves by itself.
        clutch: how the hand's motion maps to the tool's.
        smoothing: how the hand is smoothed before that, if at all.
        servo: how targets are followed.
        solver: name of the QP solver.
        avoid: what the arm keeps clear of, with obstacles named like the objects; the hand may touch what it grasps.
        grasp_within: distance and angle to a grasp [m, rad] within which the trigger closes the jaws, where that is
            what it does; None for anywhere.

    Raises:
        InvalidValue: the robot has no gripper, or the selector's standoff differs from the approach's.
    """

    def __init__(
        self,
        robot: RobotModel,
        selector: GraspSelector,
        *,
        arbitration: Arbitration | None = None,
        intent: IntentSettings | None = None,
        fine_tuning: FineTuning | None = None,
        approach: Approach | None = None,
        clutch: ClutchSettings | None = None,
        smoothing: Smoothing | None = None,
        servo: ServoSettings | None = None,
        solver: str = "daqp",
        avoid: Avoidance | None = None,
        grasp_within: tuple[float, float] | None = (0.03, 0.35),
    ) -> None:
        if robot.gripper is None:
            raise InvalidValue("robot.gripper", None, "a gripper")
        self.robot, self.selector = robot, selector
        self.arbitration = arbitration or Alternating()
        self.approach, self.clutch = approach or Approach(), clutch or ClutchSettings()
        self._smoothing, self._tuning, self._within = smoothing, fine_tuning, grasp_within
        self._servo_settings, self._solver, self._avoid = servo or ServoSettings(), solver, avoid
        if intent is None and (self.arbitration.assists or self.arbitration.trigger is Trigger.GRASPS):
            intent = IntentSettings()
        self._choosing = Choosing(robot, selector, self.approach, intent, self.arbitration.aim)
        self._open = robot.gripper.max_opening
        self.reset(robot.home)

    def reset(self, q: ArrayLike, rate: float = 500.0) -> None:
        """Start at rest in posture ``q`` (n,) [rad], in hold, for ticks at ``rate`` [Hz]; raise `InvalidValue`."""
        self.servo = Servo(self.robot, rate, self._servo_settings, self._solver, self._avoid)
        self.servo.reset(q)
        self.mode = Mode.HOLD
        self._activity: Activity = Resting()
        self._entered = 0.0
        self._listener = Listener()
        self._choosing.forget()
        self._touching = Touching(self._avoid)
        self._target: Target | None = None
        self._tuner: Tuner | None = None
        self._confirmed = self._stepped_in = False
        self._tried = -np.inf
        self._opening = self._open
        self._doubt = ""

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self.servo.time

    @property
    def shown(self) -> Mapping[str, Pose]:
        """The grasp to mark for each object, tool poses in W."""
        return self._choosing.shown

    @property
    def finished(self) -> bool:
        """Whether an object has been carried long enough."""
        return self.mode is Mode.CARRY and self.time - self._entered >= self.approach.carry_time

    @property
    def ranking(self) -> Ranking | None:
        """The newest ranking, None before there are candidates; its ``best`` is the object that is meant."""
        return self._choosing.ranking

    def observe(self, candidates: Candidates, clear: ClearRows | None = None) -> None:
        """Take in the candidate grasps of the scene as it is now: solves and scores them all, which takes a while.

        ``clear`` tells which of them the arm can carry out without touching what it should not, see
        `optsc.selection.GraspClearance`. Vetoes and beliefs begin anew. If the object that the robot is on its way to
        has moved or is gone, the next tick is a fault.
        """
        if self._target is not None and self.mode in ON_THE_WAY:
            self._doubt = displaced(self._target, self._choosing.candidates, candidates)
        self._choosing.observe(candidates, self.servo.guard.q.copy(), clear)

    def recentre(self) -> None:
        """Turn the operator's station about the vertical so that the hand now heads where the tool does.

        Without effect before the first sample. In manual mode the hand is coupled anew, so the target stays.
        """
        if self._listener.hand is None:
            return
        self.clutch = recentred(self.clutch, self._listener.hand, self.servo.reference[1])
        if self.mode is Mode.MANUAL:
            self._activity = self._activity_for(Mode.MANUAL)

    def step(self, sample: OperatorSample | None, measured: FollowerState) -> ControlStep:
        """Do one tick; never raises on bad input.

        Args:
            sample: the operator's newest sample, None when there is none since the last tick.
            measured: the follower's state.
        """
        heard = self._listener.hear(sample)
        event, reason = self._decide(heard, measured)
        if (
            self.mode is Mode.HOLD
            and next_mode(self.mode, event) is not Mode.HOLD
            and self._lag(measured) > LARGEST_LAG
        ):
            # Something stopped the arm. It goes on from where it is: its old command would push it there again.
            self.servo.reset_posture(measured.q)
        self._change(event)
        time, mode, listener, choosing = self.time, self.mode, self._listener, self._choosing
        reason = reason or self._tune(heard)
        hand = HandInput(listener.hand, heard.new, listener.clutch, choosing.goals, choosing.belief.gap)
        outcome = self._activity.step(self.servo, hand, measured.opening)
        if outcome.event is not None:
            event = self._awaited(outcome.event)
            self._change(event)
        reason = outcome.reason or reason
        if not mode.automatic:
            choosing.follow(self.servo, self._leading_hand(), self.clutch)
            self._touching.see(self.mode, self._target, self._meant_by_hand())
        belief = choosing.belief
        return ControlStep(
            time,
            mode,
            event,
            outcome.command,
            self._opening,
            self.ranking,
            self._target,
            reason or outcome.command.reason,
            dict(zip(belief.names, belief.probability.tolist(), strict=True)) if belief.names else None,
            outcome.assistance,
        )

    def _decide(self, heard: Heard, measured: FollowerState) -> tuple[Event | None, str]:
        """Return what happens at this tick before anything moves, and what is wrong or refused, in words."""
        fault = self._fault(measured)
        if fault:
            return Event.FAULT, fault
        event, reason = heard.event, heard.reason
        silent = not heard.new and self._listener.silent(self.time, self.servo.settings.timeout)
        if event is None and silent and self.mode.automatic:
            # Whoever cannot be heard cannot step in.
            return Event.FAULT, "the operator's samples have stopped"
        if event is Event.FAULT:
            return event, reason
        if self.mode is Mode.MANUAL:
            return self._decide_by_hand(event, heard)
        if self.mode.automatic and event is not Event.TRIGGERED and heard.pressed:
            return self._decide_by_button(event, heard.pressed)
        return event, reason

    def _decide_by_hand(self, event: Event | None, heard: Heard) -> tuple[Event | None, str]:
        if Button.VETO in heard.pressed:
            return event, self._choosing.veto(None)
        if event is Event.TRIGGERED and self.arbitration.trigger is Trigger.GRASPS:
            return self._grasp_here()
        begins = event is None and self._begins_by_itself()
        if event is not Event.TRIGGERED and not begins:
            return event, ""
        refusal = self._choosing.choose(self.servo, self._leading_hand(), self.clutch)
        if refusal:
            return None, refusal
        self._target = self._choosing.target
        return (Event.BEGUN if begins else event), ""

    def _grasp_here(self) -> tuple[Event | None, str]:
        if self._opening < self._open:
            self._opening = self._open
            return None, "the jaws open"
        refusal = self._choosing.near(self.servo, self._within)
        if refusal:
            return None, refusal
        self._target = self._choosing.target
        return Event.GRASPED, ""

    def _begins_by_itself(self) -> bool:
        if self._stepped_in or not self._listener.clutch or self.time - self._tried < RETRY:
            return False
        meant_for = min(self._choosing.meant_for(self.time), self.time - self._entered)
        if self.ranking is None or self.ranking.best is None or not self.arbitration.begins(meant_for):
            return False
        self._tried = self.time
        return True

    def _decide_by_button(self, event: Event | None, pressed: frozenset[Button]) -> tuple[Event | None, str]:
        if Button.CANCEL in pressed:
            return Event.CANCELLED, ""
        if self.mode not in _TUNABLE:
            return event, ""
        if Button.NEXT in pressed or Button.VETO in pressed:
            done = self._choosing.veto(self._target) if Button.VETO in pressed else ""
            refusal = self._choosing.next(self.servo)
            if not refusal:
                self._target = self._choosing.target
                return Event.RETARGETED, done
            # What was refused must not be grasped; what was merely the best may.
            return (Event.CANCELLED if done else event), "; ".join(filter(None, (done, refusal)))
        if Button.CONFIRM in pressed:
            self._confirmed = True
            return (Event.CONFIRMED if self.mode is Mode.ADJUST else event), ""
        return event, ""

    def _awaited(self, event: Event) -> Event:
        """Return the event as it is, or, at the pre-grasp, that the operator is waited for."""
        waits = self._tuning is not None and self._tuning.wait and not self._confirmed
        return Event.WAITED if self.mode is Mode.APPROACH and event is Event.ARRIVED and waits else event

    def _tune(self, heard: Heard) -> str:
        """Shift the grasp that the robot goes to as the operator nudges it; say why it cannot be."""
        if self._tuner is None or self.mode not in _TUNABLE or self._target is None:
            return ""
        listener = self._listener
        if heard.nudge is not None:
            self._tuner.push(heard.nudge)
        if Button.NUDGE in listener.buttons and heard.new and heard.moved_from and listener.hand:
            grasp = _pose(self._target.X_WG)[1]
            self._tuner.push(hand_nudge(self.clutch, heard.moved_from, listener.hand, grasp))
        reason = self._tuner.settle(self.time)
        if self._tuner.tuned.target is not self._target:
            self._target = self._tuner.tuned.target
            if isinstance(self._activity, (Travelling, Adjusting)):
                self._activity.lead(*_pose(self._target.X_WP))
        return reason

    def _fault(self, measured: FollowerState) -> str:
        lag = self._lag(measured)
        if lag != lag:
            return "the measured posture is not finite"
        # While holding it is known already, and must not keep the operator from leading the arm away.
        if lag > LARGEST_LAG and self.mode is not Mode.HOLD:
            return f"the arm is {lag:.2f} rad off its command"
        doubt, self._doubt = self._doubt, ""
        return doubt

    def _lag(self, measured: FollowerState) -> float:
        return float(np.abs(measured.q - self.servo.guard.q).max())

    def _change(self, event: Event | None) -> None:
        """Enter the mode that follows on an event, if one does; some events begin the same mode anew."""
        if event is None or (self.mode, event) not in TRANSITIONS:
            return
        mode = next_mode(self.mode, event)
        self._stepped_in = mode is not Mode.HOLD and (self._stepped_in or self.mode.automatic)
        self.mode, self._entered = mode, self.time
        self._activity = self._activity_for(mode)
        self._touching.see(mode, self._target, self._meant_by_hand())

    def _leading_hand(self) -> Hand | None:
        """Return the hand while it is coupled to the tool."""
        leads = self.mode is Mode.MANUAL and self._listener.clutch
        return self._listener.hand if leads else None

    def _meant_by_hand(self) -> str | None:
        """Return the object that the hand may be about to grasp, where the hand is what grasps."""
        by_hand = self.mode is Mode.MANUAL and self.arbitration.trigger is Trigger.GRASPS
        return self.ranking.best if by_hand and self.ranking is not None else None

    def _activity_for(self, mode: Mode) -> Activity:
        servo, target = self.servo, self._target
        if mode in (Mode.HOLD, Mode.MANUAL):
            servo.forget()
            self._target = self._tuner = None
            if mode is Mode.HOLD:
                return Resting()
            servo.ik.prefer(self.robot.home)
            if self.arbitration.assists:
                return Assisted(self.clutch, self._smoothing, self.arbitration, self.approach)
            return Following(self.clutch, self._smoothing)
        if mode is Mode.APPROACH and target is not None:
            self._opening, self._confirmed = self._open, False
            servo.ik.prefer(target.q)
            return Travelling(self.approach, servo, *_pose(target.X_WP), self._tunable(target))
        if mode is Mode.ADJUST and self._tuning is not None:
            return Adjusting(servo, Shift(self._tuning.speed))
        if mode is Mode.ADVANCE and target is not None:
            return Travelling(self.approach, servo, *_pose(target.X_WG))
        if mode is Mode.CLOSE:
            self._opening = 0.0
            return Closing(servo)
        if mode is Mode.LIFT:
            (x, y, z), q = servo.reference
            return Travelling(self.approach, servo, (x, y, z + self.approach.lift), q)
        return Standing(servo)

    def _tunable(self, target: Target) -> Shift | None:
        """Begin to tune a grasp; return what the path to it can be shifted by."""
        settings, choosing = self._tuning, self._choosing
        if settings is None or choosing.candidates is None:
            return None
        scene = Scene(self.robot, self.approach, choosing.candidates, choosing.clear)
        self._tuner = Tuner(settings, scene, target, self.time)
        return Shift(settings.speed)


def _pose(X: Pose) -> tuple[Vector, Quaternion]:
    return tuple(X.translation.tolist()), tuple(X.quaternion.tolist())
