"""Workspace on the table: where an arm grasps comfortably, found from its kinematics alone.

A share of the arm's reach would be simpler, but the region depends on more than the arm's length: the iiwa,
whose elbow bends to 120 degrees only, cannot grasp at half its reach, where the Panda grasps best.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel

HALF_ANGLE = 0.7
"""The region reaches this far to both sides of straight ahead [rad]."""
LARGEST_DEPTH = 0.25
"""Largest difference between the outer and the inner radius [m]."""
NEEDED_SHARE = 0.8
"""Of the probing grasps at a radius, the share that has to be within reach."""

_RADII = np.arange(0.25, 1.01, 0.05)
_TOP_HEIGHTS, _SIDE_HEIGHTS = (0.04, 0.25), (0.04, 0.12)  # from low objects to the standoff above a bottle
_STARTS, _ITERATIONS = 4, 60


class Band(NamedTuple):
    """Distances from the arm's base [m] between which it grasps from the top and from the side."""

    inner: float
    outer: float


def _probes() -> Pose:
    """Return grasps (radii, kinds) ahead: from the top at two yaws, from the side at three azimuths."""
    axes = [([c, s, 0.0], [0.0, 0.0, -1.0], z) for c, s in ((0.0, 1.0), (1.0, 0.0)) for z in _TOP_HEIGHTS]
    for a in np.radians([-40.0, 0.0, 40.0]):
        axes += [([-np.sin(a), np.cos(a), 0.0], [np.cos(a), np.sin(a), 0.0], z) for z in _SIDE_HEIGHTS]
    closing, approach = (np.array(column) for column in list(zip(*axes, strict=True))[:2])
    R = np.stack([np.cross(closing, approach), closing, approach], axis=-1)
    p = np.zeros((len(_RADII), len(R), 3))
    p[..., 0] = _RADII[:, None]
    p[..., 2] = [z for *_, z in axes]
    return Pose(np.broadcast_to(rotation.from_matrix(R), (*p.shape[:2], 4)), p)


def _reached(robot: RobotModel, X_WT: Pose, q: Array) -> Array:
    """Tell for which poses (N,) damped Newton steps from ``q`` (N, n) arrive within 1 mm and 1 mrad."""
    for _ in range(_ITERATIONS):
        now = robot.forward(q)
        turn = rotation.log(rotation.multiply(X_WT.quaternion, rotation.conjugate(now.quaternion)))
        error = np.concatenate([X_WT.translation - now.translation, turn], axis=-1)
        J = np.array([robot.jacobian(row) for row in q])
        JJ = J @ J.swapaxes(-1, -2) + 1e-4 * np.eye(6)
        step = np.einsum("nij,ni->nj", J, np.linalg.solve(JJ, error[..., None])[..., 0])
        arrived = np.abs(error).max(axis=-1) < 1e-3
        if arrived.all():
            break
        q = robot.limits.clip(q + np.where(arrived[:, None], 0.0, np.clip(step, -0.3, 0.3)))
    return arrived


@lru_cache(maxsize=16)
def comfortable_band(robot: RobotModel) -> Band:
    """Return the middle of the band in which ``robot`` reaches grasps from the top and from the side.

    Raises:
        InvalidValue: there is no such band on a table at the height of the arm's base.
    """
    rng = np.random.default_rng(0)
    grasps = _probes()
    found = np.zeros(grasps.shape, dtype=bool)
    for start in range(_STARTS):
        missing = ~found
        q = np.tile(robot.home, (int(missing.sum()), 1))
        if start:
            q = robot.limits.clip(q + rng.normal(0.0, 0.5, q.shape))
        found[missing] = _reached(robot, grasps[missing], q)
    within = np.flatnonzero(found.mean(axis=1) >= NEEDED_SHARE)
    if len(within) == 0:
        raise InvalidValue("robot", robot.name, "an arm that reaches the table around its base from top and side")
    run = max(np.split(within, np.flatnonzero(np.diff(within) > 1) + 1), key=len)
    nearest, farthest = _RADII[run[0]], _RADII[run[-1]]
    middle, depth = 0.5 * (nearest + farthest), min(0.6 * (farthest - nearest), LARGEST_DEPTH)
    return Band(float(middle - 0.5 * depth), float(middle + 0.5 * depth))
