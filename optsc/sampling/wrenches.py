"""What a grasp can resist: the largest ball of wrenches inside what two soft fingers can apply.

C. Ferrari, J. Canny, "Planning optimal grasps", 1992, with the sum of the normal forces bounded by one. A
soft finger also resists turning about its normal (J. K. Salisbury, J. Craig, 1982); two points alone leave
the turn about the line between them free, and the ball would have no radius.
"""

from __future__ import annotations

import numpy as np

from optsc.geometry.rotation import Array

EDGES = 6
"""Edges of the pyramid that stands for a friction cone."""


def contact_wrenches(points: Array, inward: Array, friction: float, torsion: float, length: float) -> Array:
    """Return the extreme wrenches (..., EDGES + 2, 6) of soft fingers that press with a normal force of one.

    Forces come first; torques are about the origin, divided by ``length``.

    Args:
        points: places of the contacts (..., 3) [m], seen from the centre of mass.
        inward: unit normals (..., 3) into the object.
        friction: Coulomb coefficient [-].
        torsion: radius [m]; a finger resists a torque of friction x torsion x normal force about its normal.
        length: [m].
    """
    helper = np.eye(3)[np.argmin(np.abs(inward), axis=-1)]
    u = np.cross(inward, helper)
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    v = np.cross(inward, u)
    turn = 2.0 * np.pi * np.arange(EDGES) / EDGES
    side = np.cos(turn)[:, None] * u[..., None, :] + np.sin(turn)[:, None] * v[..., None, :]
    forces = inward[..., None, :] + friction * side
    torques = np.cross(points[..., None, :], forces) / length
    straight = np.broadcast_to(inward[..., None, :], (*inward.shape[:-1], 2, 3))
    spin = friction * torsion / length * np.array([[1.0], [-1.0]]) * inward[..., None, :]
    turning = np.cross(points[..., None, :], straight) / length + spin
    return np.concatenate(
        [np.concatenate([forces, torques], axis=-1), np.concatenate([straight, turning], axis=-1)], axis=-2
    )


def largest_ball(wrenches: Array) -> float:
    """Return the radius of the largest ball about the origin inside the hull of ``wrenches`` (M, 6).

    It is 0 where the origin is not inside, or the wrenches span no volume.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(wrenches)
    except QhullError:
        return 0.0
    return float(max(0.0, -hull.equations[:, -1].max()))


def resistance(points: Array, inward: Array, friction: float, torsion: float, length: float) -> Array:
    """Return `largest_ball` (K,) of grasps with contacts ``points`` and ``inward`` normals (K, 2, 3)."""
    wrenches = contact_wrenches(points, inward, friction, torsion, length)
    return np.array([largest_ball(w.reshape(-1, 6)) for w in wrenches])


def best_resistance(width: float, friction: float, torsion: float, length: float) -> float:
    """Return the `resistance` of fingers ``width`` [m] apart, straight on either side of the centre of mass."""
    y = np.array([[[0.0, -0.5, 0.0], [0.0, 0.5, 0.0]]])
    return float(resistance(width * y, -2.0 * y, friction, torsion, length)[0])
