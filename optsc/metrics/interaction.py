"""Human-robot interaction measures: how the operator and the robot share the work."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from itertools import pairwise
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import NonNegative, Positive, require
from optsc.errors import InvalidValue
from optsc.geometry import rotation
from optsc.geometry.rotation import Array
from optsc.metrics.motion import HandMotion, Measures, Motion, finite_profile, finite_rows

HAND_WINDOW = 0.25
"""Time [s] over which the hand's velocity is fitted: tremor and the tracker's noise would else count as motion."""
HAND_DEADBAND = 0.02
"""Speed of the hand [m/s] up to which it counts as at rest; tuned here, ten times what the fit leaves of the noise."""
TOOL_DEADBAND = 0.005
"""The same for the tool [m/s], which an arm moves that does not tremble."""


class Agreement(NamedTuple):
    """How far the operator's and the robot's wishes point the same way.

    Attributes:
        agreement: mean cosine of the angle between them [-], in [-1, 1].
        disagreement: share of samples at which they point apart, the cosine being negative [-], in [0, 1].
        share: share of samples at which both wish to move, which the other two are taken over [-].
    """

    agreement: float
    disagreement: float
    share: float


def time_in_mode(mode: Sequence[Hashable], rate: float) -> dict[Hashable, float]:
    """Return for how long [s] each value occurs in ``mode`` (N,) at ``rate`` [Hz], in order of appearance."""
    require("rate", rate, Positive)
    return {value: count / rate for value, count in Counter(mode).items()}


def switch_count(mode: Sequence[Hashable]) -> int:
    """Return how often ``mode`` (N,) changes."""
    return sum(a != b for a, b in pairwise(mode))


def intervention_ratio(hand_velocity: ArrayLike, deadband: float) -> float:
    """Return the share of time [-] in which the hand is faster than ``deadband``, in the velocity's unit.

    ``hand_velocity`` is (N, d), or speeds (N,). In this form G. Maeda reports human intervention ("Blending
    primitive policies in shared control", 2022). NaN without samples.
    """
    speed = _speed(hand_velocity)
    require("deadband", deadband, NonNegative)
    return float(np.mean(speed > deadband)) if len(speed) else nan


def operator_effort(hand_velocity: ArrayLike, rate: float) -> float:
    """Return the integral of the hand's speed over time: the length of the hand's path, [m] for a velocity in m/s.

    ``hand_velocity`` is (N, d), or speeds (N,), at ``rate`` [Hz]; 0 without samples. The total input of
    S. Javdani et al. ("Shared autonomy via hindsight optimization", 2018) is of this kind.
    """
    require("rate", rate, Positive)
    return float(np.sum(_speed(hand_velocity))) / rate


def agreement(operator: ArrayLike, robot: ArrayLike, deadband: float = 0.0) -> Agreement:
    """Return how far the velocities wished by ``operator`` and ``robot``, each (N, d), point the same way.

    Only samples at which both are faster than ``deadband`` count, as a direction needs a motion. Agreement
    and disagreement are NaN when there is none.
    """
    u, w = finite_rows("operator's velocity", operator), finite_rows("robot's velocity", robot)
    require("deadband", deadband, NonNegative)
    if u.shape != w.shape:
        raise InvalidValue("robot's velocity", w.shape, f"shape {u.shape}, as the operator's")
    u_speed, w_speed = np.linalg.norm(u, axis=1), np.linalg.norm(w, axis=1)
    both = np.minimum(u_speed, w_speed) > deadband
    if not np.any(both):
        return Agreement(nan, nan, 0.0 if len(u) else nan)
    cosine = np.sum(u[both] * w[both], axis=1) / (u_speed[both] * w_speed[both])
    return Agreement(float(np.mean(cosine)), float(np.mean(cosine < 0.0)), float(np.mean(both)))


def _speed(velocity: ArrayLike) -> Array:
    return np.linalg.norm(finite_profile("hand velocity", velocity), axis=1)


def hand_velocity(hand: HandMotion) -> Array:
    """Return the hand's velocity (S, 3) [m/s] in S: of a parabola fitted to its positions over `HAND_WINDOW`.

    Differences of neighbouring samples would mostly be noise: 0.3 mm at 90 Hz looks like 4 cm/s. Zero where there are
    too few samples for a fit. After A. Savitzky, M. J. E. Golay, Analytical Chemistry 36(8), 1964.
    """
    count = len(hand.stamp)
    if count < 3:
        return np.zeros((count, 3))
    from scipy.signal import savgol_filter

    period = float(np.median(np.diff(hand.stamp)))
    if period <= 0.0:
        return np.zeros((count, 3))
    window = min(2 * round(0.5 * HAND_WINDOW / period) + 1, count - 1 + count % 2)
    if window < 3:
        return np.zeros((count, 3))
    return np.asarray(savgol_filter(hand.p, window, min(2, window - 1), deriv=1, delta=period, axis=0))


def interaction_measures(motion: Motion, R_WS: ArrayLike = (1.0, 0.0, 0.0, 0.0)) -> Measures:
    """Return how operator and robot shared ``motion``; ``R_WS`` turns the hand's station into the world.

    ``effort_m`` is the length of the hand's path without its trembling, ``intervention`` the share of time in which it
    moved, ``agreement`` the mean cosine between its velocity and the tool's, ``switches`` the changes of mode.
    """
    u = rotation.rotate(np.asarray(R_WS, dtype=float), hand_velocity(motion.hand))
    gaps = np.diff(motion.hand.stamp)
    hand_rate = 1.0 / float(np.median(gaps)) if len(gaps) and np.median(gaps) > 0.0 else nan
    speed = np.linalg.norm(u, axis=1)
    moving = np.where(speed > HAND_DEADBAND, speed, 0.0)
    row = {
        "effort_m": operator_effort(moving, hand_rate) if hand_rate == hand_rate else 0.0,
        "intervention": intervention_ratio(u, HAND_DEADBAND),
        "switches": float(switch_count(motion.modes)),
        "agreement": nan,
        "disagreement": nan,
    }
    tool = np.gradient(motion.X_WT.translation, axis=0) * motion.rate if len(motion) > 1 else np.zeros((0, 3))
    if len(u) and len(tool):
        ticks = np.rint((motion.hand.stamp - motion.time) * motion.rate)
        ticks = np.clip(ticks, 0, len(tool) - 1).astype(int)
        both = (speed > HAND_DEADBAND) & (np.linalg.norm(tool[ticks], axis=1) > TOOL_DEADBAND)
        found = agreement(u[both], tool[ticks][both])
        row.update(agreement=found.agreement, disagreement=found.disagreement)
    for mode, seconds in time_in_mode(motion.modes, motion.rate).items():
        row[f"time_{mode}_s"] = seconds
    return row
