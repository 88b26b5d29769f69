"""Hand-pose prediction: a constant-acceleration filter with fading memory on SE(3), from tracker to control rate.

The estimate is the quadratic in time that fits all samples best when a sample's weight decays exponentially with its
age; the gains follow from how long ago the last sample was, so that the memory is the same in seconds at every rate and
irregular samples need no case of their own. N. Morrison, "Introduction to Sequential Smoothing and Prediction",
McGraw-Hill 1969 (fading-memory polynomial filters). Read at a time before the newest sample, as the servo does, it
interpolates and does not extrapolate.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, hypot
from typing import Annotated, NamedTuple

from optsc.checks import Above, AtLeast, Checked, Each, Positive
from optsc.geometry import scalar
from optsc.geometry.scalar import Quaternion, Vector

FADING = 0.05
"""Time constant [s] with which an acceleration is taken to end beyond the newest sample (tuned here): a hand's do."""


@dataclass(frozen=True)
class PredictionSettings(Checked):
    """How long samples count, and how far beyond the last of them a motion is extrapolated.

    Attributes:
        memory: time constant with which older samples are forgotten [s]; more smooths more.
        horizon: how far beyond the last sample its motion is extrapolated at most [s] ...
        hindsight: ... and how far before it: a sample says little about what was long ago.
        longest_gap: samples further apart than this [s] start the estimate afresh, at rest ...
        largest_step: ... and so does one that is further than this from where it was expected [m, rad]: nothing moves
            like that, so its speed says nothing.
    """

    memory: Annotated[float, Positive] = 0.035
    horizon: Annotated[float, AtLeast(0.0)] = 0.06
    longest_gap: Annotated[float, AtLeast(0.0)] = 0.2
    largest_step: Annotated[tuple[float, float], Each(Above(0.0))] = (0.1, 0.6)
    hindsight: Annotated[float, AtLeast(0.0)] = 0.1

    def gains(self, elapsed: float) -> tuple[float, float, float]:
        """Return the shares of a surprise after ``elapsed`` [s] that go to pose, velocity and acceleration."""
        kept = exp(-elapsed / self.memory)
        lost = 1.0 - kept
        return 1.0 - kept**3, 1.5 * lost * lost * (1.0 + kept) / elapsed, lost**3 / elapsed**2


REST: Vector = (0.0, 0.0, 0.0)


class Track(NamedTuple):
    """Estimated pose, velocities [m/s, rad/s] and accelerations, linear and angular, in W, at ``stamp`` [s]."""

    p: Vector
    q: Quaternion
    v: Vector
    w: Vector
    stamp: float
    a: Vector = REST
    b: Vector = REST


def at_rest(p: Vector, q: Quaternion, stamp: float) -> Track:
    """Return the track of something that stands still."""
    return Track(p, q, REST, REST, stamp)


def travel(elapsed: float) -> tuple[float, float]:
    """Return what an acceleration adds to velocity [s] and position [s^2] by ``elapsed`` [s] after the track's stamp.

    Before the stamp it is constant, after it fades with `FADING`: what ends soon must not be carried far.
    """
    if elapsed <= 0.0:
        return elapsed, 0.5 * elapsed * elapsed
    speed = FADING * (1.0 - exp(-elapsed / FADING))
    return speed, FADING * (elapsed - speed)


def predicted(track: Track, elapsed: float) -> tuple[Vector, Quaternion]:
    """Return the pose ``elapsed`` [s] after the track's stamp."""
    return _moved(track, elapsed, travel(elapsed)[1])


def _moved(track: Track, elapsed: float, half_square: float) -> tuple[Vector, Quaternion]:
    (x, y, z), (vx, vy, vz), (ax, ay, az) = track.p, track.v, track.a
    (wx, wy, wz), (bx, by, bz) = track.w, track.b
    e, h = elapsed, half_square
    turn = scalar.exp((wx * e + bx * h, wy * e + by * h, wz * e + bz * h))
    p = (x + vx * e + ax * h, y + vy * e + ay * h, z + vz * e + az * h)
    return p, scalar.multiply(turn, track.q)


def updated(settings: PredictionSettings, track: Track, p: Vector, q: Quaternion, stamp: float) -> Track:
    """Return the track after a new sample; one that is no later than the last only replaces the pose."""
    elapsed = stamp - track.stamp
    if elapsed > settings.longest_gap:
        return at_rest(p, q, stamp)
    if elapsed <= 0.0:
        return track._replace(p=p, q=q)
    (ex, ey, ez), expected_q = _moved(track, elapsed, 0.5 * elapsed * elapsed)
    x, y, z = p[0] - ex, p[1] - ey, p[2] - ez
    turn = scalar.log(scalar.multiply(q, scalar.conjugate(expected_q)))
    if hypot(x, y, z) > settings.largest_step[0] or hypot(*turn) > settings.largest_step[1]:
        return at_rest(p, q, stamp)
    k, k_v, k_a = settings.gains(elapsed)
    correction = scalar.exp((k * turn[0], k * turn[1], k * turn[2]))
    return Track(
        (ex + k * x, ey + k * y, ez + k * z),
        scalar.normalised(scalar.multiply(correction, expected_q)),
        _changed(_changed(track.v, elapsed, track.a), k_v, (x, y, z)),
        _changed(_changed(track.w, elapsed, track.b), k_v, turn),
        stamp,
        _changed(track.a, k_a, (x, y, z)),
        _changed(track.b, k_a, turn),
    )


def _changed(old: Vector, gain: float, change: Vector) -> Vector:
    return old[0] + gain * change[0], old[1] + gain * change[1], old[2] + gain * change[2]
