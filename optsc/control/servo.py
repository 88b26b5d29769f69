"""The servo: one pose target in, one safe joint command out, at every tick.

    target ──► prediction ──► reference model ──► QP IK ──► joint guard ──► Command

Every target passes the same third-order reference model, so that whatever changes upstream (a new sample, another
control mode, the end of a time-out) the reference keeps its position, velocity and acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from math import exp
from time import perf_counter
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import Checked, NonNegative, Pair, Positive, Share, require
from optsc.control.diagnosis import lost_direction, towards
from optsc.geometry import Pose, scalar
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Quaternion, Vector
from optsc.ik import Avoidance, DifferentialIK, IkSettings, make_solver, ramp_time, tool_braking
from optsc.kernels.kernel import build_kernel
from optsc.kernels.reference import ReferenceSettings, reference_model
from optsc.kernels.viable import Bound
from optsc.operators import prediction
from optsc.operators.prediction import REST, PredictionSettings, Track
from optsc.robot import JointLimits, RobotModel
from optsc.shaping import JointGuard

NEAR = 0.99
"""Share of the square of `ServoSettings.far` up to which a target is within reach."""


class Status(Enum):
    """What a tick did; `Command.reason` says why, in words."""

    FOLLOWING = "following"
    LIMITED = "held back by a joint limit"
    BLOCKED = "held back by something near"
    SINGULAR = "near a singularity"
    UNREACHABLE = "the target is out of reach"
    STALE = "no new target for too long"
    INVALID = "the target was refused"
    STOPPING = "coming to rest"
    HOLDING = "at rest"
    UNSOLVED = "the solver found no motion"


FARTHEST = 1e9
"""Positions [m] and stamps [s] from here on are faults, not targets."""
SINGULAR_SHARE = 0.1
"""Share of the manipulability at home below which the arm may be losing a direction (ours)."""
NOTICEABLE = (1e-3, 5e-3)
"""Distance and angle to the reference [m, rad] up to which the arm counts as following, whatever limit it touches
(ours): half of what the tool may be off."""
BEHIND = (4e-3, 2e-2)
"""Distance and angle of the reference to its target [m, rad] from which on an arm at a limit counts as held back even
where the reference has waited for it (ours): a brisk hand is half of that ahead of a free arm."""
WAITING = 9e-3
"""Time constant [s] with which the reference goes to an arm that is at a limit of its rates (ours)."""


class Command(NamedTuple):
    """One tick's joint command.

    Attributes:
        q, v, a: position, velocity and acceleration (n,) [rad, rad/s, rad/s^2]; a is the difference of v per tick.
        status: what the tick did.
        reason: why, in words; empty while following.
        error: reference minus commanded tool pose (6,), in the tool frame [m, rad].
        volume: Yoshikawa's index at the commanded posture.
        iterations: of the solver.
        slack: how far the velocities had to miss the rows of collision avoidance [m/s]; zero while none had to give.
        outside: how far the joint furthest beyond its position limits is beyond them [rad]; zero when all are inside.
    """

    q: Array
    v: Array
    a: Array
    status: Status
    reason: str
    error: Array
    volume: float
    iterations: int
    slack: float = 0.0
    outside: float = 0.0


@dataclass(frozen=True)
class ServoSettings(Checked):
    """How a target is followed.

    Attributes:
        bandwidth: of the reference model [rad/s]: higher follows more closely and passes on more of the noise.
        led: share of the hand's acceleration that the reference is led along with. One is exact for a hand that
            accelerates steadily; less is smoother.
        lag: how far behind a stream of targets the tool is led [s]. Zero means to be where the hand is now, which
            has to be guessed; a few hundredths make the motion several times smoother.
        catching_up: speed at most with which a target is caught up with, beside its own [m/s, rad/s].
        timeout: age of the newest target after which the arm comes to rest [s].
        far: distance and angle to the reference beyond which a target counts as out of reach [m, rad].
        prediction: how samples are carried on to the present.
        ik: weights and gains of the quadratic program.
    """

    bandwidth: Annotated[float, Positive] = 55.0
    lag: Annotated[float, NonNegative] = 0.028
    led: Annotated[float, Share] = 0.5
    catching_up: Annotated[tuple[float, float], Pair] = (0.5, 1.5)
    timeout: Annotated[float, Positive] = 0.1
    far: Annotated[tuple[float, float], Pair] = (0.05, 0.2)
    prediction: PredictionSettings = field(default_factory=PredictionSettings)
    ik: IkSettings = field(default_factory=IkSettings)


_PARTS = (ReferenceSettings.LINEAR, ReferenceSettings.ANGULAR)


def _is_pose(p: list[float], q: list[float]) -> bool:
    """Tell whether this is one pose; sums of magnitudes carry what is not finite, and do not cancel."""
    if len(p) != 3 or len(q) != 4:
        return False
    return (
        abs(p[0]) + abs(p[1]) + abs(p[2]) < FARTHEST
        and 0.9 < q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2 < 1.1
    )


def _exceeds(error: Array, limits: tuple[float, float], share: float = 1.0) -> bool:
    """Tell whether a pose error (6,) is beyond a distance or an angle; ``share`` scales their squares."""
    x, y, z, a, b, c = error.tolist()
    distance, angle = limits
    return x * x + y * y + z * z > share * distance**2 or a * a + b * b + c * c > share * angle**2


class Servo:
    """Follows a stream of pose targets within every joint limit.

    Args:
        robot: the arm.
        rate: control rate [Hz]; `step` is called once per period.
        settings: how a target is followed.
        solver: name of the QP solver, see `optsc.ik.solver_names`.
        avoid: what the arm keeps clear of; nothing by default.

    Raises:
        InvalidValue: a rate that is not positive.
        UnknownName: no such solver.
    """

    def __init__(
        self,
        robot: RobotModel,
        rate: float = 500.0,
        settings: ServoSettings | None = None,
        solver: str = "daqp",
        avoid: Avoidance | None = None,
    ) -> None:
        require("rate", rate, Positive)
        self.robot, self.rate, self.period = robot, rate, 1.0 / rate
        self.settings, self.avoid = settings or ServoSettings(), avoid
        self.guard = JointGuard(robot.limits, self.period)
        self.ik = DifferentialIK(robot, self.period, self.settings.ik, make_solver(solver))
        self._model = build_kernel(reference_model(prediction.FADING))
        self._reference, self._target, self._elapsed, values, period, self._led = self._model.inputs
        self._next_reference, self._gap = self._model.outputs
        # An arm that ramps its accelerations slowly cannot follow a quick reference.
        bandwidth = min(self.settings.bandwidth, 1.0 / ramp_time(robot.limits))
        values[ReferenceSettings.BANDWIDTH] = bandwidth
        for part, *pair in zip(_PARTS, tool_braking(robot.limits), self.settings.catching_up, strict=True):
            values[part] = pair
        period[:] = self.period
        self._at_rest = np.zeros(robot.n)
        self._waiting = 1.0 - exp(-self.period / WAITING)
        self._singular_volume = SINGULAR_SHARE * self.ik.volume(robot.home)
        self.reset(robot.home)

    def reset(self, q: ArrayLike, v: ArrayLike | None = None) -> None:
        """Start from posture ``q`` (n,) [rad] and velocity ``v`` (n,) [rad/s]; raise `InvalidValue`."""
        self.guard.reset(self.robot.checked(q), v)
        self.ticks = 0
        self.spent = 0.0
        """What the last tick took [s]; beside the command, which is the same whenever a run is repeated."""
        self._track: Track | None = None
        self._given: Track | None = None  # the track that the reference model's target was written from
        self._stopped = True

    def set_limits(self, limits: JointLimits) -> None:
        """Keep other joint limits from now on, also in motion, see `JointGuard.set_limits`; raise `InvalidValue`."""
        self.guard.set_limits(limits)

    def reset_posture(self, q: ArrayLike) -> None:
        """Go on from posture ``q`` (n,) [rad], at rest, without turning back the clock; raise `InvalidValue`."""
        self.guard.reset(self.robot.checked(q))
        self.forget()
        self._stopped = True

    @property
    def time(self) -> float:
        """Time since the reset [s], counted in ticks."""
        return self.ticks * self.period

    @property
    def X_WT(self) -> Pose:
        """The commanded tool pose."""
        return self.robot.forward(self.guard.q)

    @property
    def reference(self) -> tuple[Vector, Quaternion]:
        """Position and orientation that the tool is being led along; the commanded pose while stopped."""
        if self._stopped:
            X_WT = self.X_WT
            return tuple(X_WT.translation.tolist()), tuple(X_WT.quaternion.tolist())
        row = self._reference.tolist()
        return tuple(row[:3]), tuple(row[3:7])

    def _start(self) -> None:
        """Begin to lead the tool from where it is commanded to be, at the velocity that it has."""
        q, v, _ = self.guard.state
        X_WT, twist = self.robot.forward(q), self.robot.jacobian(q) @ v
        self._reference[:] = np.concatenate([X_WT.translation, X_WT.quaternion, twist, np.zeros(6)])
        self._stopped = False

    def step(self, X_WT: Pose | None = None, stamp: float | None = None) -> Command:
        """Move one tick and return its command; never raises on a bad target.

        Args:
            X_WT: a new target, or None when there is none at this tick: the last one is predicted on until it is
                older than the time-out.
            stamp: when the target was sampled [s], on the clock of `time`; now by default.
        """
        if X_WT is not None:
            p, q = X_WT.translation.tolist(), X_WT.quaternion.tolist()
            when = self.time if stamp is None else stamp
            if not _is_pose(p, q) or not abs(when) < FARTHEST:
                return self._stop(Status.INVALID, "target is not one finite pose with a unit quaternion")
            self.observe(tuple(p), tuple(q), when)
        track = self._track
        if track is None:
            return self._stop(Status.HOLDING, "no target yet")
        age = self.time - track.stamp
        if age > self.settings.timeout:
            return self._stop(Status.STALE, f"newest target is {age:.3f} s old")
        elapsed = age + self.period - self.settings.lag
        horizon = self.settings.prediction.horizon
        if elapsed > horizon:
            return self.track(*prediction.predicted(track, horizon))
        if self._stopped:
            self._start()
        if self._given is not track:
            p, q, v, w, _, a, b = self._given = track
            self._target[:] = (*p, *q, *v, *w, *a, *b)
            self._led[0] = self.settings.led
        self._elapsed[0] = elapsed
        return self._follow()

    def observe(self, p: Vector, q: Quaternion, stamp: float) -> None:
        """Take in a target sampled at ``stamp`` [s]; finite and unit is the caller's promise."""
        if self._track is None:
            self._track = prediction.at_rest(p, q, stamp)
        else:
            self._track = prediction.updated(self.settings.prediction, self._track, p, q, stamp)

    def forget(self) -> None:
        """Drop the stream of targets: the next one starts a new track, at rest."""
        self._track = None

    def track(
        self, p: Vector, q: Quaternion, v: Vector = REST, w: Vector = REST, a: Vector = REST, b: Vector = REST
    ) -> Command:
        """Move one tick towards a target pose, with its velocities and accelerations in W, at the end of the tick."""
        if self._stopped:
            self._start()
        self._given = None
        self._target[:] = (*p, *q, *v, *w, *a, *b)
        self._elapsed[0], self._led[0] = 0.0, 1.0
        return self._follow()

    def _follow(self) -> Command:
        """Move one tick on the way to the target that the reference model has been given."""
        start = perf_counter()
        self._model.run()
        reference, guard = self._reference, self.guard
        lowest, highest = guard.lowest, guard.highest
        rows = None if self.avoid is None else self.avoid.rows(guard.q, lowest, highest)
        step = self.ik.solve(guard.columns, reference[:7], self._next_reference[7:13], lowest, highest, rows)
        reference[:] = self._next_reference
        if not step.solved:
            return self._stop(Status.UNSOLVED, step.reason)
        # A little inside, or a reference that waits at just this distance would count as near at every other tick.
        far = _exceeds(step.error, self.settings.far, NEAR)
        gap = self._gap.tolist()
        noticeable = _exceeds(step.error, NOTICEABLE) or gap[0] > BEHIND[0] or gap[1] > BEHIND[1]
        if far:
            self._wait()
        wanted = np.minimum(np.maximum(step.velocity, guard.lowest), guard.highest)
        status, reason = self._verdict(wanted, far) if noticeable else (Status.FOLLOWING, "")
        if status is Status.LIMITED:
            self._yield(wanted)
        if step.volume < self._singular_volume and noticeable:
            status, reason = self._singular(step.error, status, reason)
        state = guard.advance(wanted)
        self.ticks += 1
        self.spent = perf_counter() - start
        return Command(
            *state, status, reason, step.error, step.volume, step.iterations, step.slack, guard.outside
        )

    def _wait(self) -> None:
        """Let the reference wait for an arm that cannot follow, so that there is no distance to make up in a rush."""
        X_WT, reference = self.X_WT, self._reference
        tool_q = tuple(X_WT.quaternion.tolist())
        far_p, far_r = self.settings.far
        ahead = scalar.shortened(tuple((reference[:3] - X_WT.translation).tolist()), far_p)
        turn = scalar.log(scalar.multiply(tuple(reference[3:7].tolist()), scalar.conjugate(tool_q)))
        reference[:3] = X_WT.translation + ahead
        reference[3:7] = scalar.multiply(scalar.exp(scalar.shortened(turn, far_r)), tool_q)

    def _yield(self, wanted: Array) -> None:
        """Lead the reference to an arm that a limit of its rates holds back, so that it does not have to run after.

        An arm that presses against the end of a joint is left alone: there is nothing that it could catch up with.
        """
        guard, reference = self.guard, self._reference
        bounds = np.where(wanted <= guard.lowest, guard.bounds[:, 0], -1.0)
        bounds = np.where(wanted >= guard.highest, guard.bounds[:, 1], bounds)
        if (bounds == Bound.POSITION).any():
            return
        share, q = self._waiting, guard.q
        X_WT, own = self.robot.forward(q), tuple(reference[3:7].tolist())
        back = scalar.log(scalar.multiply(tuple(X_WT.quaternion.tolist()), scalar.conjugate(own)))
        turn = scalar.exp((share * back[0], share * back[1], share * back[2]))
        reference[:3] += share * (X_WT.translation - reference[:3])
        reference[3:7] = scalar.multiply(turn, own)
        reference[7:13] += share * (self.robot.jacobian(q) @ wanted - reference[7:13])

    def _singular(self, error: Array, status: Status, reason: str) -> tuple[Status, str]:
        """Say so where the arm lags in a direction that it is losing."""
        if status in (Status.LIMITED, Status.BLOCKED):
            return status, reason
        lost = lost_direction(self.robot, self.guard.q)
        if towards(lost, error) < 0.5:
            return status, reason
        words = f"motion {lost.name} of the tool is lost (least singular value {lost.singular_value:.3f} m)"
        return (status if status is Status.UNREACHABLE else Status.SINGULAR), words

    def _verdict(self, wanted: Array, far: bool) -> tuple[Status, str]:
        guard = self.guard
        near = None if self.avoid is None else self.avoid.blocking(wanted)
        if near is not None:
            reason = f"{near.link} is {1e3 * near.distance:.0f} mm from {near.other}"
            return (Status.UNREACHABLE if far else Status.BLOCKED), reason
        at_low, at_high = wanted <= guard.lowest, wanted >= guard.highest
        if not (at_low | at_high).any():
            return (Status.UNREACHABLE, "no joint leads nearer") if far else (Status.FOLLOWING, "")
        joint = int(np.argmax(at_low | at_high))
        bound = Bound(int(guard.bounds[joint, int(at_high[joint])]))
        reason = f"{self.robot.joint_names[joint]}: {bound.name.lower()}"
        return (Status.UNREACHABLE if far else Status.LIMITED), reason

    def stop(self) -> Command:
        """Move one tick of a jerk-limited way to rest, or stay there."""
        return self._stop(Status.HOLDING, "")

    def _stop(self, status: Status, reason: str) -> Command:
        start, self._stopped = perf_counter(), True
        guard, rest = self.guard, self._at_rest
        if self.avoid is not None:
            rest = self.avoid.stopping(guard.q, guard.lowest, guard.highest, self.ik.solver)
        state = guard.advance(rest)
        self.ticks += 1
        self.spent = perf_counter() - start
        if status is Status.HOLDING and state.v.any():
            status = Status.STOPPING
        return Command(*state, status, reason, np.zeros(6), 0.0, 0, 0.0, guard.outside)
