"""How the operator and the robot share the work."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from itertools import pairwise
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.metrics import checks
from optsc.metrics.checks import finite, positive, profile


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
    positive("rate", rate)
    counts: dict[Hashable, int] = {}
    for value in mode:
        counts[value] = counts.get(value, 0) + 1
    return {value: count / rate for value, count in counts.items()}


def switch_count(mode: Sequence[Hashable]) -> int:
    """Return how often ``mode`` (N,) changes."""
    return sum(a != b for a, b in pairwise(mode))


def rising_edges(pressed: ArrayLike) -> int:
    """Return how often ``pressed`` (N,) of bool goes from False to True; a start as True is no edge.

    With the clutch it counts re-engagements, with the trigger presses.
    """
    values = np.asarray(pressed, dtype=bool)
    if values.ndim != 1:
        raise InvalidValue("pressed", values.shape, "shape (N,)")
    return int(np.count_nonzero(values[1:] & ~values[:-1]))


def intervention_ratio(hand_velocity: ArrayLike, deadband: float) -> float:
    """Return the share of time [-] in which the hand is faster than ``deadband``, in the velocity's unit.

    ``hand_velocity`` is (N, d), or speeds (N,). In this form G. Maeda reports human intervention ("Blending
    primitive policies in shared control", 2022). NaN without samples.
    """
    speed = _speed(hand_velocity)
    return float(np.mean(speed > checks.deadband(deadband))) if len(speed) else nan


def operator_effort(hand_velocity: ArrayLike, rate: float) -> float:
    """Return the integral of the hand's speed over time: the way the hand went, [m] for a velocity in m/s.

    ``hand_velocity`` is (N, d), or speeds (N,), at ``rate`` [Hz]; 0 without samples. The total input of
    S. Javdani et al. ("Shared autonomy via hindsight optimization", 2018) is of this kind.
    """
    positive("rate", rate)
    return float(np.sum(_speed(hand_velocity))) / rate


def agreement(operator: ArrayLike, robot: ArrayLike, deadband: float = 0.0) -> Agreement:
    """Return how far the velocities wished by ``operator`` and ``robot``, each (N, d), point the same way.

    Only samples at which both are faster than ``deadband`` count, as a direction needs a motion. Agreement
    and disagreement are NaN when there is none.
    """
    u, w = finite("operator's velocity", operator), finite("robot's velocity", robot)
    if u.shape != w.shape:
        raise InvalidValue("robot's velocity", w.shape, f"shape {u.shape}, as the operator's")
    u_speed, w_speed = np.linalg.norm(u, axis=1), np.linalg.norm(w, axis=1)
    both = np.minimum(u_speed, w_speed) > checks.deadband(deadband)
    if not np.any(both):
        return Agreement(nan, nan, 0.0 if len(u) else nan)
    cosine = np.sum(u[both] * w[both], axis=1) / (u_speed[both] * w_speed[both])
    return Agreement(float(np.mean(cosine)), float(np.mean(cosine < 0.0)), float(np.mean(both)))


def authority(operator: ArrayLike, executed: ArrayLike, deadband: float = 0.0) -> float:
    """Return how far the executed motion departs from the operator's wish [-]: mean of ||u_exec - u_h|| / ||u_h||.

    Both are velocities (N, d) in one frame; only samples at which the operator is faster than ``deadband`` count. 0
    where the robot does just what it is told; NaN where the operator never wished anything.
    """
    u, w = finite("operator's velocity", operator), finite("executed velocity", executed)
    if u.shape != w.shape:
        raise InvalidValue("executed velocity", w.shape, f"shape {u.shape}, as the operator's")
    speed = np.linalg.norm(u, axis=1)
    wishing = speed > checks.deadband(deadband)
    if not np.any(wishing):
        return nan
    return float(np.mean(np.linalg.norm((w - u)[wishing], axis=1) / speed[wishing]))


def _speed(velocity: ArrayLike) -> Array:
    return np.linalg.norm(profile("hand velocity", velocity), axis=1)
