"""Events of a tick: what the operator's input and the arm's state mean in the present mode, before anything moves."""

from __future__ import annotations

from typing import NamedTuple

from optsc.control.activities import Adjusting, Travelling
from optsc.control.arbitration import Trigger
from optsc.control.controller_state import ControllerState
from optsc.control.fine_tuning import hand_nudge
from optsc.control.grasp_choice import GraspChoice
from optsc.control.holding import Holding, elsewhere, unready
from optsc.control.jaws import GripStatus, JawChange
from optsc.control.measured_arm import tracking_error
from optsc.control.mode_entry import ModeSettings, pose_of, released
from optsc.control.modes import TRANSITIONS, Event, Mode
from optsc.control.operator_input import OperatorInput
from optsc.control.placing import can_lower
from optsc.control.servo import Servo
from optsc.operators import Button
from optsc.operators.clutch import Hand
from optsc.operators.jumps import TrackedHand

RETRY = 1.0
"""Time [s] after which a robot that begins by itself tries again, where it found no path."""
_TUNABLE = (Mode.APPROACH, Mode.ADJUST)
_RELIES_ON_JAWS = (Mode.CLOSE, Mode.LIFT, Mode.CARRY, Mode.PLACE, Mode.RELEASE)


class Parts(NamedTuple):
    """What is asked to find out what happens.

    Attributes:
        modes: what the modes are made with.
        choice: chooses grasps.
        servo: follows the target.
        within: distance and angle to a grasp [m, rad] within which the trigger closes the jaws; None for anywhere.
        debounce: presses of the trigger that are closer together than this count as one [s].
    """

    modes: ModeSettings
    choice: GraspChoice
    servo: Servo
    within: tuple[float, float] | None
    debounce: float


class Happening(NamedTuple):
    """The state after it is known what happens, the event, if any, and what is wrong or refused, in words."""

    state: ControllerState
    event: Event | None = None
    reason: str = ""


def happening(parts: Parts, state: ControllerState, given: OperatorInput, change: JawChange) -> Happening:
    """Return what happens at this tick before anything moves; ``change`` is what the opening of the jaws has told.

    Jaws come after what the operator does, unless that means nothing in the present mode.
    """
    state, given = _debounced(parts, state, given)
    found = _decided(parts, _by_operator(parts, state, given))
    if found.event is Event.FAULT or (state.mode, found.event) in TRANSITIONS:
        return found
    event, reason = _by_jaws(parts, found.state, change)
    if event is None:
        return found
    return Happening(found.state, event, "; ".join(filter(None, (reason, found.reason))))


def _debounced(parts: Parts, state: ControllerState, given: OperatorInput) -> tuple[ControllerState, OperatorInput]:
    if given.event is not Event.TRIGGERED:
        return state, given
    time = parts.servo.time
    if time - state.pressed < parts.debounce:
        given = given._replace(event=Event.ENGAGED if given.engaged else None)
    return state._replace(pressed=time), given


def _by_jaws(parts: Parts, state: ControllerState, change: JawChange) -> tuple[Event | None, str]:
    """Return what the jaws bring about, and why, in words."""
    jaws, mode, period = state.jaws, state.mode, parts.servo.period
    if mode in _RELIES_ON_JAWS and jaws.blind(period):
        return Event.FAULT, "the opening of the jaws is not measured"
    if mode is Mode.CLOSE and jaws.grip is GripStatus.HELD:
        # Also where it was noticed at a tick that something else happened at.
        return Event.HELD, change.reason
    if mode is Mode.RELEASE and jaws.at_rest(period):
        return (Event.OPENED, "") if jaws.opened(parts.modes.open) else (Event.FAULT, "the jaws do not open")
    return change


def _by_operator(parts: Parts, state: ControllerState, given: OperatorInput) -> Happening:
    fault = _fault(parts.servo, state)
    if fault:
        return Happening(state._replace(doubt=""), Event.FAULT, fault)
    event, reason = given.event, given.reason
    if event is Event.FAULT:
        return Happening(state, event, reason)
    silence = state.monitor.silence(parts.servo.time, parts.servo.settings.timeout)
    if silence and state.mode.automatic:
        # Nobody could step in.
        return Happening(state, Event.FAULT, silence)
    if state.mode is Mode.HOLD:
        return _asked_to_go_on(parts, state, given, silence)
    if state.mode is Mode.MANUAL:
        found = _by_hand(parts, state, event, given)
        told = (silence if state.monitor.clutch else "") or reason
        return found if found.reason or not told else found._replace(reason=told)
    if event is not Event.TRIGGERED and given.pressed:
        return _by_button(parts, state, event, given.pressed)
    return Happening(state, event, reason)


