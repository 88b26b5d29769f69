"""From the tracker's rate to the control rate: a constant-velocity (alpha-beta) filter on SE(3).

Kalata, "The tracking index", 1984: with beta = alpha^2 / (2 - alpha) the filter is the steady state of a Kalman
filter for a target of random acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from optsc.errors import InvalidValue
from optsc.geometry import scalar
from optsc.geometry.scalar import Quaternion, Vector


@dataclass(frozen=True)
class PredictionSettings:
    """How far a new sample is believed.

    Attributes:
        alpha: share of the surprise in a sample that goes to the pose, in (0, 1].
        horizon: how far beyond the last sample its velocity is carried on at most [s].
        longest_gap: samples further apart than this [s] start the estimate afresh, at rest.
    """

    alpha: float = 0.65
    horizon: float = 0.06
    longest_gap: float = 0.2

    def __post_init__(self) -> None:
        if not 0.0 < self.alpha <= 1.0:
            raise InvalidValue("alpha", self.alpha, "in (0, 1]")
        for name in ("horizon", "longest_gap"):
            if not getattr(self, name) >= 0.0:
                raise InvalidValue(name, getattr(self, name), "not negative [s]")

    @property
    def beta(self) -> float:
        """Share of the surprise that goes to the velocity."""
        return self.alpha * self.alpha / (2.0 - self.alpha)


class Track(NamedTuple):
    """Estimated pose, linear and angular velocity [m/s, rad/s] in W, at the time ``stamp`` [s]."""

    p: Vector
    q: Quaternion
    v: Vector
    w: Vector
    stamp: float


REST: Vector = (0.0, 0.0, 0.0)


def at_rest(p: Vector, q: Quaternion, stamp: float) -> Track:
    """Return the track of something that stands still."""
    return Track(p, q, REST, REST, stamp)


def predicted(track: Track, elapsed: float) -> tuple[Vector, Quaternion]:
    """Return the pose ``elapsed`` [s] after the track's stamp."""
    (x, y, z), (vx, vy, vz), (wx, wy, wz) = track.p, track.v, track.w
    turn = scalar.exp((wx * elapsed, wy * elapsed, wz * elapsed))
    return (x + vx * elapsed, y + vy * elapsed, z + vz * elapsed), scalar.multiply(turn, track.q)


def updated(settings: PredictionSettings, track: Track, p: Vector, q: Quaternion, stamp: float) -> Track:
    """Return the track after a new sample; one that is no later than the last only replaces the pose."""
    elapsed = stamp - track.stamp
    if elapsed > settings.longest_gap:
        return at_rest(p, q, stamp)
    if elapsed <= 0.0:
        return track._replace(p=p, q=q)
    expected_p, expected_q = predicted(track, elapsed)
    surprise = (p[0] - expected_p[0], p[1] - expected_p[1], p[2] - expected_p[2])
    turn = scalar.log(scalar.multiply(q, scalar.conjugate(expected_q)))
    alpha, gain = settings.alpha, settings.beta / elapsed
    correction = scalar.exp((alpha * turn[0], alpha * turn[1], alpha * turn[2]))
    return Track(
        tuple(e + alpha * s for e, s in zip(expected_p, surprise, strict=True)),  # type: ignore[arg-type]
        scalar.normalised(scalar.multiply(correction, expected_q)),
        tuple(v + gain * s for v, s in zip(track.v, surprise, strict=True)),  # type: ignore[arg-type]
        tuple(w + gain * s for w, s in zip(track.w, turn, strict=True)),  # type: ignore[arg-type]
        stamp,
    )
