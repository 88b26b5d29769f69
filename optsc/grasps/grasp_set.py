"""Grasp set: the grasps of one object for one gripper, in the object's frame."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import ArrayOf, Checked, NonNegative, Share
from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array


@dataclass(frozen=True, eq=False)
class GraspSet(Checked):
    """Grasps of one object in the object's frame O, for one gripper.

    Each is executed alike: open the jaws fully, come along the tool's z axis, close at the pose.

    Attributes:
        object_name: name of the object.
        object_hash: `TriangleMesh.hash` of the surface that the grasps were made on; ``cloud:`` and a hash of
            the points where that was a cloud, ``imported:`` and a hash of the file where it is not known.
        gripper: name of the gripper.
        X_OG: tool poses at the grasps (N,).
        opening: distance between the pads when they hold the object (N,) [m]: the object's width there. The
            jaws are fully open during the approach, `Gripper.max_opening`.
        quality: (N,) in [0, 1], higher is better.
        provenance: how the grasps came about; anything that JSON can hold.
        jaw_symmetric: whether a half turn about the tool's z axis gives the same grasp.
        tried: whether each grasp was tried physically (N,) bool; None where none was.
        held: whether it held when it was tried (N,) bool; None where none was tried.

    Raises:
        InvalidValue: shapes that do not belong together, numbers that are not finite or out of range, a grasp
            that held without having been tried.
    """

    object_name: str
    object_hash: str
    gripper: str
    X_OG: Pose
    opening: Annotated[Array, ArrayOf("N"), NonNegative]
    quality: Annotated[Array, ArrayOf("N"), Share]
    provenance: Mapping[str, object]
    jaw_symmetric: bool = True
    tried: Annotated[np.ndarray | None, ArrayOf("N", dtype=bool)] = None
    held: Annotated[np.ndarray | None, ArrayOf("N", dtype=bool)] = None

    def __post_init__(self) -> None:
        if len(self.X_OG.shape) != 1:
            raise InvalidValue("batch shape of X_OG", self.X_OG.shape, "(N,)")
        if not np.all(np.isfinite(self.X_OG.translation)):
            raise InvalidValue("grasp position", "not finite", "finite [m]")
        rotation.checked(self.X_OG.quaternion, "grasp orientation")
        if np.shape(self.opening) != self.X_OG.shape:
            raise InvalidValue("shape of the grasps' opening", np.shape(self.opening), f"{self.X_OG.shape}")
        super().__post_init__()
        if self.tried is None or self.held is None:
            if self.tried is not self.held:
                raise InvalidValue("tried and held", "one of them alone", "both or neither")
        elif np.any(self.held & ~self.tried):
            raise InvalidValue("held", "true where tried is false", "grasps that were tried")
        # Through JSON once, so that a set is the same before it is stored and after.
        plain = json.loads(json.dumps(dict(self.provenance)))
        object.__setattr__(self, "provenance", MappingProxyType(plain))

    def __len__(self) -> int:
        return len(self.X_OG)

    @property
    def made_on_mesh(self) -> bool:
        """Whether `object_hash` is that of an exact surface, and not of a cloud or an imported file."""
        return ":" not in self.object_hash

    @property
    def reliable(self) -> np.ndarray:
        """Which grasps were tried and held (N,) bool."""
        return np.zeros(len(self), dtype=bool) if self.held is None else self.held

    @property
    def stamp(self) -> float | None:
        """When the view was taken that the grasps were made from [s]; None where no view was."""
        return self._fact("stamp")

    @property
    def visible_fraction(self) -> float | None:
        """Share of the object's surface that the view showed; None where no view was."""
        return self._fact("visible_fraction")

    def age(self, now: float) -> float | None:
        """Return the time since the view that the grasps were made from [s], on the clock of `stamp`."""
        return None if self.stamp is None else now - self.stamp

    def select(self, mask_or_index: ArrayLike) -> GraspSet:
        """Return the grasps of a mask (N,) bool or of indices (M,), in their order."""
        choice = np.asarray(mask_or_index)
        choice = choice.astype(np.intp) if choice.size == 0 and choice.dtype != np.bool_ else choice
        return replace(
            self,
            X_OG=self.X_OG[choice],
            opening=self.opening[choice],
            quality=self.quality[choice],
            tried=None if self.tried is None else self.tried[choice],
            held=None if self.held is None else self.held[choice],
        )

    def moved(self, X_NO: Pose) -> GraspSet:
        """Return the same grasps in another frame N of the object, given the old frame's pose in it.

        Raises:
            InvalidValue: a batch of poses.
        """
        if X_NO.shape != ():
            raise InvalidValue("X_NO", X_NO.shape, "a single pose")
        return replace(self, X_OG=X_NO @ self.X_OG)

    def _fact(self, name: str) -> float | None:
        value = self.provenance.get(name)
        known = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        return float(value) if known else None  # type: ignore[arg-type]
