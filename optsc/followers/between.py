"""What stands between the pads of an ideal arm: for simulations without contact."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.grasps import Candidates

NEAR = (0.04, 0.6)
"""A tool that is no further than this [m, rad] from a grasp has its object between the pads."""


class Between(NamedTuple):
    """Something between the pads.

    Attributes:
        object_name: which object.
        width: opening at which the pads touch it [m].
    """

    object_name: str
    width: float


class BetweenPads(Protocol):
    """Tells what is between the pads."""

    def __call__(self, X_WT: Pose, moved: Mapping[str, Pose]) -> Between | None:
        """Return what is between the pads of a tool at ``X_WT``; None for nothing.

        ``moved`` says where the arm has taken objects: a displacement D in W of every object that it has, so that what
        was at X_W when the objects stood where they began is at D X_W now.
        """
        ...


class GraspedObjects:
    """`BetweenPads` of objects that are only known by their grasps: near a grasp, its object is between the pads.

    Args:
        candidates: the grasps while the objects stand where they begin.
        near: how far the tool may be from a grasp [m, rad].

    Raises:
        InvalidValue: an opening of a grasp that is no width.
    """

    def __init__(self, candidates: Candidates, near: tuple[float, float] = NEAR) -> None:
        opening = candidates.opening
        if not np.all(np.isfinite(opening) & (opening > 0.0)):
            raise InvalidValue("opening of the grasps", opening[~(opening > 0.0)].tolist(), "a width above 0 m")
        self._candidates, self._near = candidates, near
        self._names = [candidates.object_names[k] for k in candidates.object_index.tolist()]
        self._half_turn = np.array([0.0, 0.0, 0.0, 1.0])

    def __call__(self, X_WT: Pose, moved: Mapping[str, Pose]) -> Between | None:
        """Return the object of the nearest grasp; see `BetweenPads`."""
        c = self._candidates
        if len(c) == 0:
            return None
        places = {name: moved[name].inverse() @ X_WT for name in moved}
        best: tuple[float, int] | None = None
        for index, name in enumerate(c.object_names):
            rows = np.flatnonzero(c.object_index == index)
            if len(rows) == 0:
                continue
            tool, X_WG = places.get(name, X_WT), c.X_WG[rows]
            distance = np.linalg.norm(X_WG.translation - tool.translation, axis=1)
            angle = rotation.angle(X_WG.quaternion, tool.quaternion)
            if c.jaw_symmetric:
                turned = rotation.multiply(tool.quaternion, self._half_turn)
                angle = np.minimum(angle, rotation.angle(X_WG.quaternion, turned))
            far = distance / self._near[0] + angle / self._near[1]
            far[(distance > self._near[0]) | (angle > self._near[1])] = np.inf
            k = int(np.argmin(far))
            if np.isfinite(far[k]) and (best is None or far[k] < best[0]):
                best = float(far[k]), int(rows[k])
        return None if best is None else Between(self._names[best[1]], float(c.opening[best[1]]))
