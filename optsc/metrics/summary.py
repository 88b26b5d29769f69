"""Many measures at once, as flat tables want them: one name with its unit, one number."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import nan
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.metrics.clearance import Nearest, path_clearance
from optsc.metrics.interaction import (
    agreement,
    intervention_ratio,
    operator_effort,
    switch_count,
    time_in_mode,
)
from optsc.metrics.limits import limit_margins
from optsc.metrics.motion import Hand, Motion
from optsc.metrics.paths import path_length, rotation_path, straightness
from optsc.metrics.smoothness import (
    SHORTEST,
    angular_velocity,
    log_dimensionless_jerk,
    movement_window,
    moving_stretches,
    resample,
    sparc,
)
from optsc.metrics.switching import switch_jump

if TYPE_CHECKING:
    from optsc.robot import RobotModel

Measures: TypeAlias = dict[str, float]

SMOOTHNESS_RATE = 100.0
"""Both smoothness measures depend on the sample rate, so everything is brought to this one [Hz]."""
TURN_RADIUS = 0.1
"""Where the tool moves or turns, an angle counts as what it moves so far away [m]; ours, a hand's length."""
HAND_WINDOW = 0.25
"""Time [s] over which the hand's velocity is fitted: tremor and the tracker's noise would else count as motion."""
HAND_DEADBAND = 0.02
"""Speed of the hand [m/s] up to which it counts as at rest; ours, ten times what the fit leaves of the noise."""
TOOL_DEADBAND = 0.005
"""The same for the tool [m/s], which is led by an arm that does not tremble."""


def hand_velocity(hand: Hand) -> Array:
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


def smoothness(motion: Motion) -> Measures:
    """Return smoothness of tool and joints, all at `SMOOTHNESS_RATE`: LDLJ of vectors, SPARC of speeds [-].

    Each is of the whole movement: rests before its beginning and after its end are cut off first, for the tool, its
    turning and the joints separately, see `optsc.metrics.movement_window`. A rest within it counts: for recordings of
    several movements there is `stretch_smoothness`. NaN where nothing moves.
    """
    row: Measures = {}
    for space, velocity in _velocities(motion).items():
        row.update(_smooth(space, velocity[movement_window(np.linalg.norm(velocity, axis=1))]))
    return row


