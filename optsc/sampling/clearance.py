"""Does the gripper touch anything on its way? Boxes in the tool frame against points, many poses at once.

Sweeping a box along an axis of the tool frame gives a box again, so a motion is checked like a posture.
A box that a solid swallowed whole would hold none of its surface points; one that was swept in from
outside cannot be, because it crosses the surface on its way.
"""

from __future__ import annotations

import numpy as np

from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.robot.gripper import Gripper
from optsc.sampling.products import thin_product


def in_tool_frame(X_OG: Pose, points: Array) -> np.ndarray:
    """Return points (N, 3) of the object in the tool frames of K poses: (3, K, N) [m], single precision."""
    R = X_OG.rotation_matrix().astype(np.float32)
    offset = np.einsum("kij,ki->jk", R, X_OG.translation.astype(np.float32))
    flat = thin_product(R.transpose(2, 0, 1).reshape(-1, 3), points.astype(np.float32).T)
    points_T = flat.reshape(3, len(X_OG), len(points))
    points_T -= offset[:, :, None]
    return points_T


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


def touched(points_T: np.ndarray, boxes: Array, margin: tuple[float, float, float]) -> np.ndarray:
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


def lowest_point(X_OG: Pose, boxes: Array) -> Array:
    """Return the height in the object's frame (K,) [m] of the lowest corner of boxes (B, 2, 3) in T."""
    down = X_OG.rotation_matrix()[:, 2, None, :]
    return X_OG.translation[:, 2] + np.minimum(down * boxes[:, 0], down * boxes[:, 1]).sum(axis=-1).min(
        axis=1
    )
