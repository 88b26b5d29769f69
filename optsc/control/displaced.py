"""Has what the robot is on its way to moved in the meantime? Then it must not drive on blindly."""

from __future__ import annotations

import numpy as np

from optsc.control.modes import Mode
from optsc.grasps import Candidates
from optsc.selection import Target

FARTHEST = 0.01
"""A grasp that has moved by more than this is no longer the one that was set out for [m]: half a pad's width."""
ON_THE_WAY = (Mode.APPROACH, Mode.ADJUST, Mode.ADVANCE)
"""Where the jaws have not closed yet. Later the object moves with the hand."""


def displaced(target: Target, before: Candidates | None, now: Candidates) -> str:
    """Return what has become of the object of a grasp, in words; empty where the grasp is where it was.

    Args:
        target: the grasp that the robot goes to, one of ``before``.
        before, now: the grasps of the scene when it was chosen, and after a look.
    """
    name = target.object_name
    if name not in now.object_names:
        return f"the {name} is gone"
    was = None if before is None else _place(target, before)
    place = _place(target, now)
    if was is None or place is None:
        return f"the {name} has other grasps now"
    distance = float(np.linalg.norm(place - was))
    return f"the {name} has moved by {1e3 * distance:.0f} mm" if distance > FARTHEST else ""


def _place(target: Target, candidates: Candidates) -> np.ndarray | None:
    """Return where a grasp is (3,) [m]; None where there is no such one."""
    if target.object_name not in candidates.object_names:
        return None
    index = candidates.object_names.index(target.object_name)
    rows = np.flatnonzero((candidates.object_index == index) & (candidates.grasp_index == target.grasp_index))
    return candidates.X_WG.translation[rows[0]] if len(rows) else None