def leading_hand(state: ControllerState) -> Hand | None:
    """Return the hand while it is coupled to the tool."""
    return state.monitor.hand if state.mode is Mode.MANUAL and state.monitor.clutch else None


def tuned(parts: Parts, state: ControllerState, given: OperatorInput) -> tuple[ControllerState, str]:
    """Return the state with the grasp shifted as the operator nudges it, and why it cannot be, in words."""
    tuning, target, monitor = state.tuning, state.target, state.monitor
    if tuning is None or state.mode not in _TUNABLE or target is None:
        return state, ""
    if given.nudge is not None:
        tuning = tuning.pushed(given.nudge)
    before, hand = given.moved_from, monitor.hand
    led = Button.NUDGE in monitor.buttons and given.new
    # A hand that jumps does not mean the grasp.
    if led and before and hand and not TrackedHand(before).jumps(state.clutch, hand):
        grasp = pose_of(target.X_WG)[1]
        tuning = tuning.pushed(hand_nudge(state.clutch, before, hand, grasp))
    reason = ""
    if state.choice.deciding is None:
        tuning, reason = tuning.settled(parts.servo.time, parts.choice.pieces(parts.servo))
    activity = state.activity
    if tuning.tuned.target is not target:
        target = tuning.tuned.target
        if isinstance(activity, (Travelling, Adjusting)):
            activity = activity.led(*pose_of(target.X_WP))
    return state._replace(tuning=tuning, target=target, activity=activity), reason


def _fault(servo: Servo, state: ControllerState) -> str:
    arm = state.arm
    # While holding it is known already, and no event.
    if state.mode is not Mode.HOLD:
        if arm.silent:
            return arm.doubt
        if arm.q is not None and arm.believed:
            behind = tracking_error(servo.robot, arm.q, servo.guard.q)
            if behind > arm.tolerance.fault:
                return f"the arm is {behind:.2f} rad off its command"
    return state.doubt


def _asked_to_go_on(parts: Parts, state: ControllerState, given: OperatorInput, silence: str) -> Happening:
    """Return whether hold is left: as soon as the operator has asked for it, still does, and the arm is ready.

    Who closes the clutch meanwhile need not do it again. ``silence`` says that no usable samples come, where so.
    """
    monitor, reason = state.monitor, given.reason
    wish = state.wish if given.event is None else given.event
    if silence or not (monitor.clutch or monitor.trigger):
        wish = None
    obstacle = unready(state.activity, parts.servo, state.arm)
    if wish is not None and not obstacle:
        return Happening(state, wish, reason)
    asked = _asked_of_jaws(parts, state, given.pressed)
    if asked is not None:
        return asked
    if given.event is not None and isinstance(state.activity, Holding):
        state = state._replace(activity=state.activity.asked_again())
    told = wish is not None or state.arm.silent or elsewhere(parts.servo, state.arm)
    # Why the arm was stopped says more than that no usable sample comes now.
    return Happening(
        state._replace(wish=wish), None, reason or (obstacle if told else "") or ("" if state.stop else silence)
    )


def _decided(parts: Parts, found: Happening) -> Happening:
    """Return what happens where a decision is in the making, and nothing has come between."""
    if found.state.choice.deciding is None or found.event not in (None, Event.ENGAGED):
        return found
    choice, decided = parts.choice.decided(found.state.choice, parts.servo)
    state = found.state._replace(choice=choice)
    if decided is None:
        return found._replace(state=state)
    target, reason = decided.target, decided.reason
    if target is not None and target.object_name in state.moved:
        reason = f"the {target.object_name} was moved, and has not been observed since"
        target = None
    reason = "; ".join(filter(None, (found.reason, decided.done, reason)))
    if target is not None:
        return Happening(state._replace(target=target), decided.purpose, reason)
    # What was refused must not be grasped; what was merely the best may.
    return Happening(state, Event.CANCELLED if decided.done else found.event, reason)


