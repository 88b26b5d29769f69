"""What the controller does in each mode, tick by tick.

An activity is a value: a tick returns its outcome and the activity of the next tick. It starts from the pose that the
tool is being led along at that moment, so that entering a mode never moves the target. It reads the operator's hand or
its own clock, and drives the servo.
"""

from __future__ import annotations

from math import degrees, hypot
from typing import NamedTuple, Protocol

from optsc.control.approach import Approach, PathTarget, StraightPath
from optsc.control.arbitration import Goal
from optsc.control.fine_tuning import Shift
from optsc.control.measured_arm import MeasuredArm
from optsc.control.modes import Event
from optsc.control.servo import Servo
from optsc.control.status import Command, Status
from optsc.geometry import scalar
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Quaternion, Vector
from optsc.operators.clutch import ClutchSettings, ClutchState, Hand, engage, follow
from optsc.operators.jumps import TrackedHand
from optsc.operators.smoothing import SmoothedHand, Smoothing, begin, smoothed

_ZERO: Vector = (0.0, 0.0, 0.0)
STANDSTILL = (_ZERO, _ZERO, _ZERO, _ZERO)
"""No velocity and no acceleration."""


class HandInput(NamedTuple):
    """What the operator's hand asks for at this tick, which objects may be intended, and where the arm is.

    Attributes:
        hand: the newest good sample.
        new: whether it is new.
        clutch: whether it is coupled to the arm.
        goals: objects that may be intended, for policies that assist.
        gap: by how much the most probable of them leads.
        arm: where the arm is measured to be.
    """

    hand: Hand | None
    new: bool
    clutch: bool
    goals: tuple[Goal, ...] = ()
    gap: float = 0.0
    arm: MeasuredArm = MeasuredArm()


class Assistance(NamedTuple):
    """What became of the hand's velocity at a tick, as twists (6,) in W [m/s, rad/s].

    Attributes:
        hand: the velocity that the hand asked for.
        robot: what the robot added.
        blended: both together: the velocity that the tool is led with.
        share: how much of the authority is the robot's, in [0, 1], as the policy reports it.
    """

    hand: Array
    robot: Array
    blended: Array
    share: float


class Outcome(NamedTuple):
    """One tick of an activity: its command, the event that ends it, the reason of a fault, and the assistance."""

    command: Command
    event: Event | None = None
    reason: str = ""
    assistance: Assistance | None = None


def of_the_robot(outcome: Outcome) -> Outcome:
    """Return what a tick comes to where the robot moves by itself: without a solution it is a fault."""
    command = outcome.command
    if command.status is not Status.UNSOLVED:
        return outcome
    return outcome._replace(event=Event.FAULT, reason=command.reason)


class Activity(Protocol):
    """One mode at work: a value that changes nothing but the servo."""

    def step(self, servo: Servo, hand: HandInput, opening: float) -> tuple[Activity, Outcome]:
        """Do one tick; ``opening`` is the measured distance of the jaws [m]. Return the next tick's activity too."""
        ...


class Coupled(NamedTuple):
    """The pose that a coupled hand asks for, when, whether it was coupled again, and why, where that is a message."""

    p: Vector
    q: Quaternion
    stamp: float
    again: bool = False
    reason: str = ""


