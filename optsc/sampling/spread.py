"""Choosing a few poses out of many so that they are far apart and good."""

from __future__ import annotations

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array

LENGTH = 0.15
"""Distance [m] that counts as much as one radian in `pose_distance`."""


def pose_distance(a: Pose, b: Pose, jaw_symmetric: bool) -> Array:
    """Return sqrt((translation / 0.15 m)^2 + angle^2) [rad]; batch shapes broadcast.

    With ``jaw_symmetric`` the angle is the smaller one of ``b`` and ``b`` after a half turn about its z axis.
    """
    angle = rotation.angle(a.quaternion, b.quaternion)
    if jaw_symmetric:
        half_turn = np.array([0.0, 0.0, 0.0, 1.0])
        angle = np.minimum(angle, rotation.angle(a.quaternion, rotation.multiply(b.quaternion, half_turn)))
    return np.hypot(np.linalg.norm(a.translation - b.translation, axis=-1) / LENGTH, angle)


def spread_out(poses: Pose, quality: Array, count: int, jaw_symmetric: bool) -> np.ndarray:
    """Return the indices of ``count`` poses (fewer if there are fewer), best first among equals.

    Farthest-point selection: start with the best pose, then take again and again the one with the greatest
    product of quality and distance to the nearest pose taken. Distance alone would pick the odd ones out.
    """
    chosen = [int(np.argmax(quality))] if len(quality) else []
    distance = np.full(len(quality), np.inf)
    for _ in range(min(count, len(quality)) - 1):
        distance = np.minimum(distance, pose_distance(poses, poses[chosen[-1]], jaw_symmetric))
        chosen.append(int(np.argmax(distance * quality)))
    return np.array(chosen, dtype=np.int64)
