"""How smooth a movement is: spectral arc length and log dimensionless jerk.

S. Balasubramanian, A. Melendez-Calderon, A. Roby-Brami, E. Burdet, "On the analysis of movement smoothness",
Journal of NeuroEngineering and Rehabilitation 12:112, 2015. Both are without unit, never positive for natural
movements, and greater (nearer to zero) for smoother ones.

Both depend on the sample rate and on where the movement is cut out of the recording: bring everything to one
rate with `resample`, cut with `movement_window` or `moving_stretches`. On motion at constant speed the log
dimensionless jerk measures little but how it speeds up and stops.
"""

from __future__ import annotations

from math import inf, log, nan
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optsc.errors import InvalidValue
from optsc.geometry import rotation
from optsc.geometry.rotation import Array
from optsc.metrics.checks import finite, positive, profile

Derivative = Literal["position", "velocity", "acceleration"]

ONSET = 0.05
"""Share of the peak speed from which on something counts as moving [-]; the usual one, see `movement_window`."""
REST = 0.2
"""Shortest rest that separates two stretches of motion [s]; ours, a reaction time."""
SHORTEST = 0.1
"""Shortest stretch of motion [s]; ours, one period of physiological tremor."""
TREMOR = 0.2
"""Time over which velocities are averaged to tell motion from trembling [s]; ours, two of its periods."""

_DIFFERENCES: dict[str, int] = {"position": 3, "velocity": 2, "acceleration": 1}


def resample(time: ArrayLike, values: ArrayLike, rate: float) -> tuple[Array, Array]:
    """Return uniform times (M,) [s] within ``time`` (N,) and the ``values`` (N,) or (N, d) at them.

    A cubic spline, since the jerk of a straight interpolation lies in its kinks alone; a straight line for
    fewer than four samples. Raises `InvalidValue` unless ``time`` (N,) [s] increases and all is finite.
    """
    positive("rate", rate)
    t, x = profile("time", time)[:, 0], np.asarray(values, dtype=float)
    profile("values", x)
    if len(t) != len(x) or len(t) == 0 or np.any(np.diff(t) <= 0.0):
        raise InvalidValue("time", t.shape, f"increasing, one for each of the {len(x)} values")
    uniform = t[0] + np.arange(int((t[-1] - t[0]) * rate + 1e-6) + 1) / rate
    uniform = np.minimum(uniform, t[-1])
    if len(t) == 1:
        return uniform, x.copy()
    from scipy.interpolate import CubicSpline, make_interp_spline

    spline = CubicSpline(t, x, axis=0) if len(t) >= 4 else make_interp_spline(t, x, k=1)
    return uniform, np.asarray(spline(uniform))


def angular_velocity(quaternions: ArrayLike, rate: float) -> Array:
    """Return the angular velocity [rad/s] (N - 1, 3), in the fixed frame, between orientations (N, 4)."""
    positive("rate", rate)
    q = rotation.checked(finite("quaternions", quaternions, 4), "quaternions")
    return rate * rotation.log(rotation.multiply(q[1:], rotation.conjugate(q[:-1])))


def movement_window(speed: ArrayLike, fraction: float = ONSET) -> slice:
    """Return the samples of the movement in ``speed`` (N,); empty when nothing moves.

    They go from the first to the last at which the speed reaches ``fraction`` of its peak, and from there outwards to
    the foot of the curve, as long as the speed falls. A rest before or after a movement makes it look less smooth:
    cut it off first. A movement from rest to rest is kept whole, and so keeps its published smoothness.

    A share of the peak is how most studies find the onset of a movement (L. Botzer, A. Karniel, Frontiers in
    Neuroscience 3, 2009); going on to the minimum before it makes up for the part that such a threshold cuts off.
    """
    v = np.abs(profile("speed", speed)[:, 0])
    fast = _fast(v, fraction)
    return _to_foot(v, int(fast[0]), int(fast[-1]) + 1) if len(fast) else slice(0, 0)


def moving_stretches(
    velocity: ArrayLike, rate: float, fraction: float = ONSET, rest: float = REST, shortest: float = SHORTEST
) -> list[slice]:
    """Return the stretches of ``velocity`` (N, d), sampled at ``rate`` [Hz], in which something moves, in order.

    Looked at is the speed of the mean velocity over `TREMOR` about each sample, for a hand that is held still
    trembles. Where that reaches ``fraction`` of its peak there is motion; within it a stretch is what `movement_window`
    makes of the speed itself, so that a movement from rest to rest is kept whole and a rest is left out.

    Args:
        velocity: of a whole recording, rests included; or speeds (N,).
        rate: of the samples [Hz].
        fraction: of the greatest speed of all that counts as moving [-].
        rest: shortest time below it that separates two stretches [s]; less is a slow moment of one movement.
        shortest: what is above it for a shorter time is no movement [s].
    """
    positive("rate", rate)
    x = profile("velocity", velocity)
    speed, steady = np.linalg.norm(x, axis=1), np.linalg.norm(_mean_over(x, round(TREMOR * rate)), axis=1)
    fast = _fast(steady, fraction)
    if not len(fast):
        return []
    breaks = np.flatnonzero(np.diff(fast) - 1 >= max(1.0, rest * rate))
    firsts, lasts = fast[np.r_[0, breaks + 1]], fast[np.r_[breaks, len(fast) - 1]]
    stretches: list[slice] = []
    for first, last in zip(firsts, lasts, strict=True):
        within = first + np.flatnonzero(speed[first : last + 1] >= fraction * speed.max())
        if not len(within) or within[-1] - within[0] + 1 < shortest * rate:
            continue
        found = _to_foot(speed, int(within[0]), int(within[-1]) + 1)
        begin = max(found.start, stretches[-1].stop) if stretches else found.start
        stretches.append(slice(begin, found.stop))
    return stretches


