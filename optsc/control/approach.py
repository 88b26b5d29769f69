"""The automatic motion: straight line and SLERP from pose to pose, with a jerk-limited time law."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import Annotated, NamedTuple

from optsc.checks import Checked, Pair, Positive
from optsc.geometry import scalar
from optsc.geometry.scalar import Quaternion, Vector
from optsc.shaping import TimeLaw


@dataclass(frozen=True)
class Approach(Checked):
    """How the robot moves by itself.

    Attributes:
        speed: of the tool along its path [m/s]; the paper's value is 0.1.
        angular_speed: of the tool where a path turns more than it travels [rad/s].
        acceleration, jerk: of the time law along the path [m/s^2, m/s^3].
        standoff: distance of the pre-grasp from the grasp, back along the approach axis [m].
        lift: height to lift an object to [m].
        carry_time: how long an object is carried before the task counts as finished [s].
        settle_time: how long the arm may take to catch up at the end of a path before that is a fault [s].
        position_tolerance, angle_tolerance: what counts as arrived, of the command [m, rad].
        measured_tolerance: what counts as arrived, of the tool as it is measured [m, rad]: more than the arm sags.
    """

    speed: Annotated[float, Positive] = 0.1
    angular_speed: Annotated[float, Positive] = 0.5
    acceleration: Annotated[float, Positive] = 0.5
    jerk: Annotated[float, Positive] = 5.0
    standoff: Annotated[float, Positive] = 0.1
    lift: Annotated[float, Positive] = 0.15
    carry_time: Annotated[float, Positive] = 1.2
    settle_time: Annotated[float, Positive] = 1.0
    position_tolerance: Annotated[float, Positive] = 1e-3
    angle_tolerance: Annotated[float, Positive] = 1e-2
    measured_tolerance: Annotated[tuple[float, float], Pair] = (5e-3, 0.04)


class PathTarget(NamedTuple):
    """Pose of T in W, its linear and angular velocity [m/s, rad/s] and acceleration [m/s^2, rad/s^2]."""

    p: Vector
    q: Quaternion
    v: Vector
    w: Vector
    a: Vector
    b: Vector


class StraightPath:
    """From one pose to another on a straight line, turning about one axis, from rest to rest."""

    def __init__(self, settings: Approach, p: Vector, q: Quaternion, end_p: Vector, end_q: Quaternion) -> None:
        self._p, self._q = p, q
        self._shift = (end_p[0] - p[0], end_p[1] - p[1], end_p[2] - p[2])
        self._turn = scalar.log(scalar.multiply(end_q, scalar.conjugate(q)))
        turning = hypot(*self._turn) * settings.speed / settings.angular_speed
        # Both parts share one law; the slower of the two sets the pace.
        self._law = TimeLaw(
            max(hypot(*self._shift), turning, 1e-9), settings.speed, settings.acceleration, settings.jerk
        )

    @property
    def duration(self) -> float:
        """Time from rest to rest [s]."""
        return self._law.duration

    def at(self, time: float) -> PathTarget:
        """Return the target at ``time`` [s] since the start."""
        point = self._law.at(time)
        length = self._law.length
        share, rate, change = point.s / length, point.rate / length, point.acceleration / length
        (x, y, z), (dx, dy, dz), (ax, ay, az) = self._p, self._shift, self._turn
        return PathTarget(
            (x + share * dx, y + share * dy, z + share * dz),
            scalar.multiply(scalar.exp((share * ax, share * ay, share * az)), self._q),
            (rate * dx, rate * dy, rate * dz),
            (rate * ax, rate * ay, rate * az),
            (change * dx, change * dy, change * dz),
            (change * ax, change * ay, change * az),
        )