def stretch_smoothness(motion: Motion, cuts: Sequence[int] = ()) -> Measures:
    """Return the smoothness of the stretches in which something moves, and how many of the tool there are.

    Names and units are those of `smoothness`; each is the mean over the stretches that `moving_stretches` finds,
    weighted by their durations. Stretches are of the tool for the tool and of its turning for that; for the joints they
    are those in which the tool moves or turns, as joints go on moving about a tool at rest. So neither a rest nor a
    dwell makes a motion look less smooth, and a motion in many pieces is judged by its pieces: therefore the number
    ``stretches`` of the tool's and the time ``moving_s`` [s] in them stand beside it. NaN where nothing moves.

    ``cuts`` are ticks at which a stretch ends and another one begins even in motion, such as those at which robot and
    hand relieve each other: what both do would else be judged by the trembling of one over the time of both. What
    happens at the cut itself is a matter of `jump_measures`.
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


def motion_measures(motion: Motion, robot: RobotModel, nearest: Nearest | None = None) -> Measures:
    """Return what the arm did in ``motion``: lengths, time, smoothness, margins to limits and obstacles.

    NaN stands for what cannot be said: smoothness without motion, clearance without ``nearest``.
    """
    margins = limit_margins(motion.q, robot.limits.lower, robot.limits.upper)
    speed = np.abs(motion.v) / robot.limits.velocity
    row = {
        "duration_s": len(motion) / motion.rate,
        "path_length_m": path_length(motion.X_WT.translation),
        "rotation_rad": rotation_path(motion.X_WT.quaternion),
        "joint_path_rad": path_length(motion.q),
        "straightness": straightness(motion.X_WT.translation) if len(motion) else nan,
        **smoothness(motion),
        "limit_margin_rad": margins.least,
        "limit_margin_share": margins.least_share,
        "velocity_share": float(speed.max(initial=0.0)),
        "clearance_m": nan,
        "mean_clearance_m": nan,
    }
    if nearest is not None and len(motion):
        found = path_clearance(nearest, motion.q, motion.rate)
        row.update(clearance_m=found.least, mean_clearance_m=found.mean)
    return row


def jump_measures(motion: Motion, index: int, target: Pose | None = None) -> Measures:
    """Return the five parts of the jump at tick ``index``, the first of a new mode; NaN too near an end."""
    names = [
        "jump_position_m",
        "jump_rotation_rad",
        "jump_velocity_m_s",
        "jump_angular_velocity_rad_s",
        "jump_acceleration_m_s2",
        "jump_jerk_m_s3",
        "jump_target_distance_m",
        "jump_target_chord",
        "jump_joint_rad",
        "jump_branch_flip",
    ]
    if not 2 <= index <= len(motion) - 2:
        return dict.fromkeys(names, nan)
    jump = switch_jump(index, motion.rate, motion.X_WT, motion.q, target)
    return dict(zip(names, map(float, jump), strict=True))


def interaction_measures(motion: Motion, R_WS: ArrayLike = (1.0, 0.0, 0.0, 0.0)) -> Measures:
    """Return how operator and robot shared ``motion``; ``R_WS`` turns the hand's station into the world.

    ``effort_m`` is the way of the hand without its trembling, ``intervention`` the share of time in which it moved,
    ``agreement`` the mean cosine between its velocity and the tool's, ``switches`` the changes of mode.
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
        ticks = np.clip(np.rint((motion.hand.stamp - motion.time) * motion.rate), 0, len(tool) - 1).astype(
            int
        )
        both = (speed > HAND_DEADBAND) & (np.linalg.norm(tool[ticks], axis=1) > TOOL_DEADBAND)
        found = agreement(u[both], tool[ticks][both])
        row.update(agreement=found.agreement, disagreement=found.disagreement)
    for mode, seconds in time_in_mode(motion.modes, motion.rate).items():
        row[f"time_{mode}_s"] = seconds
    return row


def summarise(
    motion: Motion,
    robot: RobotModel,
    *,
    R_WS: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    nearest: Nearest | None = None,
    targets: Sequence[Pose | None] | None = None,
) -> Measures:
    """Return all measures of ``motion``, and the worst of each jump over all its changes of mode.

    ``targets`` are what the tool heads for, one for each tick, see `worst_jumps`. Smoothness is that of the movement
    from its beginning to its end, see `smoothness`.
    """
    return {
        **motion_measures(motion, robot, nearest),
        **interaction_measures(motion, R_WS),
        **worst_jumps(motion, targets),
    }


def worst_jumps(motion: Motion, targets: Sequence[Pose | None] | None = None) -> Measures:
    """Return the worst of each part of `jump_measures` over all changes of mode; NaN where there is none.

    ``targets`` (N,) are what the tool heads for at each tick, None where there is nothing: the one of the first tick
    of the new mode counts. Without them the distances to the target are NaN. The worst of the parts need not be of
    the same change. Raises `InvalidValue` unless there is one for each tick.
    """
    if targets is not None and len(targets) != len(motion):
        raise InvalidValue("targets", len(targets), f"{len(motion)}, one for each tick")
    row: Measures = jump_measures(motion, -1)
    changes = [i for i in range(1, len(motion)) if motion.modes[i] != motion.modes[i - 1]]
    jumps = [jump_measures(motion, index, None if targets is None else targets[index]) for index in changes]
    for name in row:
        values = [jump[name] for jump in jumps if jump[name] == jump[name]]
        row[name] = max(values) if values else nan
    return row
