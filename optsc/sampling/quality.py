"""Grasp quality: the wrenches that a grasp resists, how it lies in the pads and what errors of the pose it bears.

Resistance is the radius of the largest ball of wrenches inside what two soft fingers can apply: C. Ferrari, J. Canny,
"Planning optimal grasps", 1992, with the sum of the normal forces bounded by one. A soft finger also resists turning
about its normal (J. K. Salisbury, J. Craig, 1982); two points alone leave the turn about the line between them free,
and the ball would have no radius.
"""

from __future__ import annotations

import numpy as np

from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.sampling.checks import FeasibleGrasps, Workpiece, dent, lever
from optsc.sampling.contacts import approach_boxes, collides, cone_cosine, in_tool_frame, pad_contacts
from optsc.sampling.settings import AntipodalSettings

EDGES = 6
"""Edges of the pyramid that stands for a friction cone."""
_ROOM = 0.015  # [m] on either side of the object that earns full marks
_COVERED = 0.5  # share of a pad that earns full marks
_SPARSE = 4  # perturbed poses are checked with every fourth point
_CHUNK = 150_000  # points in tool frames worked on at once


def grasp_quality(resisted: Array, robust: Array, hold: Array) -> Array:
    """Return (e r h^3)^(1/5), in [0, 1]: the mean of five factors, three of them in `hold_quality`.

    Args:
        resisted: e, the grasp's `resistance` over the best one, clipped to [0, 1] (...).
        robust: r, `robustness` (...).
        hold: h, `hold_quality` (...).
    """
    return (np.clip(resisted, 0.0, 1.0) * robust * hold**3) ** 0.2


def hold_quality(coverage: Array, lever: Array, spare: Array, settings: AntipodalSettings) -> Array:
    """Return (b c d)^(1/3), in [0, 1], higher is better; each factor is clipped to [0, 1].

    b: share of a pad's area that carries load, coverage / 0.5.
    c: what gravity leaves of the hold, 1 - lever / (2 max_lever).
    d: room between an open jaw and the object, (spare / 2) / 15 mm.

    Args:
        coverage: share of the pad that carries load (...).
        lever: of gravity about the closing axis (...) [m].
        spare: opening of the open jaws less the object's width (...) [m].
        settings: the lever that is still allowed.
    """
    factors = [coverage / _COVERED, 1.0 - lever / (2.0 * settings.max_lever), 0.5 * spare / _ROOM]
    return np.prod(np.clip(factors, 0.0, 1.0), axis=0) ** (1.0 / 3.0)


def hold_of(work: Workpiece, grasps: FeasibleGrasps) -> Array:
    """Return `hold_quality` (K,) of feasible grasps."""
    spare = work.gripper.max_opening - grasps.contacts.width
    return hold_quality(grasps.contacts.coverage, lever(grasps.X_OG, work.centre_of_mass), spare, work.settings)


def resisted_share(work: Workpiece, grasps: FeasibleGrasps) -> Array:
    """Return the `resistance` (K,) of feasible grasps, as a share of what straight fingers at the middle resist."""
    settings = work.settings
    length = 0.5 * float(np.linalg.norm(np.ptp(work.surface.points, axis=0)))
    points_O = grasps.X_OG[:, None].apply(grasps.contacts.points) - work.centre_of_mass
    found = resistance(points_O, grasps.contacts.inward, settings.friction, settings.torsion, length)
    width = min(work.gripper.max_opening, 2.0 * length)
    return found / best_resistance(width, settings.friction, settings.torsion, length)


def robustness(work: Workpiece, X_OG: Pose, rng: np.random.Generator) -> Array:
    """Return the share (K,) of poses with small errors that would still come in freely and hold.

    Each error is a normal rotation vector and translation in the tool frame. Held means: nothing is touched on
    the approach, the object fits, both mean normals lie in the friction cone, and half of the coverage that is
    asked of the grasp itself is there.
    """
    settings, count = work.settings, work.settings.perturbations
    turn = settings.angle_error * rng.normal(size=(len(X_OG), count, 3))
    shift = settings.position_error * rng.normal(size=(len(X_OG), count, 3))
    batch = X_OG[:, None] @ Pose.from_rotation_vector(turn, shift)
    poses = Pose(batch.quaternion.reshape(-1, 4), batch.translation.reshape(-1, 3))
    step = max(1, _CHUNK * _SPARSE // len(work.surface.points))
    held = [_still_holds(work, poses[i : i + step]) for i in range(0, len(poses), step)]
    return np.concatenate([np.zeros(0), *held]).reshape(len(X_OG), count).mean(axis=1)


def _still_holds(work: Workpiece, X_OG: Pose) -> np.ndarray:
    settings, gripper, surface = work.settings, work.gripper, work.surface.every(_SPARSE)
    points_T = in_tool_frame(X_OG, surface.points)
    pads = pad_contacts(points_T, surface, X_OG, gripper, settings.friction, dent(settings))
    holds = (pads.width > 0.0) & (pads.width <= gripper.max_opening)
    holds &= pads.alignment >= cone_cosine(settings.friction)
    holds &= pads.coverage >= 0.5 * settings.min_coverage
    return holds & ~collides(points_T, approach_boxes(gripper, settings.standoff), (0.0, 0.0, 0.0))


def resistance(points: Array, inward: Array, friction: float, torsion: float, length: float) -> Array:
    """Return `largest_ball` (K,) of grasps with contacts ``points`` and ``inward`` normals (K, 2, 3)."""
    wrenches = contact_wrenches(points, inward, friction, torsion, length)
    return np.array([largest_ball(w.reshape(-1, 6)) for w in wrenches])


def best_resistance(width: float, friction: float, torsion: float, length: float) -> float:
    """Return the `resistance` of fingers ``width`` [m] apart, straight on either side of the centre of mass."""
    y = np.array([[[0.0, -0.5, 0.0], [0.0, 0.5, 0.0]]])
    return float(resistance(width * y, -2.0 * y, friction, torsion, length)[0])


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
