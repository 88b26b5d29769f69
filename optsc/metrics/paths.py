"""How far something went, and how directly."""

from __future__ import annotations

from math import nan

import numpy as np
from numpy.typing import ArrayLike

from optsc.geometry import rotation
from optsc.metrics.checks import finite


def path_length(points: ArrayLike) -> float:
    """Return the length of the way through ``points`` (N, d), in their unit; 0 for fewer than two.

    With joint positions (N, n) it is the length of the way in joint space [rad]. Noise adds to it with every
    sample, so compare paths sampled at one rate only.
    """
    p = finite("points", points)
    return float(np.sum(np.linalg.norm(np.diff(p, axis=0), axis=1)))


def rotation_path(quaternions: ArrayLike) -> float:
    """Return the angle turned through in all [rad] along orientations (N, 4); 0 for fewer than two."""
    q = rotation.checked(finite("quaternions", quaternions, 4), "quaternions")
    return float(np.sum(rotation.angle(q[:-1], q[1:])))


def straightness(points: ArrayLike) -> float:
    """Return the distance from start to end over the path length of ``points`` (N, d) [-].

    1 on a straight line, 0 on a round trip; NaN when nothing moved: then there is no path to be straight.
    """
    p = finite("points", points)
    length = path_length(p)
    return float(np.linalg.norm(p[-1] - p[0])) / length if length > 0.0 else nan
