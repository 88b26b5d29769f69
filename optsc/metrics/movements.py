"""Movement segmentation and resampling: where a motion begins, rests and ends, and how smooth it is between.

Smoothness depends on the sample rate and on where a movement is cut out of the recording: `smoothness_measures` and
`stretch_smoothness` bring motions to one rate, cut them and judge them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import nan

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optsc.checks import Positive, require
from optsc.errors import InvalidValue
from optsc.geometry import rotation
from optsc.geometry.rotation import Array
from optsc.metrics.motion import Measures, Motion, finite_profile, finite_rows
from optsc.metrics.smoothness import log_dimensionless_jerk, sparc

ONSET = 0.05
"""Share of the peak speed from which on something counts as moving [-]; the usual one, see `movement_window`."""
REST = 0.2
"""Shortest rest that separates two stretches of motion [s]; tuned here, a reaction time."""
SHORTEST = 0.1
"""Shortest stretch of motion [s]; tuned here, one period of physiological tremor."""
TREMOR = 0.2
"""Time over which velocities are averaged to distinguish motion from trembling [s]; tuned here, two of its periods."""
SMOOTHNESS_RATE = 100.0
"""Both smoothness measures depend on the sample rate, so everything is brought to this one [Hz]."""
TURN_RADIUS = 0.1
"""Where the tool moves or turns, an angle counts as what it moves so far away [m]; tuned here, a hand's length."""


def resample(time: ArrayLike, values: ArrayLike, rate: float) -> tuple[Array, Array]:
    """Return uniform times (M,) [s] within ``time`` (N,) and the ``values`` (N,) or (N, d) at them.

    A cubic spline, since the jerk of a straight interpolation lies in its kinks alone; a straight line for
    fewer than four samples. Raises `InvalidValue` unless ``time`` (N,) [s] increases and all is finite.
    """
    require("rate", rate, Positive)
    t, x = finite_profile("time", time)[:, 0], np.asarray(values, dtype=float)
    finite_profile("values", x)
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
    require("rate", rate, Positive)
    q = rotation.checked(finite_rows("quaternions", quaternions, 4), "quaternions")
    return rate * rotation.log(rotation.multiply(q[1:], rotation.conjugate(q[:-1])))


def movement_window(speed: ArrayLike, fraction: float = ONSET) -> slice:
    """Return the samples of the movement in ``speed`` (N,); empty when nothing moves.

    They go from the first to the last at which the speed reaches ``fraction`` of its peak, and from there outwards to
    the foot of the curve, as long as the speed falls. A rest before or after a movement makes it look less smooth:
    cut it off first. A movement from rest to rest is kept whole, and so keeps its published smoothness.

    A share of the peak is how most studies find the onset of a movement (L. Botzer, A. Karniel, Frontiers in
    Neuroscience 3, 2009); going on to the minimum before it makes up for the part that such a threshold cuts off.
    """
    v = np.abs(finite_profile("speed", speed)[:, 0])
    fast = _fast(v, fraction)
    return _to_foot(v, int(fast[0]), int(fast[-1]) + 1) if len(fast) else slice(0, 0)


def moving_stretches(
    velocity: ArrayLike, rate: float, fraction: float = ONSET, rest: float = REST, shortest: float = SHORTEST
) -> list[slice]:
    """Return the stretches of ``velocity`` (N, d), sampled at ``rate`` [Hz], in which something moves, in order.

    What counts is the speed of the mean velocity over `TREMOR` about each sample, for a hand that is held still
    trembles. Where that reaches ``fraction`` of its peak there is motion; within it a stretch is what `movement_window`
    makes of the speed itself, so that a movement from rest to rest is kept whole and a rest is left out.

    Args:
        velocity: of a whole recording, rests included; or speeds (N,).
        rate: of the samples [Hz].
        fraction: of the greatest speed of all that counts as moving [-].
        rest: shortest time below it that separates two stretches [s]; less is a slow moment of one movement.
        shortest: what is above it for a shorter time is no movement [s].
    """
    require("rate", rate, Positive)
    x = finite_profile("velocity", velocity)
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