class Coupling(NamedTuple):
    """A hand coupled to a pose by the clutch; whenever it is coupled, the pose stays.

    Attributes:
        settings: of the clutch.
        smoothing: of the hand, if any.
        clutch: the clutch while it is closed.
        smooth: the filter of the hand.
        motion: of the hand while it is coupled, to tell jumps from it.
        keeps_offset: whether the next hand keeps the orientation that it has to the tool: the operator has not wished
            for another, as the hand had jumped, was lost, or is at a grasp.
    """

    settings: ClutchSettings
    smoothing: Smoothing | None = None
    clutch: ClutchState | None = None
    smooth: SmoothedHand | None = None
    motion: TrackedHand | None = None
    keeps_offset: bool = False

    def released(self) -> Coupling:
        """Return the coupling after the operator has opened the clutch: the next hand is coupled again from there.

        A clutch that was open when the hand was to take over at a grasp still keeps the offset when it closes.
        """
        if self.motion is None:
            return self
        return Coupling(self.settings, self.smoothing)

    def lost(self) -> Coupling:
        """Return the coupling without its hand: the next one is coupled again, wherever it is, and keeps its offset."""
        if self.clutch is None and self.keeps_offset:
            return self
        return self._replace(clutch=None, keeps_offset=True)

    def after(
        self, hand: Hand, at: tuple[Vector, Quaternion], longest_gap: float = float("inf")
    ) -> tuple[Coupling, Coupled]:
        """Return the coupling and the pose after a new sample.

        ``at`` is the pose to couple the hand to where it is not coupled; a hand that comes back after more than
        ``longest_gap`` [s] was lost.
        """
        settings, smoothing, clutch, smooth, motion, keeps = self
        reason = ""
        if clutch is not None and motion is not None:
            if hand.stamp - motion.hand.stamp > longest_gap:
                reason = "the hand was lost and is coupled again"
            elif motion.jumps(settings, hand):
                reason = "the hand jumped and was coupled again"
        if clutch is None or smooth is None or motion is None or reason:
            keeps = keeps or bool(reason)
            clutch = engage(settings, hand, *at, keeps)
            coupled = Coupled(clutch.tool_p, clutch.tool_q, hand.stamp, True, reason)
            tracked = TrackedHand(hand) if motion is None else TrackedHand(hand, interval=motion.interval)
            return Coupling(settings, smoothing, clutch, begin(hand), tracked, keeps), coupled
        motion = motion.after(hand)
        if smoothing is not None:
            smooth = smoothed(smoothing, smooth, hand)
            hand = smooth.hand
        clutch = follow(settings, clutch, hand)
        after = Coupling(settings, smoothing, clutch, smooth, motion, keeps)
        return after, Coupled(clutch.tool_p, clutch.tool_q, hand.stamp)


class Following(NamedTuple):
    """Follow the operator's hand through the clutch."""

    coupling: Coupling

    def step(self, servo: Servo, hand: HandInput, opening: float) -> tuple[Activity, Outcome]:
        """Do one tick; see `Activity`."""
        if hand.hand is None or not hand.clutch:
            servo.forget()
            return self._with(self.coupling.released()), Outcome(servo.stop())
        coupling, reason = self.coupling, ""
        if hand.new:
            coupling, coupled = coupling.after(hand.hand, servo.reference, servo.settings.timeout)
            if coupled.again:
                servo.forget()
            servo.observe(coupled.p, coupled.q, coupled.stamp)
            reason = coupled.reason
        command = servo.tick()
        if command.status is Status.STALE:
            # The hand may come back anywhere: it is then coupled again, from rest.
            coupling = coupling.lost()
        return self._with(coupling), Outcome(command, reason=reason)

    def _with(self, coupling: Coupling) -> Following:
        return self if coupling is self.coupling else Following(coupling)


class Missing(NamedTuple):
    """How far the measured tool is from where it should be: distance and angle [m, rad]."""

    distance: float
    angle: float

    @classmethod
    def of(cls, servo: Servo, arm: MeasuredArm, p: Vector, q: Quaternion) -> Missing | None:
        """Return it for the pose ``p``, ``q``; None while the readings of the arm are not believed."""
        tool = arm.tool(servo.robot)
        if tool is None:
            return None
        (x, y, z), tool_q = tool
        turn = scalar.multiply(tool_q, scalar.conjugate(q))
        return cls(hypot(x - p[0], y - p[1], z - p[2]), scalar.angle(turn))

    def within(self, settings: Approach) -> bool:
        """Tell whether that counts as arrived."""
        distance, angle = settings.measured_tolerance
        return self.distance < distance and self.angle < angle

    def __str__(self) -> str:
        angle = degrees(self.angle)
        return f"the tool is measured {1e3 * self.distance:.0f} mm and {angle:.1f}° from the end of the path"


