"""Gripper collisions and pad contacts at many poses at once: swept boxes against the points of a surface.

Sweeping a box along an axis of the tool frame gives a box again, so a motion is checked like a configuration. A box
that a solid swallowed whole would hold none of its surface points; one that was swept in from outside cannot be,
because it crosses the surface on its path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.robot.gripper import Gripper
from optsc.sampling.surface import SurfacePoints

DENT = 0.001
"""Depth [m] to which a rubber pad gives way: what lies within it of the outermost point carries load."""
_ALONE = 250_000
"""Multiplications up to which BLAS libraries leave a product to one thread; OpenBLAS: 4 * 65536."""


def in_tool_frame(X_OG: Pose, points: Array) -> np.ndarray:
    """Return points (N, 3) of the object in the tool frames of K poses: (3, K, N) [m], single precision."""
    R = X_OG.rotation_matrix().astype(np.float32)
    offset = np.einsum("kij,ki->jk", R, X_OG.translation.astype(np.float32))
    flat = thin_product(R.transpose(2, 0, 1).reshape(-1, 3), points.astype(np.float32).T)
    points_T = flat.reshape(3, len(X_OG), len(points))
    points_T -= offset[:, :, None]
    return points_T


def thin_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a @ b, (M, k) by (k, N), worked on in pieces that are too small for several threads.

    A product with a k of three is done before other threads have woken up; on a machine that is busy, waiting for
    them costs many times the work.
    """
    result = np.empty((len(a), b.shape[1]), dtype=np.result_type(a, b))
    step = max(1, _ALONE // max(1, b.size))
    for start in range(0, len(a), step):
        np.matmul(a[start : start + step], b, out=result[start : start + step])
    return result


def approach_boxes(gripper: Gripper, standoff: float) -> Array:
    """Return the boxes (B, 2, 3) swept by the open gripper while it comes along z from ``standoff`` [m] away.

    For a jaw-symmetric gripper the boxes of the half-turned gripper belong to them, because whoever
    executes the grasp may turn it.
    """
    boxes = gripper.boxes(gripper.max_opening)
    if gripper.jaw_symmetric:
        turned = boxes * [-1.0, -1.0, 1.0]
        boxes = np.concatenate([boxes, np.stack([turned.min(axis=1), turned.max(axis=1)], axis=1)])
        boxes = np.unique(np.round(boxes, 9), axis=0)
    return boxes - [[0.0, 0.0, standoff], [0.0, 0.0, 0.0]]


def closing_boxes(gripper: Gripper, opening: Array) -> Array:
    """Return the boxes (K, B, 2, 3) swept by the jaws while they close to each ``opening`` (K,) [m]."""
    shut, wide = gripper.boxes(0.0), gripper.boxes(gripper.max_opening)
    moving = np.any(shut != wide, axis=(1, 2))
    shut, wide = shut[moving], wide[moving]
    end = shut + (opening / gripper.max_opening)[:, None, None, None] * (wide - shut)
    return np.stack([np.minimum(end, wide)[:, :, 0], np.maximum(end, wide)[:, :, 1]], axis=2)


def lowest_point(X_OG: Pose, boxes: Array) -> Array:
    """Return the height in the object's frame (K,) [m] of the lowest corner of boxes (B, 2, 3) in T."""
    down = X_OG.rotation_matrix()[:, 2, None, :]
    return X_OG.translation[:, 2] + np.minimum(down * boxes[:, 0], down * boxes[:, 1]).sum(axis=-1).min(axis=1)


def collides(points_T: np.ndarray, boxes: Array, margin: tuple[float, float, float]) -> np.ndarray:
    """Tell for each pose (K,) whether a point lies in a box grown by ``margin`` along x, y, z [m].

    Args:
        points_T: (3, K, N), from `in_tool_frame`.
        boxes: (B, 2, 3), or (K, B, 2, 3) where they differ from pose to pose.
        margin: [m].
    """
    grown = (np.asarray(boxes) + np.array([[-1.0], [1.0]]) * margin).astype(np.float32)
    grown = np.broadcast_to(grown, (points_T.shape[1], *grown.shape[-3:]))
    hit = np.zeros(points_T.shape[1], dtype=bool)
    for box in np.moveaxis(grown, 1, 0):
        left = np.nonzero(~hit)[0]
        inside = np.ones((len(left), points_T.shape[2]), dtype=bool)
        for axis in range(3):
            coordinate = points_T[axis] if len(left) == len(hit) else points_T[axis, left]
            inside &= coordinate > box[left, 0, axis, None]
            inside &= coordinate < box[left, 1, axis, None]
        hit[left] = inside.any(axis=1)
    return hit


class PadContacts(NamedTuple):
    """What the two pads find between them at each of K poses; zeros where there is nothing."""

    width: Array
    """Distance between the outermost points (K,) [m]: where the jaws stop."""
    offset: Array
    """Middle between the outermost points along the closing axis (K,) [m]."""
    coverage: Array
    """Share of the pad's area that carries load, of the pad with less (K,)."""
    eccentricity: Array
    """Distance of the load's middle from the pad's middle, in half pad sizes, of the worse pad (K,)."""
    alignment: Array
    """Cosine between the closing axis and the mean normal under a pad, of the worse pad (K,)."""
    points: Array
    """Middle of the load under each pad in the tool frame (K, 2, 3) [m]: at -y, at +y."""
    inward: Array
    """Mean normal under each pad in the object's frame, into the object (K, 2, 3); unit, or zero."""


def pad_contacts(
    points_T: np.ndarray,
    surface: SurfacePoints,
    X_OG: Pose,
    gripper: Gripper,
    friction: float,
    dent: float = DENT,
) -> PadContacts:
    """Return the contacts when the jaws close at each of K poses.

    Args:
        points_T: the surface's points in the tool frames, (3, K, N), from `in_tool_frame`.
        surface: the points' normals and areas.
        X_OG: (K,) tool poses.
        gripper: its pads are taken as rectangles about the tool's z-x plane.
        friction: Coulomb coefficient; a point whose normal leaves the friction cone carries no load.
        dent: depth [m] within which points carry load.
    """
    count = len(X_OG)
    half = 0.5 * np.array([gripper.pad_size[0], gripper.max_opening, gripper.pad_size[1]], dtype=np.float32)
    between = np.abs(points_T[0]) < half[0]
    between &= np.abs(points_T[2]) < half[2]
    between &= np.abs(points_T[1]) < half[1]
    pose, point = np.nonzero(between)
    x, y, z = points_T[:, pose, point]
    highest, lowest = np.full(count, -half[1]), np.full(count, half[1])
    np.maximum.at(highest, pose, y)
    np.minimum.at(lowest, pose, y)
    closing_axis = X_OG.rotation_matrix()[:, :, 1]
    cosine = np.einsum("pi,pi->p", surface.normals[point], closing_axis[pose])
    area = surface.areas[point] / (gripper.pad_size[0] * gripper.pad_size[1])
    sides, points, inward = [], [], []
    for sign, edge, near in (
        (-1.0, lowest, y < lowest[pose] + dent),
        (1.0, highest, y > highest[pose] - dent),
    ):
        load = np.where(near & (sign * cosine > cone_cosine(friction)), area, 0.0)
        total = np.bincount(pose, load, count)
        x_mean, z_mean = (np.bincount(pose, load * v, count) / np.maximum(total, 1e-12) for v in (x, z))
        normal = np.stack([np.bincount(pose, load * n, count) for n in surface.normals[point].T], axis=-1)
        length = np.maximum(np.linalg.norm(normal, axis=-1), 1e-12)
        aligned = sign * np.einsum("ki,ki->k", normal, closing_axis) / length
        points.append(np.stack([x_mean, edge, z_mean], axis=-1))
        inward.append(-normal / length[:, None])
        sides.append((total, np.maximum(abs(x_mean) / half[0], abs(z_mean) / half[2]), aligned))
    (a, a_off, a_cos), (b, b_off, b_cos) = sides
    return PadContacts(
        width=np.maximum(0.0, highest - lowest),  # below zero where nothing was found
        offset=0.5 * (highest + lowest),
        coverage=np.minimum(1.0, np.minimum(a, b)),
        eccentricity=np.maximum(a_off, b_off),
        alignment=np.minimum(a_cos, b_cos),
        points=np.stack(points, axis=1),
        inward=np.stack(inward, axis=1),
    )


def cone_cosine(friction: float) -> float:
    """Return the cosine of the half angle of the friction cone, 1 / sqrt(1 + friction^2)."""
    return float(1.0 / np.hypot(1.0, friction))
