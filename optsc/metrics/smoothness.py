"""Movement smoothness: spectral arc length (SPARC) and log dimensionless jerk (LDLJ).

S. Balasubramanian, A. Melendez-Calderon, A. Roby-Brami, E. Burdet, "On the analysis of movement smoothness",
Journal of NeuroEngineering and Rehabilitation 12:112, 2015. Both are without unit, never positive for natural
movements, and greater (nearer to zero) for smoother ones.

Both depend on the sample rate and on where the movement is cut out of the recording: bring everything to one rate and
cut it first, with `optsc.metrics.movements`. On motion at constant speed the log dimensionless jerk measures little
but how it speeds up and stops.
"""

from __future__ import annotations

from math import inf, log, nan
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import OneOf, Positive, require
from optsc.metrics.motion import finite_profile

Derivative = Literal["position", "velocity", "acceleration"]

_DIFFERENCES: dict[str, int] = {"position": 3, "velocity": 2, "acceleration": 1}


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
    position, of rotation (`optsc.metrics.angular_velocity`) or of the joints. NaN for fewer than two samples or when
    nothing moves: no movement is neither smooth nor jerky.
    """
    require("rate", rate, Positive)
    v = finite_profile("speed", speed)[:, 0]
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
    require("rate", rate, Positive)
    require("given", given, OneOf(_DIFFERENCES))
    x, order = finite_profile("movement", movement), _DIFFERENCES[given]
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
