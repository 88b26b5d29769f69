"""How a person's hand moves: minimum-jerk movements, Fitts' law, motor noise, tremor, drift.

Sources of the values are given with each one; "ours" marks a choice of this library.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, exp, log2, pi, radians, sqrt

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array

_ABOVE_ZERO = (
    "sample_rate",
    "position_tolerance",
    "rotation_tolerance",
    "motor_noise_time",
    "tremor_bandwidth",
    "drift_time",
)


@dataclass(frozen=True)
class HumanParameters:
    """A person with a hand-held tracker; every value with its unit and its source, see also ``docs/operators.md``.

    Attributes:
        sample_rate: of the tracker [Hz]; the display rate at which headsets hand out poses.
        initial_rest: before the first movement [s]; ours.
        misalignment: greatest angle between hand and tool at the start [rad]; ours. People work on without
            noticing up to about 20 degrees (Che et al. 2015).
        fitts_intercept: a of MT = a + b ID [s]; ours.
        fitts_slope: b [s/bit]; 1 / 2.88 bit/s with a master-slave arm (Draper, Handel, Hood 1990), by hand 16.98.
        position_tolerance: how near to where it is wanted the tool has to come [m]; ours.
        rotation_tolerance: the same for its orientation [rad]; ours.
        reaction: from seeing an error to moving against it [s]; 0.12 to 0.20 (Saunders and Knill 2005).
        patience: longest wait for a tool that has not come to rest [s]; ours.
        corrections: most corrective movements before the person gives a pose up; ours. The bare hand takes one
            (Meyer et al. 1988), with an arm that lags there are more (Ferrell 1965).
        attempts: how many other poses are then tried before the person takes one as it is; ours.
        motor_noise: standard deviation of the hand's velocity noise, as a share of its speed [-]: noise that
            grows with the signal (Harris and Wolpert 1998). Value ours: a reach of 1 s ends 4 % off.
        motor_noise_time: correlation time of that noise [s]: the muscle's low-pass of two stages of 30 and
            40 ms (van Beers, Haggard, Wolpert 2004).
        tremor: root mean square of the tremor, for each axis [m]; 0.015 to 0.25 mm with an instrument in hand
            (PMC3032442, Fig. 4). Of the empty hand it is less (Archives of Neurology 39, 358, 1982).
        tremor_rotation: the same for rotation [rad]; ours, 0.2 mm at 15 cm from the wrist.
        tremor_frequency: within the 6 to 12 Hz in which physiological tremor peaks [Hz] (Lakie et al. 2015).
        tremor_bandwidth: width of its peak at half power [Hz]; ours, most of it then is in that band.
        drift: root mean square of the slow wandering of an unsupported arm, for each axis [m]; ours.
        drift_rotation: the same for rotation [rad]; ours.
        drift_time: its correlation time [s]; ours.
        tracker_noise: standard deviation of the tracker, for each axis [m]; ours, consumer trackers reach
            0.15 mm at rest (Maciejewski 2021) and are worse in use.
        tracker_noise_rotation: the same for rotation [rad]; ours, ten times the 0.008 degrees there.
        dwell: between being content with the pose and pressing the trigger [s]; ours, as long as the dwell that
            selects in a study of pointing by gaze and head (Hansen et al. 2018).
        press: how long the trigger is held [s]; ours.
        retrigger: least time between a lost automation and the next trigger [s]; ours.
        grasp_tolerance: how near to a grasp the tool has to come to close the jaws by hand [m, rad]; ours.
        standoff: how far before it a person who grasps by hand pauses [m]; ours, the robot's own.
        misjudged: how far off the tool is seen, always the same way [m, rad]; ours, none.
        hand_start: where the hand rests at first, in S [m]; ours.
    """

    sample_rate: float = 90.0
    initial_rest: float = 0.3
    misalignment: float = radians(8.0)
    fitts_intercept: float = 0.1
    fitts_slope: float = 0.35
    position_tolerance: float = 0.02
    rotation_tolerance: float = radians(7.0)
    reaction: float = 0.2
    patience: float = 2.0
    corrections: int = 4
    attempts: int = 3
    motor_noise: float = 0.084
    motor_noise_time: float = 0.07
    tremor: float = 0.2e-3
    tremor_rotation: float = radians(0.08)
    tremor_frequency: float = 10.0
    tremor_bandwidth: float = 2.5
    drift: float = 1.0e-3
    drift_rotation: float = radians(0.3)
    drift_time: float = 2.0
    tracker_noise: float = 0.3e-3
    tracker_noise_rotation: float = radians(0.1)
    dwell: float = 0.3
    press: float = 0.12
    retrigger: float = 1.0
    grasp_tolerance: tuple[float, float] = (0.006, radians(4.0))
    standoff: float = 0.1
    misjudged: tuple[float, float] = (0.0, 0.0)
    hand_start: tuple[float, float, float] = (0.35, -0.15, 1.05)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, tuple):
                continue
            valid = "finite, above 0" if name in _ABOVE_ZERO else "finite, 0 or above"
            if not 0.0 <= value < np.inf or (value == 0.0 and name in _ABOVE_ZERO):
                raise InvalidValue(name, value, valid)
        if self.tremor_frequency + self.tremor_bandwidth >= 0.5 * self.sample_rate:
            valid = "below half the sample rate, bandwidth included"
            raise InvalidValue("tremor_frequency", self.tremor_frequency, valid)
        if self.press * self.sample_rate < 1.0:
            raise InvalidValue("press", self.press, "one sample period or longer")
        for name, least in (("grasp_tolerance", "above 0"), ("misjudged", "0 or above")):
            value = getattr(self, name)
            if (
                len(value) != 2
                or not all(0.0 <= x < np.inf for x in value)
                or (least == "above 0" and 0.0 in value)
            ):
                raise InvalidValue(name, value, f"two finite numbers [m, rad], {least}")
        if len(self.hand_start) != 3 or not np.all(np.isfinite(self.hand_start)):
            raise InvalidValue("hand_start", self.hand_start, "three finite numbers [m]")

    def movement_time(self, distance: float, angle: float) -> float:
        """Return how long a movement over ``distance`` [m] and ``angle`` [rad] takes [s].

        Fitts' law with MacKenzie's index of difficulty log2(D/W + 1); the indices of a translation and a
        rotation made together add up (Stoelen and Akin 2010). The target is as wide as both tolerances.
        """
        bits = log2(distance / (2.0 * self.position_tolerance) + 1.0)
        bits += log2(angle / (2.0 * self.rotation_tolerance) + 1.0)
        return self.fitts_intercept + self.fitts_slope * bits


def minimum_jerk(fraction: float) -> float:
    """Return the share of the way covered after ``fraction`` of the time, 0 before and 1 after.

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
        """Return the share of the whole way that is covered from ``begin`` to ``end`` [s]."""
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

    def __init__(
        self, rng: np.random.Generator, sigma: Array, frequency: float, bandwidth: float, rate: float
    ) -> None:
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


class Hand:
    """A hand in S: where the person has brought it, and what the tracker reports of it."""

    def __init__(self, rng: np.random.Generator, X_SH: Pose, human: HumanParameters) -> None:
        self._rng, self._period = rng, 1.0 / human.sample_rate
        self._p, self._q = X_SH.translation, X_SH.quaternion
        # Components: three of position, three of rotation.
        self._motor = WanderingNoise(rng, np.full(6, human.motor_noise), human.motor_noise_time, self._period)
        drift = np.repeat([human.drift, human.drift_rotation], 3)
        self._drift = WanderingNoise(rng, drift, human.drift_time, self._period)
        tremor = np.repeat([human.tremor, human.tremor_rotation], 3)
        self._tremor = BandNoise(
            rng, tremor, human.tremor_frequency, human.tremor_bandwidth, human.sample_rate
        )
        self._tracker = np.repeat([human.tracker_noise, human.tracker_noise_rotation], 3)

    @property
    def X_SH(self) -> Pose:
        """Where the person has brought the hand, without what trembles and drifts about it."""
        return Pose(self._q, self._p)

    def advance(self, movement: Movement | None, time: float) -> Pose:
        """Carry out one period of ``movement`` up to ``time`` [s]; return what the tracker reports then."""
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
