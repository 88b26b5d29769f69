"""Where the arm is: joint positions as the follower measures them, and how far they are believed.

One reading is never trusted. A reading is usable if it is a finite configuration near the joint limits that the arm can
have reached since the last usable one; what is not usable is skipped and counted. The arm is believed to be where
several readings in a row agree that it is, and at rest when they have not moved for a while. Readings that contradict
the earlier ones, but agree with each other for as long, replace them: the arm is there after all.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, nan
from typing import Annotated, Any, NamedTuple

import numpy as np

from optsc.checks import Checked, Positive
from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Quaternion, Vector
from optsc.robot import JointLimits, RobotModel

ENOUGH = 5
"""Readings in a row that have to agree before they are believed (tuned here)."""
FASTER = 1.5
"""By how much a joint may be faster than its limit before a reading is taken for a fault: nobody commanded it, but
whoever leads the arm by hand may have done it (tuned here)."""
FARTHEST_TURN = 1e6
"""Positions [rad] of an endless joint beyond this are a fault: one turn could not be told from another."""


@dataclass(frozen=True)
class TrackingTolerance(Checked):
    """How far the arm may be off its command, and when a reading of it is believed.

    Attributes:
        fault: distance of the joint furthest from its command [rad] at which the arm no longer follows.
        resume: distance of the joint furthest from its command [rad] within which motion begins. In hold an arm that is
            further away is not pulled back: the command is led to it. It has to be more than the arm sags.
        noise: by how much one reading may be off [rad].
        rest: how far an arm at rest seems to move for the noise of its readings [rad].
        consistent_time: for how long readings have to agree before they are believed [s].
        rest_time: how long the arm has to be at rest before motion begins [s].
        timeout: time without a usable reading after which the arm stops [s].
        beyond: how far beyond its position limits a joint may be measured before that is a fault of the reading [rad].
    """

    fault: Annotated[float, Positive] = 0.3
    resume: Annotated[float, Positive] = 0.02
    noise: Annotated[float, Positive] = 0.01
    rest: Annotated[float, Positive] = 3e-3
    consistent_time: Annotated[float, Positive] = 0.02
    rest_time: Annotated[float, Positive] = 0.05
    timeout: Annotated[float, Positive] = 0.1
    beyond: Annotated[float, Positive] = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.resume >= self.fault:
            raise InvalidValue("TrackingTolerance.resume", self.resume, f"less than fault, {self.fault} rad")


class Series(NamedTuple):
    """Readings in a row that agree.

    Attributes:
        q: the last of them (n,) [rad]; endless joints go on from one reading to the next, without a jump by a turn.
        time: for how long they agree [s].
        readings: how many they are.
        unchanged: for how long the last has been repeated [s]: many drivers are slower than the loop.
    """

    q: Array
    time: float = 0.0
    readings: int = 1
    unchanged: float = 0.0

    def after(self, q: Array, elapsed: float) -> Series:
        """Return the series after one more reading, ``elapsed`` [s] after the last."""
        same = bool((q == self.q).all())
        q = self.q if same else q
        return Series(q, self.time + elapsed, self.readings + 1, self.unchanged + elapsed if same else 0.0)

    def believed(self, tolerance: TrackingTolerance) -> bool:
        """Tell whether that is enough to believe."""
        return self.readings >= ENOUGH and self.time >= tolerance.consistent_time

    def agrees(self, step: Array, elapsed: float, tolerance: TrackingTolerance, limits: JointLimits) -> bool:
        """Tell whether an arm can make a ``step`` (n,) [rad] in the time since the last reading that was new."""
        since = max(elapsed, min(self.unchanged + elapsed, tolerance.consistent_time))
        return bool((np.abs(step) <= FASTER * since * limits.velocity + tolerance.noise).all())


class MeasuredArm(NamedTuple):
    """Where the arm is, as far as its readings tell; a value, see `updated`.

    Attributes:
        tolerance: when readings are usable, and when they are believed.
        series: the usable readings; None before there is one.
        before: the two readings before the last of them, to tell a single wrong one that was plausible.
        rival: readings that contradict the series, and agree with each other.
        age: time since the last usable reading [s].
        missed: readings since then.
        skipped: how many readings were not usable since the start.
        problem: what was wrong with the last of them, in words.
        clock: the follower's time at the last usable reading [s].
        anchor: where the arm came to rest (n,) [rad], and ...
        still: ... for how long it has been there [s].
    """

    tolerance: TrackingTolerance = TrackingTolerance()
    series: Series | None = None
    before: tuple[Array, ...] = ()
    rival: Series | None = None
    age: float = 0.0
    missed: int = 0
    skipped: int = 0
    problem: str = ""
    clock: float = 0.0
    anchor: Array | None = None
    still: float = 0.0

    @property
    def q(self) -> Array | None:
        """The configuration (n,) [rad]: the middle one of the last three readings; None before there is one."""
        if self.series is None:
            return None
        last = self.series.q
        if len(self.before) < 2 or (self.before[0] is last and self.before[1] is last):
            return last
        a, b = self.before
        return np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), last))

    def tool(self, robot: RobotModel) -> tuple[Vector, Quaternion] | None:
        """Return position and orientation of the tool in W; None while the readings are not believed."""
        q = self.q
        if q is None or not self.believed:
            return None
        X_WT = robot.forward(q)
        return tuple(X_WT.translation.tolist()), tuple(X_WT.quaternion.tolist())

    @property
    def silent(self) -> bool:
        """Tell whether there has been no usable reading for too long."""
        return self.age >= self.tolerance.timeout and self.missed >= ENOUGH

    @property
    def believed(self) -> bool:
        """Tell whether the arm is where `q` says."""
        return self.series is not None and self.series.believed(self.tolerance) and not self.silent

    @property
    def at_rest(self) -> bool:
        """Tell whether the arm is believed, and has not moved for a while."""
        return self.believed and self.still >= self.tolerance.rest_time

    @property
    def doubt(self) -> str:
        """Return why the arm is not believed to be where `q` says, in words; empty where it is."""
        if self.silent:
            return f"there has been no usable reading of the arm for {self.age:.2f} s: {self.problem}"
        return "" if self.believed else "the arm's readings are not consistent yet"

    def updated(self, robot: RobotModel, period: float, measured: Any) -> MeasuredArm:
        """Return what is known after a tick of ``period`` [s]; never raises.

        Args:
            robot: the arm.
            period: time since the tick before [s].
            measured: the follower's state, or whatever has come in its place.
        """
        tolerance, limits = self.tolerance, robot.limits
        reading, problem = reading_of(measured, tolerance, limits)
        if reading is None:
            return self._without(problem, period)
        clock = _clock_of(measured)
        series = self.series
        if series is None:
            return self._replace(series=Series(reading), age=0.0, missed=0, clock=clock, anchor=reading)
        elapsed = max(self.age + period, min(clock - self.clock, tolerance.timeout))
        step = robot.difference(reading, series.q)
        if not series.agrees(step, elapsed, tolerance, limits):
            return self._contradicted(robot, period, reading, clock)
        after = series.after(series.q + step, elapsed)
        now = self._replace(
            series=after, before=(*self.before[-1:], series.q), rival=None, age=0.0, missed=0, clock=clock
        )
        return now._rested(elapsed)

    def _rested(self, elapsed: float) -> MeasuredArm:
        """Return the same with what is known about rest."""
        q, anchor = self.q, self.anchor
        if q is anchor or anchor is None or q is None or bool((np.abs(q - anchor) <= self.tolerance.rest).all()):
            return self._replace(still=self.still + elapsed)
        return self._replace(anchor=q, still=0.0)

    def _without(self, problem: str, period: float) -> MeasuredArm:
        now = self._replace(age=self.age + period, missed=self.missed + 1, skipped=self.skipped + 1, problem=problem)
        # What was measured before the gap says nothing about the arm after it.
        if not now.silent:
            return now
        return now._replace(series=None, before=(), rival=None, anchor=None, still=0.0)

    def _contradicted(self, robot: RobotModel, period: float, reading: Array, clock: float) -> MeasuredArm:
        """Return what is known after a reading that the arm cannot have reached from the ones before."""
        tolerance, rival = self.tolerance, self.rival
        step = None if rival is None else robot.difference(reading, rival.q)
        if rival is None or step is None or not rival.agrees(step, period, tolerance, robot.limits):
            rival = Series(reading)
        else:
            rival = rival.after(rival.q + step, period)
        if rival.believed(tolerance):
            q = rival.q
            return MeasuredArm(tolerance, rival, skipped=self.skipped, problem=self.problem, clock=clock, anchor=q)
        problem = "the arm cannot move as its readings do"
        return self._without(problem, period)._replace(rival=rival)


def reading_of(measured: Any, tolerance: TrackingTolerance, limits: JointLimits) -> tuple[Array | None, str]:
    """Return the configuration (n,) of a follower's state in memory of its own, or None and what is wrong with it."""
    n = len(limits)
    try:
        q = np.array(measured.q, dtype=float)
    except Exception:  # noqa: BLE001 - whatever a user's driver hands in, the loop goes on
        return None, f"a {type(measured).__name__} without a configuration"
    if q.shape != (n,):
        return None, f"the measured configuration has the shape {q.shape}, not ({n},)"
    if not np.isfinite(q).all():
        return None, "the measured configuration is not finite"
    lower, upper = limits.positions
    if ((q < lower - tolerance.beyond) | (q > upper + tolerance.beyond) | (np.abs(q) > FARTHEST_TURN)).any():
        return None, "the measured configuration is far beyond the position limits"
    q.flags.writeable = False
    return q, ""


def opening_of(measured: Any) -> float:
    """Return the measured distance of the jaws [m]; not a number where there is none."""
    try:
        return float(measured.opening)
    except Exception:  # noqa: BLE001 - as above
        return nan


def _clock_of(measured: Any) -> float:
    """Return the follower's time [s]; zero where it has none."""
    time = getattr(measured, "time", 0.0)
    return float(time) if isinstance(time, (int, float)) and isfinite(time) else 0.0


def offset(robot: RobotModel, limits: JointLimits, q: Array, command: Array) -> Array:
    """Return how far (n,) [rad] a command has to be led to be where the arm is, as far as position limits allow.

    An arm beyond a limit may be commanded anywhere between there and the limit.
    """
    q = command + robot.difference(q, command)
    inside = limits.clip(q)
    return np.clip(command, np.minimum(q, inside), np.maximum(q, inside)) - command


def tracking_error(robot: RobotModel, q: Array, command: Array) -> float:
    """Return how far the joint furthest from its command is from it [rad], of endless joints the shortest turn."""
    return float(np.abs(robot.difference(q, command)).max())