class Travelling(NamedTuple):
    """Move along a straight path, and wait until the arm has caught up with its end.

    Attributes:
        settings: what counts as arrived.
        path: where to go.
        end: the pose at its end.
        shift: displacement of the path, where its end can be moved on the way, see `led`.
        ticks: since the start of the path.
    """

    settings: Approach
    path: StraightPath
    end: tuple[Vector, Quaternion]
    shift: Shift | None = None
    ticks: int = 0

    @classmethod
    def begin(
        cls, settings: Approach, servo: Servo, end_p: Vector, end_q: Quaternion, shift: Shift | None = None
    ) -> Travelling:
        """Return the motion from where the tool is being led along to a pose."""
        servo.forget()
        return cls(settings, StraightPath(settings, *servo.reference, end_p, end_q), (end_p, end_q), shift)

    def led(self, end_p: Vector, end_q: Quaternion) -> Travelling:
        """Return the motion to another end, not far from the first; the same where the path cannot be shifted."""
        if self.shift is None:
            return self
        return self._replace(shift=self.shift.led(self.end, (end_p, end_q)))

    def step(self, servo: Servo, hand: HandInput, opening: float) -> tuple[Activity, Outcome]:
        """Do one tick; see `Activity`."""
        settings, path, end, shift, ticks = self
        ticks += 1
        time = ticks * servo.period
        target = path.at(time)
        if shift is not None:
            shift, target = shift.applied(target, servo.period)
        command = servo.track(*target)
        after = Travelling(settings, path, end, shift, ticks)
        if time < path.duration:
            return after, Outcome(command)
        if shift is not None and shift.moving:
            # The path waits until its end has come to rest.
            return Travelling(settings, path, end, shift, ticks - 1), Outcome(command)
        x, y, z, a, b, c = command.error.tolist()
        near = max(abs(x), abs(y), abs(z)) < settings.position_tolerance
        near = near and max(abs(a), abs(b), abs(c)) < settings.angle_tolerance
        late = time > path.duration + settings.settle_time
        if not near and not late:
            return after, Outcome(command)
        # The command is where it should be; that the arm is there too, only a measurement can tell.
        missing = Missing.of(servo, hand.arm, target.p, target.q)
        if near and missing is not None and missing.within(settings):
            return after, Outcome(command, Event.ARRIVED)
        if late:
            measured = "the arm's readings are not believed" if missing is None else str(missing)
            reason = f"stuck on the path: {command.reason or 'the arm lags behind'}; {measured}"
            return after, Outcome(command, Event.FAULT, reason)
        return after, Outcome(command)


class Adjusting(NamedTuple):
    """Wait at the pre-grasp, which may be shifted, until the operator decides."""

    at: tuple[Vector, Quaternion]
    shift: Shift

    @classmethod
    def begin(cls, servo: Servo, shift: Shift) -> Adjusting:
        """Return the waiting at the pose that the tool is being led along."""
        servo.forget()
        return cls(servo.reference, shift)

    def led(self, p: Vector, q: Quaternion) -> Adjusting:
        """Return the waiting at another pre-grasp, not far from the first."""
        return Adjusting(self.at, self.shift.led(self.at, (p, q)))

    def step(self, servo: Servo, hand: HandInput, opening: float) -> tuple[Activity, Outcome]:
        """Do one tick; see `Activity`."""
        shift, target = self.shift.applied(PathTarget(*self.at, *STANDSTILL), servo.period)
        command = servo.track(*target)
        return Adjusting(self.at, shift), Outcome(command)


class Standing(NamedTuple):
    """Keep the tool where it is."""

    at: tuple[Vector, Quaternion]

    def step(self, servo: Servo, hand: HandInput, opening: float) -> tuple[Activity, Outcome]:
        """Do one tick; see `Activity`."""
        return self, Outcome(servo.track(*self.at))
