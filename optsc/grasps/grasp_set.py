"""The grasps of one object for one gripper."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array


@dataclass(frozen=True, eq=False)
class GraspSet:
    """Grasps of one object in the object's frame O, for one gripper.

    Each is carried out in the same way: open the jaws fully, come along the tool's z axis, close at the pose.

    Attributes:
        object_name: name of the object.
        object_hash: `TriangleMesh.hash` of the surface that the grasps were made on.
        gripper: name of the gripper.
        X_OG: tool poses at the grasps (N,).
        opening: distance between the pads when they hold the object (N,) [m]: the object's width there. The
            jaws are fully open during the approach, `Gripper.max_opening`.
        quality: (N,) in [0, 1], higher is better.
        provenance: how the grasps came about; anything that JSON can hold.
        jaw_symmetric: whether a half turn about the tool's z axis gives the same grasp.
    """

    object_name: str
    object_hash: str
    gripper: str
    X_OG: Pose
    opening: Array
    quality: Array
    provenance: Mapping[str, object]
    jaw_symmetric: bool = True

    def __post_init__(self) -> None:
        if len(self.X_OG.shape) != 1:
            raise InvalidValue("batch shape of X_OG", self.X_OG.shape, "(N,)")
        if not np.all(np.isfinite(self.X_OG.translation)):
            raise InvalidValue("grasp position", "not finite", "finite [m]")
        rotation.checked(self.X_OG.quaternion, "grasp orientation")
        for field, top in (("opening", np.inf), ("quality", 1.0)):
            value = np.array(getattr(self, field), dtype=float)
            if value.shape != self.X_OG.shape:
                raise InvalidValue(f"shape of the grasps' {field}", value.shape, f"{self.X_OG.shape}")
            if not np.all(np.isfinite(value) & (value >= 0.0) & (value <= top)):
                raise InvalidValue(f"grasp {field}", value.tolist(), f"finite, 0 to {top}")
            value.flags.writeable = False
            object.__setattr__(self, field, value)
        # Through JSON once, so that a set is the same before it is stored and after.
        plain = json.loads(json.dumps(dict(self.provenance)))
        object.__setattr__(self, "provenance", MappingProxyType(plain))

    def __len__(self) -> int:
        return len(self.X_OG)