def smoothness_measures(motion: Motion) -> Measures:
    """Return smoothness of tool and joints, all at `SMOOTHNESS_RATE`: LDLJ of vectors, SPARC of speeds [-].

    Each is of the whole movement: rests before its beginning and after its end are cut off first, for the tool, its
    turning and the joints separately, see `movement_window`. A rest within it counts: for recordings of
    several movements there is `stretch_smoothness`. NaN where nothing moves.
    """
    row: Measures = {}
    for space, velocity in _velocities(motion).items():
        row.update(_smooth(space, velocity[movement_window(np.linalg.norm(velocity, axis=1))]))
    return row


def stretch_smoothness(motion: Motion, cuts: Sequence[int] = ()) -> Measures:
    """Return the smoothness of the stretches in which something moves, and how many of the tool there are.

    Names and units are those of `smoothness_measures`; each is the mean over the stretches of `moving_stretches`,
    weighted by their durations. Stretches are of the tool for the tool and of its turning for that; for the joints they
    are those in which the tool moves or turns, as joints go on moving about a tool at rest. So neither a rest nor a
    dwell makes a motion look less smooth, and a motion in many pieces is judged by its pieces: therefore the number
    ``stretches`` of the tool's and the time ``moving_s`` [s] in them stand beside it. NaN where nothing moves.

    ``cuts`` are ticks at which a stretch ends and another one begins even in motion, such as those at which robot and
    hand take over from each other: what both do would else be judged by the trembling of one over the time of both.
    The jump at the cut itself is measured by `optsc.metrics.jump_measures`.
    """
    row: Measures = {}
    velocities = _velocities(motion)
    either = np.hstack([velocities["tool"], TURN_RADIUS * velocities["turn"]])
    for space, velocity in velocities.items():
        found = moving_stretches(either if space == "joint" else velocity, SMOOTHNESS_RATE)
        found = _cut(found, [round(tick / motion.rate * SMOOTHNESS_RATE) for tick in cuts])
        durations = np.array([part.stop - part.start for part in found], dtype=float)
        parts = [_smooth(space, velocity[part]) for part in found]
        for name in (f"ldlj_{space}", f"sparc_{space}"):
            row[name] = _weighted([part[name] for part in parts], durations)
        if space == "tool":
            row.update(stretches=float(len(found)), moving_s=float(durations.sum()) / SMOOTHNESS_RATE)
    return row


def _cut(stretches: Sequence[slice], places: Sequence[int]) -> list[slice]:
    """Return the pieces of stretches that are cut at ``places``, without those too short to count as a movement."""
    pieces = []
    for stretch in stretches:
        inside = sorted(place for place in places if stretch.start < place < stretch.stop)
        pieces += [slice(a, b) for a, b in pairwise([stretch.start, *inside, stretch.stop])]
    shortest = round(SHORTEST * SMOOTHNESS_RATE)
    return [piece for piece in pieces if piece.stop - piece.start >= shortest]


def _velocities(motion: Motion) -> dict[str, Array]:
    """Return velocities at `SMOOTHNESS_RATE`: of the tool (M, 3), its turning (M, 3), the joints (M, n)."""
    rate = SMOOTHNESS_RATE
    if len(motion) < 2:
        return {space: np.zeros((0, 1)) for space in ("tool", "turn", "joint")}
    time = np.arange(len(motion)) / motion.rate
    _, p = resample(time, motion.X_WT.translation, rate)
    _, quaternion = resample(time, _continuous(motion.X_WT.quaternion), rate)
    _, q = resample(time, motion.q, rate)
    turn = angular_velocity(quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True), rate)
    return {"tool": np.diff(p, axis=0) * rate, "turn": turn, "joint": np.diff(q, axis=0) * rate}


def _smooth(space: str, velocity: Array) -> Measures:
    rate = SMOOTHNESS_RATE
    return {
        f"ldlj_{space}": log_dimensionless_jerk(velocity, rate),
        f"sparc_{space}": sparc(np.linalg.norm(velocity, axis=1), rate),
    }


def _weighted(values: Sequence[float], weights: Array) -> float:
    there = ~np.isnan(np.asarray(values, dtype=float))
    return float(np.average(np.asarray(values)[there], weights=weights[there])) if there.any() else nan


def _continuous(quaternion: Array) -> Array:
    """Return the same orientations (N, 4) with signs that do not jump from one to the next."""
    flips = np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0
    return quaternion * np.concatenate([[1.0], np.where(np.cumsum(flips) % 2, -1.0, 1.0)])[:, None]
