"""Human motor model: minimum-jerk movements of the hand with motor noise, tremor, drift and a tracker's noise."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, exp, pi, sqrt

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.people.parameters import HumanParameters


def minimum_jerk(fraction: float) -> float:
    """Return the share of the distance covered after ``fraction`` of the time, 0 before and 1 after.

    Flash and Hogan 1985: of all movements from rest to rest the one with the least squared jerk.
    """
    s = min(max(fraction, 0.0), 1.0)
    return s * s * s * (10.0 + s * (-15.0 + 6.0 * s))


@dataclass(frozen=True, eq=False)
class Movement:
    """One minimum-jerk movement of the hand in S.

    Attributes:
        start: when it begins [s].
        duration: how long it takes [s].
        displacement: of the position (3,) [m].
        turn: rotation vector (3,) [rad]; the orientation goes from R to exp(turn) R about this fixed axis.
    """

    start: float
    duration: float
    displacement: Array
    turn: Array

    @classmethod
    def towards(cls, start: float, displacement: Array, turn: Array, human: HumanParameters) -> Movement:
        """Return the movement by ``displacement`` [m] and ``turn`` [rad] in the time ``human`` takes."""
        duration = human.movement_time(float(np.linalg.norm(displacement)), float(np.linalg.norm(turn)))
        return cls(start, duration, displacement, turn)

    @property
    def end(self) -> float:
        """When it is over [s]."""
        return self.start + self.duration

    def share_between(self, begin: float, end: float) -> float:
        """Return the share of the whole distance that is covered from ``begin`` to ``end`` [s]."""
        if self.duration <= 0.0:
            return 1.0 if begin < self.start <= end else 0.0
        before, after = (begin - self.start) / self.duration, (end - self.start) / self.duration
        return minimum_jerk(after) - minimum_jerk(before)


class WanderingNoise:
    """Noise that forgets with a time constant (Ornstein-Uhlenbeck), sampled exactly at a fixed period."""

    def __init__(self, rng: np.random.Generator, sigma: Array, time_constant: float, period: float) -> None:
        self._rng = rng
        self._keep = exp(-period / time_constant)
        self._push = np.asarray(sigma, dtype=float) * sqrt(1.0 - self._keep * self._keep)
        self._value = np.asarray(sigma, dtype=float) * rng.standard_normal(len(self._push))

    def next(self) -> Array:
        """Return the value one period later, in the unit of ``sigma``."""
        self._value = self._keep * self._value + self._push * self._rng.standard_normal(len(self._push))
        return self._value


class BandNoise:
    """Noise in a narrow band: a second-order autoregressive process, as tremor is modelled (PMC3032442)."""

    def __init__(self, rng: np.random.Generator, sigma: Array, frequency: float, bandwidth: float, rate: float) -> None:
        self._rng = rng
        radius = exp(-pi * bandwidth / rate)
        self._a, self._b = 2.0 * radius * cos(2.0 * pi * frequency / rate), -radius * radius
        # Variance of the process over that of what drives it (Box and Jenkins, Time Series Analysis, ch. 3).
        gain = (1.0 - self._b) / ((1.0 + self._b) * ((1.0 - self._b) ** 2 - self._a**2))
        sigma = np.asarray(sigma, dtype=float)
        self._push = sigma / sqrt(gain)
        self._last, self._before = sigma * rng.standard_normal((2, len(sigma)))

    def next(self) -> Array:
        """Return the value one period later, in the unit of ``sigma``."""
        drive = self._push * self._rng.standard_normal(len(self._push))
        self._before, self._last = self._last, self._a * self._last + self._b * self._before + drive
        return self._last


class SimulatedHand:
    """A hand in S: where the person has brought it, and what the tracker reports of it."""

    def __init__(self, rng: np.random.Generator, X_SH: Pose, human: HumanParameters) -> None:
        self._rng, self._period = rng, 1.0 / human.sample_rate
        self._p, self._q = X_SH.translation, X_SH.quaternion
        # Components: three of position, three of rotation.
        self._motor = WanderingNoise(rng, np.full(6, human.motor_noise), human.motor_noise_time, self._period)
        drift = np.repeat([human.drift, human.drift_rotation], 3)
        self._drift = WanderingNoise(rng, drift, human.drift_time, self._period)
        tremor = np.repeat([human.tremor, human.tremor_rotation], 3)
        self._tremor = BandNoise(rng, tremor, human.tremor_frequency, human.tremor_bandwidth, human.sample_rate)
        self._tracker = np.repeat([human.tracker_noise, human.tracker_noise_rotation], 3)

    @property
    def X_SH(self) -> Pose:
        """Where the person has brought the hand, without what trembles and drifts about it."""
        return Pose(self._q, self._p)

    def advance(self, movement: Movement | None, time: float) -> Pose:
        """Execute one period of ``movement`` up to ``time`` [s]; return what the tracker reports then."""
        noise = self._motor.next()
        if movement is not None:
            share = movement.share_between(time - self._period, time)
            step, turn = share * movement.displacement, share * movement.turn
            self._p = self._p + step + np.linalg.norm(step) * noise[:3]
            q = rotation.multiply(rotation.exp(turn + np.linalg.norm(turn) * noise[3:]), self._q)
            self._q = q / np.linalg.norm(q)
        about = self._drift.next() + self._tremor.next() + self._tracker * self._rng.standard_normal(6)
        q = rotation.multiply(rotation.exp(about[3:]), self._q)
        return Pose(q / np.linalg.norm(q), self._p + about[:3])
