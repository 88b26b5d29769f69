"""What the controller does in each mode, tick by tick.

An activity starts from the pose that the tool is being led along at that moment, so that entering a mode never
moves the target. It reads the operator's hand or its own clock, and drives the servo.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from optsc.control.approach import Approach, StraightPath
from optsc.control.modes import Event
from optsc.control.servo import Command, Servo, Status
from optsc.geometry.scalar import Quaternion, Vector
from optsc.operators.clutch import ClutchSettings, ClutchState, Hand, engage, follow, jumped
from optsc.operators.smoothing import SmoothedHand, Smoothing, begin, smoothed


class HandInput(NamedTuple):
    """What the operator's hand says at this tick: the newest good sample, whether it is new, and the clutch."""

    hand: Hand | None
    new: bool
    clutch: bool


class Outcome(NamedTuple):
    """One tick of an activity: its command, and the event that ends it, with the reason of a fault."""

    command: Command
    event: Event | None = None
    reason: str = ""


class Activity(Protocol):
    """One mode at work."""

    def step(self, servo: Servo, hand: HandInput, opening: float) -> Outcome:
        """Do one tick; ``opening`` is the measured distance of the jaws [m]."""
        ...


class Resting:
    """Come to rest and stay there."""

    def step(self, servo: Servo, hand: HandInput, opening: float) -> Outcome:
        """Do one tick; see `Activity`."""
        return Outcome(servo.stop())


class Following:
    """Follow the operator's hand through the clutch."""

    def __init__(self, settings: ClutchSettings, smoothing: Smoothing | None = None) -> None:
        self._settings, self._smoothing = settings, smoothing
        self._coupled: ClutchState | None = None
        self._smooth: SmoothedHand | None = None

    def step(self, servo: Servo, hand: HandInput, opening: float) -> Outcome:
        """Do one tick; see `Activity`."""
        if hand.hand is None or not hand.clutch:
            self._uncouple(servo)
            return Outcome(servo.stop())
        reason = self._take_in(servo, hand.hand) if hand.new else ""
        command = servo.step()
        if command.status is Status.STALE:
            # The hand may come back anywhere: it is then coupled anew, from rest.
            self._coupled = None
        return Outcome(command, reason=reason)

    def _uncouple(self, servo: Servo) -> None:
        self._coupled = None
        servo.forget()

    def _take_in(self, servo: Servo, hand: Hand) -> str:
        """Move the target as the hand moved; say so where the hand had to be coupled anew."""
        leapt = self._coupled is not None and jumped(self._settings, self._coupled, hand)
        if self._coupled is None or self._smooth is None or leapt:
            self._smooth = begin(hand)
            self._coupled = engage(self._settings, hand, *servo.reference)
            servo.forget()
        else:
            if self._smoothing is not None:
                self._smooth = smoothed(self._smoothing, self._smooth, hand)
                hand = self._smooth.hand
            self._coupled = follow(self._settings, self._coupled, hand)
        servo.observe(self._coupled.tool_p, self._coupled.tool_q, hand.stamp)
        return "the hand jumped and was coupled anew" if leapt else ""


class Travelling:
    """Move along a straight path, and wait until the arm has caught up with its end."""

    def __init__(self, settings: Approach, servo: Servo, end_p: Vector, end_q: Quaternion) -> None:
        servo.forget()
        self._settings = settings
        self._path = StraightPath(settings, *servo.reference, end_p, end_q)
        self._ticks = 0

    def step(self, servo: Servo, hand: HandInput, opening: float) -> Outcome:
        """Do one tick; see `Activity`."""
        self._ticks += 1
        time = self._ticks * servo.period
        command = servo.track(*self._path.at(time))
        if command.status is Status.UNSOLVED:
            return Outcome(command, Event.FAULT, command.reason)
        if time < self._path.duration:
            return Outcome(command)
        x, y, z, a, b, c = command.error.tolist()
        settings = self._settings
        near = max(abs(x), abs(y), abs(z)) < settings.position_tolerance
        if near and max(abs(a), abs(b), abs(c)) < settings.angle_tolerance:
            return Outcome(command, Event.ARRIVED)
        if time > self._path.duration + settings.settle_time:
            return Outcome(
                command, Event.FAULT, f"stuck on the way: {command.reason or 'the arm lags behind'}"
            )
        return Outcome(command)


class Closing:
    """Stand still until the jaws have come to rest."""

    LEAST_TIME = 0.3
    """Jaws that have not moved before this [s] may not have begun to."""
    STILL_SPEED = 2e-3
    """Jaws slower than this [m/s] are at rest."""
    STILL_TIME = 0.2
    """How long they have to be [s]."""
    MOST_TIME = 3.0
    """Go on after this [s] whatever the jaws do."""

    def __init__(self, servo: Servo) -> None:
        self._p, self._q = servo.reference
        self._ticks = 0
        self._still = 0
        self._opening: float | None = None

    def step(self, servo: Servo, hand: HandInput, opening: float) -> Outcome:
        """Do one tick; see `Activity`."""
        self._ticks += 1
        command = servo.track(self._p, self._q)
        last, self._opening = self._opening, opening
        moved = last is None or abs(opening - last) > self.STILL_SPEED * servo.period
        self._still = 0 if moved else self._still + 1
        time = self._ticks * servo.period
        at_rest = self._still * servo.period >= self.STILL_TIME and time >= self.LEAST_TIME
        return Outcome(command, Event.CLOSED if at_rest or time >= self.MOST_TIME else None)


class Standing:
    """Keep the tool where it is."""

    def __init__(self, servo: Servo) -> None:
        self._p, self._q = servo.reference

    def step(self, servo: Servo, hand: HandInput, opening: float) -> Outcome:
        """Do one tick; see `Activity`."""
        return Outcome(servo.track(self._p, self._q))
