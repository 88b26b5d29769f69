"""The servo: one pose target in, one safe joint command out, at every tick.

    target ──► prediction ──► reference model ──► QP IK ──► joint guard ──► Command

Every target passes the same third-order reference model, so that whatever changes upstream (a new sample, another
control mode, the end of a time-out) the reference keeps its position, velocity and acceleration:

    (d/dt + omega)^3 (r - target) = 0                                 reference r: pose, twist, acceleration

The quadratic program whose solution is the joint velocity of the tick is written in `optsc.ik.differential`. Its bounds
are the viable interval of position, velocity, acceleration and jerk limits (`optsc.kernels.viable`), its rows are those
of collision avoidance (`optsc.ik.avoidance`).
"""

from __future__ import annotations

from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import Positive, require
from optsc.control.loop_time import LoopTime
from optsc.control.servo_settings import ServoSettings
from optsc.control.state import Numbers, ServoSnapshot, ServoState
from optsc.control.status import Command, Status, error_text
from optsc.control.tracking import Tracking
from optsc.errors import InvalidValue, Mismatch
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Quaternion, Vector
from optsc.ik import DifferentialIK, make_solver
from optsc.ik.avoidance import Avoidance
from optsc.operators import prediction
from optsc.operators.prediction import REST, Track
from optsc.robot import JointLimits, RobotModel
from optsc.shaping import JointGuard


