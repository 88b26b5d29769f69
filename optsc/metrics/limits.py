"""Joint-limit violations and margins of a motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optsc.checks import Positive, require
from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.metrics.motion import finite_rows

TOLERANCE = 1e-9
"""How far beyond a limit a value may be, in the limit's own unit, before it counts: rounding, no more."""


class LimitViolations(NamedTuple):
    """How often and how far a joint command left its limits.

    Attributes:
        position: samples at which some joint is beyond a position limit.
        velocity: the same for velocities.
        acceleration: the same for accelerations.
        jerk: the same for jerks, the differences of acceleration from one sample to the next.
        position_margin: least distance to a position limit [rad]; negative beyond it.
        velocity_ratio: greatest share of a velocity limit that was used [-].
        acceleration_ratio: the same for accelerations.
        jerk_ratio: the same for jerks.
    """

    position: int
    velocity: int
    acceleration: int
    jerk: int
    position_margin: float
    velocity_ratio: float
    acceleration_ratio: float
    jerk_ratio: float

    @property
    def total(self) -> int:
        """All violations together."""
        return self.position + self.velocity + self.acceleration + self.jerk


def limit_violations(
    rate: float,
    q: ArrayLike,
    v: ArrayLike,
    a: ArrayLike,
    *,
    lower: ArrayLike,
    upper: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    jerk: ArrayLike,
    tolerance: float = TOLERANCE,
) -> LimitViolations:
    """Return how often and how far commands at ``rate`` [Hz] left their limits.

    Args:
        rate: of the samples [Hz].
        q, v, a: joint positions [rad], velocities [rad/s] and accelerations [rad/s^2], each (N, n).
        lower, upper: position limits (n,) [rad].
        velocity, acceleration, jerk: greatest magnitudes (n,) [rad/s], [rad/s^2], [rad/s^3].
        tolerance: what is taken for rounding, in the unit of each limit.

    Without samples there are no violations, all shares are 0 and the margin is infinite. Raises
    `InvalidValue` when a command is not finite, or shapes or limits do not fit.
    """
    require("rate", rate, Positive)
    commands = [finite_rows(name, x) for name, x in (("q", q), ("v", v), ("a", a))]
    if len({x.shape for x in commands}) != 1:
        raise InvalidValue("q, v and a", [x.shape for x in commands], "one shape (N, n)")
    positions, velocities, accelerations = commands
    n = positions.shape[1]
    low, high = _limits("lower", lower, n), _limits("upper", upper, n)
    margin = np.minimum(positions - low, high - positions)
    jerks = np.diff(accelerations, axis=0) * rate
    used_v = _used(velocities, _limits("velocity", velocity, n, 0.0), tolerance)
    used_a = _used(accelerations, _limits("acceleration", acceleration, n, 0.0), tolerance)
    used_j = _used(jerks, _limits("jerk", jerk, n, 0.0), tolerance)
    return LimitViolations(
        position=_rows(margin < -tolerance),
        velocity=used_v[0],
        acceleration=used_a[0],
        jerk=used_j[0],
        position_margin=float(np.min(margin, initial=np.inf)),
        velocity_ratio=used_v[1],
        acceleration_ratio=used_a[1],
        jerk_ratio=used_j[1],
    )


class LimitMargins(NamedTuple):
    """How much room a motion left to the position limits, of the joint and sample that had the least.

    Attributes:
        least: [rad]; negative beyond a limit, infinite where no joint has one.
        least_share: the same as a share of half the joint's range [-]: 1 in the middle, 0 at a limit.
        mean_share: mean over the samples of each one's least share [-].
    """

    least: float
    least_share: float
    mean_share: float


def limit_margins(q: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> LimitMargins:
    """Return the margins of joint positions ``q`` (N, n) [rad] to limits (n,); infinite without samples.

    Joints without two limits have no range to take a share of, and count in neither share.
    """
    positions = finite_rows("q", q)
    n = positions.shape[1]
    low, high = _limits("lower", lower, n), _limits("upper", upper, n)
    margin = np.minimum(positions - low, high - positions)
    bounded = np.isfinite(low) & np.isfinite(high)
    share = margin[:, bounded] / (0.5 * (high - low)[bounded])
    worst = np.min(share, axis=1, initial=np.inf)
    return LimitMargins(
        float(np.min(margin, initial=np.inf)),
        float(np.min(worst, initial=np.inf)),
        float(np.mean(worst)) if len(worst) else float("inf"),
    )


def _limits(name: str, value: ArrayLike, n: int, above: float | None = None) -> Array:
    limits = np.asarray(value, dtype=float)
    if limits.shape != (n,) or np.any(np.isnan(limits)) or not (above is None or np.all(limits > above)):
        words = "" if above is None else f", above {above}"
        raise InvalidValue(f"{name} limits", limits.tolist(), f"shape ({n},), no NaN{words}")
    return limits


def _used(x: Array, limit: Array, tolerance: float) -> tuple[int, float]:
    """Return the number of samples beyond ``limit``, and the greatest share of it."""
    return _rows(np.abs(x) > limit + tolerance), float(np.max(np.abs(x) / limit, initial=0.0))


def _rows(beyond: NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(np.any(beyond, axis=1)))