def _mean_over(x: Array, count: int) -> Array:
    """Return the mean of ``x`` (N, d) over about ``count`` samples about each one; fewer at the ends."""
    half = count // 2
    total = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
    low = np.maximum(np.arange(len(x)) - half, 0)
    high = np.minimum(np.arange(len(x)) + half + 1, len(x))
    return (total[high] - total[low]) / (high - low)[:, None]


def _fast(speed: Array, fraction: float) -> NDArray[np.intp]:
    peak = speed.max(initial=0.0)
    return np.flatnonzero((speed >= fraction * peak) & (speed > 0.0))


def _to_foot(speed: Array, start: int, stop: int) -> slice:
    while start > 0 and speed[start - 1] < speed[start]:
        start -= 1
    while stop < len(speed) and speed[stop] < speed[stop - 1]:
        stop += 1
    return slice(start, stop)


def sparc(
    speed: ArrayLike,
    rate: float,
    cutoff: float = 10.0,
    amplitude_threshold: float = 0.05,
    padding: int = 4,
) -> float:
    """Return the spectral arc length [-] of a speed profile (N,), sampled at ``rate`` [Hz].

    SPARC = - integral from 0 to wc of sqrt((1/wc)^2 + (dV/dw)^2) dw, with V the magnitude of the Fourier
    transform over its greatest value, and wc where it falls below ``amplitude_threshold`` for good, at most
    ``cutoff`` [Hz]. Zeros are added up to 2^``padding`` times the next power of two of N. A minimum-jerk
    movement of a second has -1.40.

    It sees the speed alone: a change of direction at constant speed does not show; give it the speed of
    position, of rotation (`angular_velocity`) or of the joints. NaN for fewer than two samples or when
    nothing moves: no movement is neither smooth nor jerky.
    """
    positive("rate", rate)
    v = profile("speed", speed)[:, 0]
    if len(v) < 2 or not np.any(v):
        return nan
    count = 2 ** (int(np.ceil(np.log2(len(v)))) + padding)
    # The first half of the spectrum of a real signal says it all.
    magnitude = np.abs(np.fft.rfft(v, count))
    magnitude /= magnitude.max()
    frequency = np.arange(len(magnitude)) * rate / count
    magnitude = magnitude[frequency <= cutoff]
    above = np.flatnonzero(magnitude >= amplitude_threshold)
    if len(above) == 0 or above[-1] == above[0]:
        return nan
    kept = magnitude[above[0] : above[-1] + 1]
    return -float(np.sum(np.hypot(1.0 / (len(kept) - 1), np.diff(kept))))


def dimensionless_jerk(movement: ArrayLike, rate: float, given: Derivative = "velocity") -> float:
    """Return the dimensionless jerk [-] of ``movement`` (N,) or (N, d), sampled at ``rate`` [Hz].

    DJ = - T^3 / peak(|v|)^2 * integral of |d2v/dt2|^2 dt, with |.| the norm over the axes and T = N / rate.
    ``given`` says what the samples are: positions, velocities, or accelerations; for these last it is
    - T / peak(|a|)^2 * integral of |da/dt|^2 dt, a measure of its own. A speed profile (N,) gives the scalar
    form of the source, a vector (N, d) also sees changes of direction at constant speed.

    NaN when there are too few samples for one jerk, or when nothing moves.
    """
    positive("rate", rate)
    if given not in _DIFFERENCES:
        raise InvalidValue("given", given, f"one of {', '.join(_DIFFERENCES)}")
    x, order = profile("movement", movement), _DIFFERENCES[given]
    if len(x) <= order:
        return nan
    moving = np.diff(x, axis=0) * rate if given == "position" else x
    peak = float(np.max(np.linalg.norm(moving, axis=1)))
    if peak == 0.0:
        return nan
    jerk = np.diff(x, order, axis=0) * rate**order
    duration = len(x) / rate
    scale = duration if given == "acceleration" else duration**3
    return -scale / peak**2 * float(np.sum(jerk * jerk)) / rate


def log_dimensionless_jerk(movement: ArrayLike, rate: float, given: Derivative = "velocity") -> float:
    """Return the log dimensionless jerk LDLJ = -ln|DJ| [-]; see `dimensionless_jerk` for the arguments.

    A minimum-jerk movement has -5.32. NaN where `dimensionless_jerk` is; infinite for a motion without any
    jerk, which only a constant velocity or acceleration has.
    """
    jerk = dimensionless_jerk(movement, rate, given)
    return inf if jerk == 0.0 else -log(abs(jerk))


def joint_log_dimensionless_jerk(q: ArrayLike, rate: float) -> float:
    """Return the log dimensionless jerk [-] of the way in joint space, from joint positions (N, n) [rad]."""
    return log_dimensionless_jerk(finite("joint positions", q), rate, given="position")
