"""Grasps of objects that are moved: placed again where the objects come to rest, as an observation would do it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from optsc.followers import Follower
from optsc.followers.protocol import FollowerState
from optsc.geometry import Pose, rotation
from optsc.grasps import GraspLibrary
from optsc.records import SceneUpdate
from optsc.sim import Tabletop
from optsc.study.episode_setup import true_scene

MOVED = (5e-3, 0.05)
"""An object that is further than this [m, rad] from where its grasps were placed has moved."""
AT_REST = (1e-3, 0.01)
"""One that is within this of where it was at the last look is at rest."""


class ObservedObjects:
    """An `optsc.session.Watch` that knows where the objects are, for sessions in which one after the other is grasped.

    It looks at the true poses that a follower reports, and places the grasps again once everything that has moved is at
    rest. What the arm carries at that moment is placed where it is carried.
    """

    def __init__(self, world: Tabletop, library: GraspLibrary, follower: Follower) -> None:
        self._world, self._library, self._follower = world, library, follower
        self._placed: Mapping[str, Pose] = world.X_WO
        self._seen: Mapping[str, Pose] = world.X_WO

    def __call__(self, time: float, measured: FollowerState) -> SceneUpdate | None:
        """Return the scene as it is where it has changed and come to rest; None otherwise."""
        now = {name: self._follower.objects()[name] for name in self._world.X_WO}
        seen, self._seen = self._seen, now
        if _apart(now, self._placed, MOVED) and not _apart(now, seen, AT_REST):
            self._placed = now
            return true_scene(replace(self._world, X_WO=now), self._library)
        return None


def _apart(a: Mapping[str, Pose], b: Mapping[str, Pose], most: tuple[float, float]) -> bool:
    """Tell whether one of the objects is further apart than ``most`` [m, rad]."""
    return any(
        np.linalg.norm(X.translation - b[name].translation) > most[0]
        or rotation.angle(X.quaternion, b[name].quaternion) > most[1]
        for name, X in a.items()
    )
