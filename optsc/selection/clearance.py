"""The collision check of the reach table: which grasps can be carried out without touching anything else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optsc.geometry.rotation import Array

if TYPE_CHECKING:
    from optsc.grasps import Candidates
    from optsc.robot.collision import CollisionScene


@dataclass(frozen=True, eq=False)
class GraspClearance:
    """``clear(q_grasp, q_pregrasp, candidates)`` for `optsc.selection.reach.solve_reach`, in one scene.

    At the pre-grasp nothing may touch anything. At the grasp the hand may touch the object it grasps, and
    nothing else; the rest of the arm may not touch even that. The jaws stand fully open in both, as on the
    approach.

    Attributes:
        scene: the arm among the table and the obstacles, which are named like the objects of the candidates.
    """

    scene: CollisionScene

    def __call__(self, q_grasp: Array, q_pregrasp: Array, candidates: Candidates) -> np.ndarray:
        """Return which rows (R,) are clear."""
        clear = self.scene.clear(q_pregrasp).clear.copy()
        rows = np.flatnonzero(clear)
        targets = [candidates.object_names[int(candidates.object_index[r])] for r in rows]
        if len(rows):
            clear[rows] = self.scene.clear(q_grasp[rows], hand_may_touch=targets).clear
        return clear
