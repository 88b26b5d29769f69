"""Whether the object of a chosen grasp is still where it was, seen from the grasps of the scene as it is now.

The pose of a known object tells how it has moved, and so do the same grasps in the same order. Grasps that were sampled
again have other indices and other poses: then what counts is whether one of them is where the chosen one is, or whether
they are in the middle where the others were.
"""

from __future__ import annotations

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.grasps import Candidates
from optsc.selection import Target

FARTHEST = 0.01
"""A grasp that has moved by more than this [m] is no longer the one that was chosen: half a pad's width."""
FARTHEST_TURN = 0.35
"""The same for its orientation [rad], where grasps were sampled again."""
_SAME = 1e-3
"""Grasps of a set that was moved as a whole agree with each other within this [m]."""
_HALF_TURN = np.array([0.0, 0.0, 0.0, 1.0])


def displaced(target: Target, before: Candidates | None, now: Candidates) -> str:
    """Return what has become of the object of a grasp, in words; empty where it can be grasped as was chosen.

    Args:
        target: the grasp that the robot goes to, one of ``before``.
        before, now: the grasps of the scene when it was chosen, and as it is now.
    """
    name = target.object_name
    if name not in now.object_names:
        return f"the {name} is gone"
    rows = _rows(name, now)
    if len(rows) == 0:
        return f"the {name} has no grasps any more"
    moved = None if before is None else _moved_as_a_whole(target, before, now, rows)
    if moved is not None:
        return f"the {name} has moved by {1e3 * moved:.0f} mm" if moved > FARTHEST else ""
    X_WG = now.X_WG[rows]
    distance = np.linalg.norm(X_WG.translation - target.X_WG.translation, axis=1)
    angle = rotation.angle(X_WG.quaternion, target.X_WG.quaternion)
    if now.jaw_symmetric:
        turned = rotation.multiply(target.X_WG.quaternion, _HALF_TURN)
        angle = np.minimum(angle, rotation.angle(X_WG.quaternion, turned))
    k = int(np.argmin(np.maximum(distance / FARTHEST, angle / FARTHEST_TURN)))
    if distance[k] <= FARTHEST and angle[k] <= FARTHEST_TURN:
        return ""
    if before is not None:
        old = before.X_WG[_rows(name, before)].translation
        if len(old) and np.linalg.norm(X_WG.translation.mean(axis=0) - old.mean(axis=0)) <= FARTHEST:
            return ""
    away = f"{1e3 * distance[k]:.0f} mm and {np.degrees(angle[k]):.0f}° away"
    return f"the {name} has moved, or has other grasps now: the nearest is {away}"


def _rows(name: str, candidates: Candidates) -> np.ndarray:
    if name not in candidates.object_names:
        return np.zeros(0, dtype=np.intp)
    return np.flatnonzero(candidates.object_index == candidates.object_names.index(name))


def _moved_as_a_whole(target: Target, before: Candidates, now: Candidates, rows: np.ndarray) -> float | None:
    """Return how far the chosen grasp has moved [m] with its object; None where that cannot be told."""
    if target.object_name in before.X_WO and target.object_name in now.X_WO:
        X_then, X_now = before.X_WO[target.object_name], now.X_WO[target.object_name]
        p = target.X_WG.translation
        return float(np.linalg.norm((X_now @ X_then.inverse()).apply(p) - p))
    old = _rows(target.object_name, before)
    if len(old) != len(rows) or not np.array_equal(before.grasp_index[old], now.grasp_index[rows]):
        return None
    chosen = np.flatnonzero(before.grasp_index[old] == target.grasp_index)
    if len(chosen) == 0:
        return None
    X_old, X_new = before.X_WG[old], now.X_WG[rows]
    k = int(chosen[0])
    D: Pose = X_new[k] @ X_old[k].inverse()
    off = np.linalg.norm(D.apply(X_old.translation) - X_new.translation, axis=1)
    if np.any(off > _SAME):
        return None
    return float(np.linalg.norm(X_new.translation[k] - X_old.translation[k]))
