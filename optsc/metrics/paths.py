"""Path length, straightness and clearance of a motion, and all measures of what the arm did."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import Positive, require
from optsc.errors import InvalidValue
from optsc.geometry import rotation
from optsc.geometry.rotation import Array
from optsc.metrics.limits import limit_margins
from optsc.metrics.motion import Measures, Motion, finite_rows
from optsc.metrics.movements import smoothness_measures

if TYPE_CHECKING:
    from optsc.robot import RobotModel

NearestDistance: TypeAlias = Callable[[Array], Array]
"""Returns of configurations (N, n) [rad] the distance of each to the nearest thing (N,) [m], such as a method of
`optsc.collision.clearance.ClearanceScene` or a user-defined distance model; negative where bodies overlap."""

LIFT_HEIGHT = 0.10
"""An object counts as lifted when it was at least this much above its place [m] ..."""
LIFT_TIME = 1.0
"""... for at least this long [s]."""


def path_length(points: ArrayLike) -> float:
    """Return the length of the path through ``points`` (N, d), in their unit; 0 for fewer than two.

    With joint positions (N, n) it is the length of the path in joint space [rad]. Noise adds to it with every
    sample, so compare paths sampled at one rate only.
    """
    p = finite_rows("points", points)
    return float(np.sum(np.linalg.norm(np.diff(p, axis=0), axis=1)))


def rotation_path(quaternions: ArrayLike) -> float:
    """Return the angle turned through in all [rad] along orientations (N, 4); 0 for fewer than two."""
    q = rotation.checked(finite_rows("quaternions", quaternions, 4), "quaternions")
    return float(np.sum(rotation.angle(q[:-1], q[1:])))


def straightness(points: ArrayLike) -> float:
    """Return the distance from start to end over the path length of ``points`` (N, d) [-].

    1 on a straight line, 0 on a round trip; NaN when nothing moved: then there is no path to be straight.
    """
    p = finite_rows("points", points)
    length = path_length(p)
    return float(np.linalg.norm(p[-1] - p[0])) / length if length > 0.0 else nan


class PathClearance(NamedTuple):
    """The narrowest place of a motion.

    Attributes:
        least: least distance at any sample [m]; infinite without samples.
        time: when that was, since the first sample [s]; 0 without samples.
        mean: mean over the samples [m]: how much room there was on the whole.
    """

    least: float
    time: float
    mean: float


def path_clearance(nearest: NearestDistance, q: ArrayLike, rate: float, every: float = 0.02) -> PathClearance:
    """Return how near the arm came to anything along joint positions ``q`` (N, n) [rad] at ``rate`` [Hz].

    Checked are samples ``every`` so many seconds, and the last. At the paper's speed the tool goes 2 mm between two
    of them, which bounds what can be missed. Raises `InvalidValue`.
    """
    configurations = finite_rows("q", q)
    require("every", every, Positive)
    require("rate", rate, Positive)
    stride = max(1, round(every * rate))
    picked = np.array(sorted({*range(0, len(configurations), stride), *range(len(configurations))[-1:]}), dtype=int)
    if not len(picked):
        return PathClearance(inf, 0.0, inf)
    distance = np.asarray(nearest(configurations[picked]), dtype=float)
    if distance.shape != picked.shape:
        raise InvalidValue("shape of the distances", distance.shape, f"{picked.shape}, one for each configuration")
    lowest = int(np.argmin(distance))
    return PathClearance(float(distance[lowest]), float(picked[lowest]) / rate, float(np.mean(distance)))


def motion_measures(motion: Motion, robot: RobotModel, nearest: NearestDistance | None = None) -> Measures:
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
        **smoothness_measures(motion),
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


def is_lifted(heights: ArrayLike, rate: float) -> bool:
    """Tell whether an object with these ``heights`` (N,) [m] at ``rate`` [Hz] was lifted high and long enough."""
    z = np.asarray(heights, dtype=float)
    up = np.concatenate([[0], (z - z[:1] >= LIFT_HEIGHT).astype(int), [0]])
    edges = np.flatnonzero(np.diff(up))
    return bool((edges[1::2] - edges[::2]).max(initial=0) / rate >= LIFT_TIME)