def _by_hand(parts: Parts, state: ControllerState, event: Event | None, given: OperatorInput) -> Happening:
    asked = _asked_of_jaws(parts, state, given.pressed)
    if asked is not None:
        return asked
    grip, deciding = state.jaws.grip, state.choice.deciding
    if event is Event.TRIGGERED and grip.may_drop:
        return _put_down(parts, state)
    if Button.VETO in given.pressed:
        choice, done = parts.choice.veto(state.choice, None)
        return Happening(state._replace(choice=choice._replace(deciding=None)), event, done)
    if deciding is not None:
        # Who hands over by the trigger may let go. The robot begins by itself only while the hand leads.
        opened = deciding.purpose is Event.BEGUN and not state.monitor.clutch
        if not opened and event is not Event.TRIGGERED:
            return Happening(state, event)
        state = state._replace(choice=state.choice._replace(deciding=None))
        return Happening(state, None, "the clutch is open" if opened else "the trigger was pressed again")
    if event is Event.TRIGGERED and parts.modes.arbitration.trigger is Trigger.GRASPS:
        return _grasp_here(parts, state)
    begins = event is None and not grip.may_drop and _begins_by_itself(parts, state)
    if begins:
        state = state._replace(tried=parts.servo.time)
    elif event is not Event.TRIGGERED:
        return Happening(state, event)
    purpose = Event.BEGUN if begins else Event.TRIGGERED
    choice, refusal = parts.choice.begin(state.choice, parts.servo, leading_hand(state), state.clutch, purpose)
    return Happening(state._replace(choice=choice), None, refusal)


def _asked_of_jaws(parts: Parts, state: ControllerState, pressed: frozenset[Button]) -> Happening | None:
    """Return what comes of a wish to open the jaws or to put down what they hold; None where there is none."""
    if Button.RELEASE not in pressed and Button.PLACE not in pressed:
        return None
    jaws, mode = state.jaws, state.mode
    event = Event.RELEASED if Button.RELEASE in pressed else Event.PUT_DOWN
    if event is Event.RELEASED and jaws.grip is GripStatus.OPEN:
        return Happening(state, None, "the jaws are open")
    if event is Event.PUT_DOWN and not jaws.grip.may_drop:
        return Happening(state, None, "the jaws hold nothing")
    if (mode, event) in TRANSITIONS:
        return Happening(state, event) if event is Event.RELEASED else _put_down(parts, state)
    if event is Event.RELEASED and mode is Mode.MANUAL:
        return Happening(released(parts.modes, state, parts.servo), event, "the jaws open")
    return Happening(state, None, f"not in {mode.value}: the clutch or the trigger leads to manual first")


def _put_down(parts: Parts, state: ControllerState) -> Happening:
    modes = parts.modes
    if can_lower(modes.place, modes.approach, parts.servo, state.jaws.at[0][2]):
        return Happening(state, Event.PUT_DOWN)
    return Happening(state, None, "the arm cannot lower what it holds straight down from here")


def _grasp_here(parts: Parts, state: ControllerState) -> Happening:
    if state.opening < parts.modes.open:
        return Happening(released(parts.modes, state, parts.servo), None, "the jaws open")
    # Where the arm is decides what is between the jaws, not where it is commanded to be.
    at = state.arm.tool(parts.servo.robot)
    if at is None:
        return Happening(state, None, state.arm.doubt)
    target, refusal = parts.choice.near(state.choice, *at, parts.within)
    if refusal:
        return Happening(state, None, refusal)
    return Happening(state._replace(target=target), Event.GRASPED)


def _begins_by_itself(parts: Parts, state: ControllerState) -> bool:
    time, ranking = parts.servo.time, state.choice.ranking
    if state.stepped_in or not state.monitor.clutch or time - state.tried < RETRY:
        return False
    intended_for = min(state.choice.intended_for(time), time - state.entered)
    return ranking is not None and ranking.best is not None and parts.modes.arbitration.begins(intended_for)


def _by_button(parts: Parts, state: ControllerState, event: Event | None, pressed: frozenset[Button]) -> Happening:
    if state.mode.automatic and Button.CANCEL in pressed:
        return Happening(state, Event.CANCELLED)
    asked = _asked_of_jaws(parts, state, pressed)
    if asked is not None:
        return asked
    if state.mode not in _TUNABLE or state.choice.deciding is not None:
        return Happening(state, event)
    if Button.NEXT in pressed or Button.VETO in pressed:
        choice, done = state.choice, ""
        if Button.VETO in pressed:
            choice, done = parts.choice.veto(choice, state.target)
        choice = parts.choice.begin_next(choice, parts.servo, state.target, done)
        return Happening(state._replace(choice=choice), event)
    if Button.CONFIRM in pressed:
        state = state._replace(confirmed=True)
        return Happening(state, Event.CONFIRMED if state.mode is Mode.ADJUST else event)
    return Happening(state, event)
