"""The shared controller: the operator leads, and on a trigger the robot grasps what suits them both."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from optsc.checks import NonNegative, require
from optsc.control.activities import Following, HandInput, of_the_robot
from optsc.control.approach import Approach
from optsc.control.arbitration import Arbitration, Trigger
from optsc.control.controller_state import ControllerSnapshot, ControllerState, ControlStep
from optsc.control.displacement import displaced
from optsc.control.events import Parts, happening, leading_hand, tuned
from optsc.control.fine_tuning import FineTuning
from optsc.control.grasp_choice import GraspChoice
from optsc.control.holding import Holding
from optsc.control.jaws import JawSettings
from optsc.control.measured_arm import MeasuredArm, TrackingTolerance, opening_of
from optsc.control.mode_entry import ModeSettings, activity_of, after_event, touchable
from optsc.control.modes import Event, Mode
from optsc.control.placing import PlaceSettings
from optsc.control.policies import Alternating
from optsc.control.servo import Servo, ServoSettings
from optsc.control.status import error_text
from optsc.errors import InvalidValue
from optsc.followers.protocol import FollowerState
from optsc.geometry import Pose
from optsc.grasps import Candidates
from optsc.ik.avoidance import Avoidance
from optsc.operators import ClutchSettings, OperatorSample
from optsc.operators.clutch import recentred
from optsc.operators.smoothing import Smoothing
from optsc.robot import RobotModel
from optsc.selection import GraspSelector, Ranking
from optsc.selection.intent import IntentSettings
from optsc.selection.reach import ClearRows, ReachTable

_BEFORE_CONTACT = (Mode.APPROACH, Mode.ADJUST, Mode.ADVANCE)
"""The jaws have not closed yet. Later the object moves with the hand."""
_LOG = logging.getLogger(__name__)


class SharedController:
    """Shared control: the operator leads, and the robot helps as an arbitration policy says.

    By default alternating control after Chen et al. 2023: manual and automatic mode, changed over by a trigger.

    Args:
        robot: the arm, with a gripper.
        selector: ranks the candidate grasps.
        arbitration: how hand and robot share the motion, see `optsc.control.arbitration`.
        intent: how a belief over objects follows from the hand's motion; the most probable object is then the one
            that is intended. None: the one that is pointed at, but where the hand grasps or the robot helps it.
        fine_tuning: how far the operator may shift the grasp that the robot goes to; None for not at all.
        approach: how the robot moves by itself.
        clutch: how the hand's motion maps to the tool's.
        smoothing: how the hand is smoothed before that, if at all.
        servo: how targets are followed.
        solver: name of the QP solver.
        avoid: what the arm keeps clear of, with obstacles named like the objects; the hand may touch what it grasps.
        tracking: how far the arm may be off its command, and when a reading of it is believed.
        grasp_within: distance and angle to a grasp [m, rad] within which the trigger closes the jaws, where that is
            what it does; None for anywhere.
        jaws: what their measured opening means.
        place: how the robot puts down what it holds.
        debounce: presses of the trigger that are closer together than this count as one [s].
        real_time: whether no tick may take long: what the trigger asks for is then decided within 20 ms, and a new
            scene is taken in over some hundred ticks. Otherwise both are done at once, however long it takes.

    Attributes:
        servo: follows the target.
        state: all that ticks change, besides what is in the servo and the selector; see `snapshot`.

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
        tracking: TrackingTolerance | None = None,
        grasp_within: tuple[float, float] | None = (0.03, 0.35),
        jaws: JawSettings | None = None,
        place: PlaceSettings | None = None,
        debounce: float = 0.15,
        real_time: bool = True,
    ) -> None:
        require("debounce", debounce, NonNegative)
        if robot.gripper is None:
            raise InvalidValue("robot.gripper", None, "a gripper")
        self.robot, self.selector = robot, selector
        self.arbitration = arbitration or Alternating()
        self.approach = approach or Approach()
        self._modes = ModeSettings(
            robot,
            self.arbitration,
            self.approach,
            fine_tuning,
            robot.gripper.max_opening,
            jaws or JawSettings(),
            place or PlaceSettings(),
        )
        self._within, self._debounce = grasp_within, debounce
        self._servo_settings, self._solver, self._avoid = servo or ServoSettings(), solver, avoid
        if intent is None and (self.arbitration.assists or self.arbitration.trigger is Trigger.GRASPS):
            intent = IntentSettings()
        self._choice = GraspChoice(robot, selector, self.approach, intent, self.arbitration.aim, real_time=real_time)
        arm = MeasuredArm(tracking or TrackingTolerance())
        self.state = ControllerState(clutch or ClutchSettings(), smoothing, self._modes.open, arm=arm)
        self.reset(robot.home)

    def reset(self, q: ArrayLike, rate: float = 500.0) -> None:
        """Start at rest in configuration ``q`` (n,) [rad], for ticks at ``rate`` [Hz]; raise `InvalidValue`."""
        servo = Servo(self.robot, rate, self._servo_settings, self._solver, self._avoid)
        servo.reset(q)
        self.servo = servo
        self.selector.forget()
        clutch, smoothing, arm = self.state.clutch, self.state.smoothing, MeasuredArm(self.state.arm.tolerance)
        self.state = ControllerState(clutch, smoothing, self._modes.open, arm=arm)
        if self._avoid is not None:
            self._avoid.hand_may_touch()

    def snapshot(self) -> ControllerSnapshot:
        """Return the whole state as it is now: of this controller, its servo and its selector; see `restore`."""
        return ControllerSnapshot(self.state, self.servo.snapshot(), self.selector.state)

    def restore(self, snapshot: ControllerSnapshot) -> None:
        """Go on from a snapshot since the last reset, with the same bytes; raise `Mismatch` for another rate or arm."""
        self.servo.restore(snapshot.servo)
        self.state, self.selector.state = snapshot.state, snapshot.selector

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self.servo.time

    def time_at(self, now: float | None) -> float:
        """Return what `time` a tick would have that begins at ``now`` [s], see `step`."""
        return self.servo.time_at(now)

    @property
    def mode(self) -> Mode:
        """The control mode."""
        return self.state.mode

    @property
    def clutch(self) -> ClutchSettings:
        """How the hand's motion maps to the tool's."""
        return self.state.clutch

    @property
    def shown(self) -> Mapping[str, Pose]:
        """The grasp to mark for each object, tool poses in W."""
        return self._choice.shown(self.state.choice)

    @property
    def finished(self) -> bool:
        """Whether an object is held, and has been carried long enough."""
        return (
            self.mode is Mode.CARRY
            and self.state.held is not None
            and self.time - self.state.entered >= self.approach.carry_time
        )

    @property
    def ranking(self) -> Ranking | None:
        """The newest ranking, None before there are candidates; its ``best`` is the intended object."""
        return self.state.choice.ranking

    def observe(self, candidates: Candidates, clear: ClearRows | None = None, table: ReachTable | None = None) -> None:
        """Take in the candidate grasps of the scene as it is now.

        Before the first tick after a reset they are all solved and scored here. During a run in real time that is done
        by the ticks that follow, a few grasps at each; until all are done those known before stay in use, but for those
        that are no longer there, and `ControlStep.ranking` is still of them.

        ``clear`` tells which of them the arm can execute without touching what it should not, see
        `optsc.collision.GraspClearance`. Vetoes and beliefs begin again. If the object that the robot is on its way to
        has moved or is gone, the next tick is a fault. Where this raises, as a collision check may, nothing changes.
        A ``table`` of these candidates that was solved elsewhere (`optsc.selection.ReachSolver.table`), in another
        process for one, is in use after a few ticks.

        Raises `InvalidValue` for what are no candidates, and for a table that does not fit.
        """
        if not isinstance(candidates, Candidates):
            raise InvalidValue("candidates", type(candidates).__name__, "Candidates")
        state, doubt = self.state, self.state.doubt
        if state.target is not None and state.mode in _BEFORE_CONTACT:
            doubt = displaced(state.target, state.choice.candidates, candidates)
        before = self.selector.state
        try:
            choice = self._choice.observed(state.choice, self.servo, candidates, clear, table)
        except BaseException:
            self.selector.state = before
            raise
        self.state = state._replace(choice=choice, doubt=doubt, moved=frozenset())

    def hold(self, reason: str) -> None:
        """Hold from the next tick on, for a reason: the arm comes to rest, and only the operator goes on."""
        self._change(Event.FAULT)
        self._set(stop=reason)

    def recentre(self) -> None:
        """Turn the operator's station about the vertical so that the hand now heads where the tool does.

        Without effect before the first sample. In manual mode the hand is coupled again, so the target stays.
        """
        hand = self.state.monitor.hand
        if hand is None:
            return
        self._set(clutch=recentred(self.clutch, hand, self.servo.reference[1]))
        self._couple_again()

    def couple_by(self, clutch: ClutchSettings, smoothing: Smoothing | None) -> None:
        """Map and smooth the hand in another way from now on. In manual mode it is coupled again: the target stays."""
        self._set(clutch=clutch, smoothing=smoothing)
        activity = self.state.activity
        self._couple_again(isinstance(activity, Following) and activity.coupling.keeps_offset)

    def _couple_again(self, keeps_offset: bool = False) -> None:
        if self.mode is Mode.MANUAL:
            self._set(activity=activity_of(self._modes, self.state, self.servo, keeps_offset))

    def step(self, sample: OperatorSample | None, measured: FollowerState, now: float | None = None) -> ControlStep:
        """Do one tick; never raises.

        A tick that fails, in a policy or a cost of the user's for example, is taken back as a whole; in its place the
        arm begins to come to rest, the mode is hold, and the reason is the error.

        Args:
            sample: the operator's newest sample, None when there is none since the last tick.
            measured: the follower's state.
            now: what time it is [s], on a clock of any origin that does not go back, see `Servo.step`; one period after
                the last tick by default.
        """
        self.servo.begin(now)
        before: ControllerSnapshot | None = None
        try:
            before = self.snapshot()
            step = self._tick(sample, measured)
        except Exception as error:  # noqa: BLE001 - whatever a part of the user's raises, the arm must stop
            return self._halted(self._taken_back(before) or error)
        except BaseException:
            self._taken_back(before)
            raise
        if self.state.failure:
            self._set(failure="")
        return step

    def _tick(self, sample: OperatorSample | None, measured: FollowerState) -> ControlStep:
        before = self.mode
        monitor, given = self.state.monitor.read(sample, self.time, self.servo.state.loop.zero)
        if monitor is not self.state.monitor:
            self._set(monitor=monitor)
        modes = self._modes
        jaws, change = self.state.jaws.updated(modes.jaws, modes.open, self.servo.period, opening_of(measured))
        elapsed = self.servo.period + self.servo.state.loop.late
        self._set(jaws=jaws, arm=self.state.arm.updated(self.robot, elapsed, measured))
        parts = Parts(modes, self._choice, self.servo, self._within, self._debounce)
        spent = self.state.choice.deciding is not None or self.state.choice.spent == self.servo.state.ticks
        self.state, event, reason = happening(parts, self.state, given, change)
        self._change(event)
        tuning = self.state.tuning
        self.state, untunable = tuned(parts, self.state, given)
        after = self.state.tuning
        spent = spent or (tuning is not None and after is not None and after.was_checked_since(tuning))
        reason = reason or untunable
        time, mode, choice = self.time, self.mode, self.state.choice
        hand = HandInput(monitor.hand, given.new, monitor.clutch, choice.goals, choice.belief.gap, self.state.arm)
        activity, outcome = self.state.activity.step(self.servo, hand, opening_of(measured))
        if mode.automatic:
            outcome = of_the_robot(outcome)
        if activity is not self.state.activity:
            self._set(activity=activity)
        if outcome.event is not None:
            event = self._awaited(outcome.event)
            self._change(event)
        reason = outcome.reason or reason
        choice, trouble = self._choice.worked(
            self.state.choice,
            self.servo,
            leading_hand(self.state),
            self.clutch,
            ranks=not mode.automatic,
            spent=spent or self.state.choice.deciding is not None,
        )
        reason = reason or trouble
        if choice is not self.state.choice:
            self._set(choice=choice)
        if not mode.automatic:
            self._allow_contact()
        stop = self._reason_of_stop(before, event, reason)
        if self.finished and not self.state.counted:
            self._set(tasks=self.state.tasks + 1, counted=True)
        state = self.state
        command = self.servo.timed(outcome.command)
        return ControlStep(
            time,
            mode,
            event,
            command,
            state.opening,
            choice.ranking,
            state.target,
            (reason if stop in reason else f"{stop}; {reason}" if reason else stop) or command.reason,
            choice.probabilities,
            outcome.assistance,
            state.held,
        )

    def _taken_back(self, before: ControllerSnapshot | None) -> Exception | None:
        """Take a tick back; return what avoidance, which may be a user's, raised at that, if it did."""
        if before is None:
            return None
        self.state, self.selector.state = before.state, before.selector
        try:
            self.servo.restore(before.servo)
        except Exception as error:  # noqa: BLE001 - all else has been restored by then
            return error
        return None

    def _halted(self, error: Exception) -> ControlStep:
        """Begin to come to rest by the joint limits alone, and hold."""
        reason, time = error_text(error), self.time
        if reason != self.state.failure:
            # Not at every tick of a failure that lasts: a traceback takes longer than the tick.
            _LOG.error("a control tick failed; the arm comes to rest", exc_info=error)
        command = self.servo.timed(self.servo.halt(reason))
        self.servo.forget()
        choice = self.state.choice._replace(deciding=None)
        rest = {"mode": Mode.HOLD, "activity": Holding(), "target": None, "tuning": None}
        self._set(entered=self.time, choice=choice, failure=reason, stop=reason, **rest)
        state = self.state
        return ControlStep(
            *(time, Mode.HOLD, Event.FAULT, command, state.opening, self.ranking, None, reason), held=state.held
        )

    def _set(self, **changes: Any) -> None:
        self.state = self.state._replace(**changes)

    def _reason_of_stop(self, before: Mode, event: Event | None, reason: str) -> str:
        """Keep and return why the arm holds, so that it can be read for as long as it does; empty in other modes."""
        stop = self.state.stop
        if self.mode is not Mode.HOLD:
            stop = ""
        elif before is not Mode.HOLD or event in (Event.FAULT, Event.SLIPPED, Event.LOST):
            stop = reason or stop
        if stop != self.state.stop:
            self._set(stop=stop)
        return stop

    def _awaited(self, event: Event) -> Event | None:
        """Return the event as it is, or, at the pre-grasp, that the operator is waited for.

        While another grasp is looked for, the robot does not go on to the one it comes from.
        """
        if event is Event.ARRIVED and self.state.choice.deciding is not None:
            return None
        tuning = self._modes.fine_tuning
        waits = tuning is not None and tuning.wait and not self.state.confirmed
        return Event.WAITED if self.mode is Mode.APPROACH and event is Event.ARRIVED and waits else event

    def _change(self, event: Event | None) -> None:
        mode = self.mode
        self.state = after_event(self._modes, self.state, self.servo, event)
        if self.mode is not mode and self.state.choice.deciding is not None:
            self._set(choice=self.state.choice._replace(deciding=None))
        self._allow_contact()

    def _allow_contact(self) -> None:
        """Let the hand touch the object that it is grasping, and no other obstacle of the avoidance."""
        if self._avoid is None:
            return
        state = self.state
        by_hand = self.arbitration.trigger is Trigger.GRASPS and self.ranking is not None
        intended = self.ranking.best if by_hand and self.ranking is not None else None
        name = touchable(state.mode, state.target, intended, state.touchable)
        if name != state.touchable:
            self._set(touchable=name)
            self._avoid.hand_may_touch(name if name in self._avoid.obstacles else None)
