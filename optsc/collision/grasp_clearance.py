"""Grasp clearance: which grasps the arm can reach without touching what it should not, in one scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optsc.collision.model import CollisionScene
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates

FEW = 8
"""Rows that are looked at once and not twice: as many configurations as that cost less than another call."""


@dataclass(frozen=True, eq=False)
class GraspClearance:
    """``clear(q_grasp, q_pregrasp, candidates)`` for `optsc.selection.ReachSolver`, in one scene.

    At the pre-grasp nothing may touch anything. At the grasp the hand may touch the object it grasps, and
    nothing else; the rest of the arm may not touch even that. The jaws stand fully open in both, as on the
    approach.

    Attributes:
        scene: the arm among the table and the obstacles, which are named like the objects of the candidates.
    """

    scene: CollisionScene

    def __post_init__(self) -> None:
        # Here, where a scene is made, and not at the first check, which may be in a control tick.
        self.scene.prepare()

    def __call__(self, q_grasp: Array, q_pregrasp: Array, candidates: Candidates) -> np.ndarray:
        """Return which rows (R,) are clear."""
        targets = [candidates.object_names[k] for k in candidates.object_index.tolist()]
        count = len(q_grasp)
        if count <= FEW:
            both = self.scene.clear(
                np.concatenate([q_pregrasp, q_grasp]), hand_may_touch=[None] * count + targets
            ).clear
            return both[:count] & both[count:]
        clear = self.scene.clear(q_pregrasp).clear
        rest = np.flatnonzero(clear)  # a row that touches something already needs no second look
        clear[rest] = self.scene.clear(q_grasp[rest], hand_may_touch=[targets[k] for k in rest]).clear
        return clear

    def certainly_clear(self, q: Array, hand_may_touch: np.ndarray) -> np.ndarray:
        """Return which configurations (R, n) touch nothing for certain (R,), as quick as that can be told.

        ``hand_may_touch`` (R,) names an object for each configuration, "" for none.
        """
        world, own = self.scene.certainly_clear(q, hand_may_touch)
        return world & own

    def clear(self, q: Array, hand_may_touch: np.ndarray) -> np.ndarray:
        """Return which configurations (R, n) touch nothing (R,) but the object each that the hand may touch."""
        return self.scene.clear(q, hand_may_touch=hand_may_touch.tolist()).clear

    def distances(self, q: Array, hand_may_touch: np.ndarray | None = None) -> Array:
        """Return the clearances (R,) of configurations (R, n) [m], at most `optsc.collision.clearance.HORIZON`.

        They are those of capsules and boxes around the bodies, so they are never too large; links that are built
        close together do not count. ``hand_may_touch`` (R,) names an object for each configuration, "" for none.
        """
        found = self.scene.capsules.measure(q, hand_may_touch)
        return np.minimum(found.own, found.world)