class Servo:
    """Follows a stream of pose targets within every joint limit.

    All that a tick changes is in `numbers` and `state`; a tick that cannot be completed changes neither.

    Args:
        robot: the arm.
        rate: control rate [Hz]; `step` is called once per period.
        settings: how a target is followed.
        solver: name of the QP solver, see `optsc.ik.solver_names`.
        avoid: what the arm keeps clear of; nothing by default.

    Attributes:
        numbers: joints, reference, preferred configuration.
        state: ticks, track of the target, whether it is stopped.
        spent: what the last tick took [s]; no part of the state, which is the same whenever a run is repeated.

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
        self.numbers, self.spent = Numbers(robot.n), 0.0
        self.guard = JointGuard(robot.limits, self.period, self.numbers.joints)
        self.ik = DifferentialIK(robot, self.period, self.settings.ik, make_solver(solver))
        self._tracking = Tracking(self.ik, self.settings, self.numbers, self.guard, avoid)
        self._written: Track | None = None  # the track that the reference model's target was written from
        self.numbers.preferred[:] = robot.home
        self.reset(robot.home)

    def reset(self, q: ArrayLike, v: ArrayLike | None = None) -> None:
        """Start from configuration ``q`` (n,) [rad] and velocity ``v`` (n,) [rad/s]; raise `InvalidValue`."""
        self.guard.reset(self.robot.checked(q), v)
        self.numbers.reference[:] = self.numbers.waiting[:] = 0.0
        self.state = ServoState()
        self._written = None
        self.spent = 0.0

    def set_limits(self, limits: JointLimits) -> None:
        """Keep other joint limits from now on, also in motion, see `JointGuard.set_limits`; raise `InvalidValue`."""
        self.guard.set_limits(limits)

    def prefer(self, q: ArrayLike) -> None:
        """Let spare motion go to configuration ``q`` (n,) [rad] from now on; raise `InvalidValue`."""
        self.numbers.preferred[:] = self.robot.checked(q, "preferred configuration")

    def snapshot(self) -> ServoSnapshot:
        """Return the whole state as it is now, see `restore`."""
        obstacles = None if self.avoid is None else self.avoid.snapshot()
        return ServoSnapshot(self.period, self.numbers.block.copy(), self.state, self.guard.limits, obstacles)

    def restore(self, snapshot: ServoSnapshot) -> None:
        """Go on from a snapshot of this servo, or of one with the same arm, settings and obstacles.

        Raises `Mismatch` for one of another rate or number of joints.
        """
        made_for, here = ((s.period, len(n)) for s, n in ((snapshot, snapshot.numbers), (self, self.numbers.block)))
        if made_for != here:
            raise Mismatch("a snapshot of period [s] and numbers", made_for, here)
        self._back_to(snapshot.numbers, snapshot.state, snapshot.limits)
        if self.avoid is not None and snapshot.obstacles is not None:
            self.avoid.restore(snapshot.obstacles)

    def _back_to(self, numbers: Array, state: ServoState, limits: JointLimits) -> None:
        self.numbers.block[:] = numbers
        self.state, self._written = state, None
        self.guard.refresh(limits)

    @property
    def time(self) -> float:
        """Time since the reset [s] at which the next tick begins: counted in ticks, or as the loop has said it."""
        return self.state.loop.time(self.state.ticks, self.period)

    def time_at(self, now: float | None) -> float:
        """Return what `time` a tick would have that begins at ``now`` [s], on the clock that the loop tells."""
        return self._begun(now).time(self.state.ticks, self.period)

    def _begun(self, now: float | None) -> LoopTime:
        return self.state.loop.begun(self.state.ticks, self.period, now)

    @property
    def X_WT(self) -> Pose:
        """The commanded tool pose."""
        return self.robot.forward(self.guard.q)

    @property
    def reference(self) -> tuple[Vector, Quaternion]:
        """Position and orientation that the tool is being led along; the commanded pose while stopped."""
        if self.state.stopped:
            X_WT = self.X_WT
            return tuple(X_WT.translation.tolist()), tuple(X_WT.quaternion.tolist())
        row = self.numbers.reference.tolist()
        return tuple(row[:3]), tuple(row[3:7])

    def step(self, X_WT: Pose | None = None, stamp: float | None = None, now: float | None = None) -> Command:
        """Move one tick and return its command; never raises.

        Args:
            X_WT: a new target, or None when there is none at this tick: the last one is predicted on until it is
                older than the time-out. One that is no pose, late or a duplicate is skipped; `TargetStream.counts` of
                the state counts them.
            stamp: when the target was sampled [s]; now by default. On the clock of `time`, or on another one, whose
                offset and drift are then learnt, see `optsc.operators.clock`.
            now: what time it is [s], on a clock of any origin that does not go back; one period after the last tick by
                default. Targets are where the hand is at that time, also after late or missed ticks, while the command
                moves by one period whatever it is.

        A tick that fails, in a solver for example, is taken back and becomes one of coming to rest; its status is
        `UNSOLVED`, its reason the error.
        """
        # A tick changes neither limits nor obstacles, so that this is the whole of a snapshot.
        self.begin(now)
        numbers, state, limits = self.numbers.block.copy(), self.state, self.guard.limits
        try:
            return self.timed(self.tick(X_WT, stamp))
        except Exception as error:  # noqa: BLE001 - whatever a solver or an obstacle raises, the arm must stop
            self._back_to(numbers, state, limits)
            return self.timed(self.halt(error_text(error)))
        except BaseException:
            self._back_to(numbers, state, limits)
            raise

    def begin(self, now: float | None) -> None:
        """Begin a tick at the time ``now`` [s], see `step`; for callers of `tick`, `track` and `stop`."""
        loop = self._begun(now)
        if loop is not self.state.loop:
            self.state = self.state._replace(loop=loop)

    def timed(self, command: Command) -> Command:
        """Return the command of a tick with how late it came, where the loop says what time it is."""
        loop = self.state.loop
        if loop.zero is None:
            return command
        status, reason = command.status, command.reason
        if status in (Status.FOLLOWING, Status.CATCHING_UP) and loop.lateness:
            status, reason = Status.LATE, loop.lateness
        return command._replace(status=status, reason=reason, late=loop.late, missing=loop.missing)

    def tick(self, X_WT: Pose | None = None, stamp: float | None = None) -> Command:
        """Move one tick like `step`, for callers that take a failed tick back themselves: what fails, raises."""
        if X_WT is not None:
            self._take(X_WT, stamp)
        track, stream = self.state.track, self.state.stream
        if track is None:
            status = Status.INVALID if stream.counts.refused_lately else Status.HOLDING
            return self._stop(status, f"no target yet{stream.lately}")
        age = self.time - track.stamp
        if age > self.settings.timeout:
            status = Status.INVALID if stream.counts.refused_lately else Status.STALE
            return self._stop(status, f"newest target is {age:.3f} s old{stream.lately}")
        horizon, hindsight = self.settings.prediction.horizon, self.settings.prediction.hindsight
        elapsed = max(age + self.period - self.settings.lag, -hindsight)
        if elapsed > horizon:
            return self.track(*prediction.predicted(track, horizon))
        if self.state.stopped:
            self._start()
        if self._written is not track:
            p, q, v, w, _, a, b = self._written = track
            self._tracking.aim((*p, *q, *v, *w, *a, *b))
        return self._follow(elapsed, self.settings.led)

    def _take(self, X_WT: Pose, stamp: float | None) -> None:
        """Take in a target where it is usable; one that is not is skipped and counted."""
        ticks, track, stopped, loop, stream = self.state
        stream, target = stream.read(X_WT, stamp, self.time, loop.zero)
        self.state = ServoState(ticks, track, stopped, loop, stream)
        if target is not None:
            self.observe(*target)

    def observe(self, p: Vector, q: Quaternion, stamp: float) -> None:
        """Take in a target sampled at ``stamp`` [s], no later than now; finite and unit is the caller's promise."""
        ticks, track, stopped, loop, stream = self.state
        stamp = min(stamp, self.time)
        if track is None:
            track = prediction.at_rest(p, q, stamp)
        else:
            track = prediction.updated(self.settings.prediction, track, p, q, stamp)
        self.state = ServoState(ticks, track, stopped, loop, stream)

    def forget(self) -> None:
        """Drop the stream of targets: the next one starts a new track, at rest."""
        ticks, _, stopped, loop, stream = self.state
        self.state = ServoState(ticks, None, stopped, loop, stream)

    def track(
        self, p: Vector, q: Quaternion, v: Vector = REST, w: Vector = REST, a: Vector = REST, b: Vector = REST
    ) -> Command:
        """Move one tick towards a target pose, with its velocities and accelerations in W, at the end of the tick."""
        if self.state.stopped:
            self._start()
        self._written = None
        self._tracking.aim((*p, *q, *v, *w, *a, *b))
        return self._follow(0.0, 1.0)

    def stop(self) -> Command:
        """Move one tick of a jerk-limited motion to rest, or stay there."""
        return self._stop(Status.HOLDING, "")

    def halt(self, reason: str) -> Command:
        """Move one tick to rest by the joint limits alone, without asking a solver; ``reason`` says what failed."""
        return self._come_to_rest(np.zeros(self.robot.n), Status.UNSOLVED, reason, perf_counter())

    def move(self, velocity: Array) -> Command:
        """Move one tick towards a joint velocity (n,) [rad/s], within the limits: to lead the command to the arm."""
        return self._come_to_rest(velocity, Status.LED, "the command is led to where the arm is", perf_counter())

    def _start(self) -> None:
        """Begin to lead the tool from where it is commanded to be, at the velocity that it has."""
        ticks, track, _, loop, stream = self.state
        self._tracking.start()
        self.state = ServoState(ticks, track, False, loop, stream)

    def _follow(self, elapsed: float, led: float) -> Command:
        """Move one tick towards the target that tracking has been given, see `Tracking.step`."""
        start = perf_counter()
        velocity, step, verdict, error = self._tracking.step(elapsed, led)
        if not step.solved:
            return self._stop(Status.UNSOLVED, step.reason)
        state = self.guard.advance(velocity)
        ticks, track, stopped, loop, stream = self.state
        self.state = ServoState(ticks + 1, track, stopped, loop, stream)
        self.spent = perf_counter() - start
        return Command(*state, *verdict, error, step.volume, step.iterations, step.slack, self.guard.outside)

    def _stop(self, status: Status, reason: str) -> Command:
        start, guard = perf_counter(), self.guard
        # Not one array for all ticks: it becomes part of the command, which is the caller's to write into.
        rest = np.zeros(self.robot.n)
        if self.avoid is not None:
            bounds = guard.lowest.copy(), guard.highest.copy()
            rest = self.avoid.stopping(guard.q.copy(), *bounds, self.ik.solver)
            fastest = np.maximum(guard.limits.velocity, np.abs(guard.columns[1]))
            if rest.shape != fastest.shape or not (np.abs(rest) <= fastest).all():
                raise InvalidValue("velocity of avoidance to stop with", rest.tolist(), "n numbers within the limits")
        return self._come_to_rest(rest, status, reason, start)

    def _come_to_rest(self, velocity: Array, status: Status, reason: str, start: float) -> Command:
        """Move one tick to ``velocity`` (n,), with which the arm comes to rest, and be stopped."""
        state = self.guard.advance(velocity)
        ticks, track, _, loop, stream = self.state
        self.state = ServoState(ticks + 1, track, True, loop, stream)
        self.spent = perf_counter() - start
        if status is Status.HOLDING and state.v.any():
            status = Status.STOPPING
        return Command(*state, status, reason, np.zeros(6), 0.0, 0, 0.0, self.guard.outside)
