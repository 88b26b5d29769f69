"""What the controller does in each mode, tick by tick.

An activity starts from the pose that the tool is being led along at that moment, so that entering a mode never
moves the target. It reads the operator's hand or its own clock, and drives the servo.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from optsc.control.approach import Approach, PathTarget, StraightPath
from optsc.control.arbitration import Goal
from optsc.control.fine_tuning import Shift
from optsc.control.modes import Event
from optsc.control.servo import Command, Servo, Status
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Quaternion, Vector
from optsc.operators.clutch import ClutchSettings, ClutchState, Hand, engage, follow, jumped
from optsc.operators.smoothing import SmoothedHand, Smoothing, begin, smoothed

_ZERO: Vector = (0.0, 0.0, 0.0)
STANDSTILL = (_ZERO, _ZERO, _ZERO, _ZERO)
"""No velocity and no acceleration."""


class HandInput(NamedTuple):
    """What the operator's hand says at this tick, and what it may be after.

    Attributes:
        hand: the newest good sample.
        new: whether it is new.
        clutch: whether it is coupled to the arm.
        goals: objects that may be meant, for policies that assist.
        gap: by how much the most probable of them leads.
    """

    hand: Hand | None
    new: bool
    clutch: bool
    goals: tuple[Goal, ...] = ()
    gap: float = 0.0


class Assistance(NamedTuple):
    """What became of the hand's wish at a tick, as twists (6,) in W [m/s, rad/s].

    Attributes:
        hand: the velocity that the hand asked for.
        robot: what the robot added.
        carried_out: both, blended: the velocity that the tool is led with.
        share: how much of the authority is the robot's, in [0, 1], as the policy sees it.
    """

    hand: Array
    robot: Array
    carried_out: Array
    share: float


class Outcome(NamedTuple):
    """One tick of an activity: its command, the event that ends it, the reason of a fault, and the assistance."""

    command: Command
    event: Event | None = None
    reason: str = ""
    assistance: Assistance | None = None


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


class Coupled(NamedTuple):
    """The pose that a coupled hand asks for, when, whether it was coupled anew, and why, where that is news."""

    p: Vector
    q: Quaternion
    stamp: float
    anew: bool = False
    reason: str = ""


class Coupling:
    """A hand coupled to a pose by the clutch; whenever it is coupled, the pose stays."""

    def __init__(self, settings: ClutchSettings, smoothing: Smoothing | None = None) -> None:
        self._settings, self._smoothing = settings, smoothing
        self._coupled: ClutchState | None = None
        self._smooth: SmoothedHand | None = None

    def release(self) -> None:
        """Let go: the next hand is coupled anew, wherever it is."""
        self._coupled = None

    def take_in(self, hand: Hand, at: tuple[Vector, Quaternion]) -> Coupled:
        """Return the pose after a new sample; ``at`` is the pose to couple the hand to where it is not coupled."""
        leapt = self._coupled is not None and jumped(self._settings, self._coupled, hand)
        if self._coupled is None or self._smooth is None or leapt:
            self._smooth = begin(hand)
            self._coupled = engage(self._settings, hand, *at)
            reason = "the hand jumped and was coupled anew" if leapt else ""
            return Coupled(self._coupled.tool_p, self._coupled.tool_q, hand.stamp, True, reason)
        if self._smoothing is not None:
            self._smooth = smoothed(self._smoothing, self._smooth, hand)
            hand = self._smooth.hand
        self._coupled = follow(self._settings, self._coupled, hand)
        return Coupled(self._coupled.tool_p, self._coupled.tool_q, hand.stamp)


class Following:
    """Follow the operator's hand through the clutch."""

    def __init__(self, settings: ClutchSettings, smoothing: Smoothing | None = None) -> None:
        self._coupling = Coupling(settings, smoothing)

    def step(self, servo: Servo, hand: HandInput, opening: float) -> Outcome:
        """Do one tick; see `Activity`."""
        if hand.hand is None or not hand.clutch:
            self._coupling.release()
            servo.forget()
            return Outcome(servo.stop())
        reason = self._take_in(servo, hand.hand) if hand.new else ""
        command = servo.step()
        if command.status is Status.STALE:
            # The hand may come back anywhere: it is then coupled anew, from rest.
            self._coupling.release()
        return Outcome(command, reason=reason)

    def _take_in(self, servo: Servo, hand: Hand) -> str:
        """Move the target as the hand moved; say so where the hand had to be coupled anew."""
        coupled = self._coupling.take_in(hand, servo.reference)
        if coupled.anew:
            servo.forget()
        servo.observe(coupled.p, coupled.q, coupled.stamp)
        return coupled.reason


class Travelling:
    """Move along a straight path, and wait until the arm has caught up with its end.

    With a ``shift`` the end can be moved on the way, see `lead`.
    """

    def __init__(
        self, settings: Approach, servo: Servo, end_p: Vector, end_q: Quaternion, shift: Shift | None = None
    ) -> None:
        servo.forget()
        self._settings = settings
        self._path = StraightPath(settings, *servo.reference, end_p, end_q)
        self._end, self._shift = (end_p, end_q), shift
        self._ticks = 0

    def lead(self, end_p: Vector, end_q: Quaternion) -> None:
        """Go to another end, not far from the first: the whole path is shifted; without effect where it cannot be."""
        if self._shift is not None:
            self._shift.lead(self._end, (end_p, end_q))

    def step(self, servo: Servo, hand: HandInput, opening: float) -> Outcome:
        """Do one tick; see `Activity`."""
        self._ticks += 1
        time = self._ticks * servo.period
        target = self._path.at(time)
        if self._shift is not None:
            target = self._shift.applied(target, servo.period)
        command = servo.track(*target)
        if command.status is Status.UNSOLVED:
            return Outcome(command, Event.FAULT, command.reason)
        if time < self._path.duration:
            return Outcome(command)
        if self._shift is not None and self._shift.moving:
            self._ticks -= 1  # the path waits until its end has come to rest
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


class Adjusting:
    """Wait at the pre-grasp, which may be shifted, until the operator decides."""

    def __init__(self, servo: Servo, shift: Shift) -> None:
        servo.forget()
        self._at, self._shift = servo.reference, shift

    def lead(self, p: Vector, q: Quaternion) -> None:
        """Go to another pre-grasp, not far from the first."""
        self._shift.lead(self._at, (p, q))

    def step(self, servo: Servo, hand: HandInput, opening: float) -> Outcome:
        """Do one tick; see `Activity`."""
        command = servo.track(*self._shift.applied(PathTarget(*self._at, *STANDSTILL), servo.period))
        if command.status is Status.UNSOLVED:
            return Outcome(command, Event.FAULT, command.reason)
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
