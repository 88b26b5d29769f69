"""Grasp candidates: every grasp of every object, placed in the world, for a selection to choose from."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from optsc.checks import ArrayOf, Checked
from optsc.errors import InvalidValue, Mismatch, UnknownName
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps.grasp_set import GraspSet


@dataclass(frozen=True, eq=False)
class Candidates(Checked):
    """N grasps in the world frame W, object by object.

    Attributes:
        object_names: names of the objects.
        object_index: index into `object_names` (N,).
        grasp_index: index into that object's `GraspSet` (N,).
        X_WG: tool poses (N,).
        opening: distance between the pads when they hold the object (N,) [m].
        quality: (N,) in [0, 1], higher is better.
        jaw_symmetric: whether a half turn about the tool's z axis gives the same grasp.
        X_WO: poses of the objects by name, as far as their grasps are in the frame of a known shape, which another set
            of grasps of the same object shares; {} where that is not known.
    """

    object_names: tuple[str, ...]
    object_index: Annotated[np.ndarray, ArrayOf("N", dtype=np.int64)]
    grasp_index: Annotated[np.ndarray, ArrayOf("N", dtype=np.int64)]
    X_WG: Pose
    opening: Annotated[Array, ArrayOf("N")]
    quality: Annotated[Array, ArrayOf("N")]
    jaw_symmetric: bool
    X_WO: Mapping[str, Pose] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if np.shape(self.opening) != self.X_WG.shape:
            raise InvalidValue("shape of the candidates' opening", np.shape(self.opening), f"{self.X_WG.shape}")
        super().__post_init__()

    def __len__(self) -> int:
        return len(self.X_WG)

    def select(self, rows: np.ndarray, X_WG: Pose | None = None) -> Candidates:
        """Return these rows (R,), in this order, at other poses (R,) where some are given; a row may come twice."""
        # Parts of what was checked need no check, which would take longer than all the rest.
        some = copy.copy(self)
        values = {
            "object_index": self.object_index[rows],
            "grasp_index": self.grasp_index[rows],
            "X_WG": self.X_WG[rows] if X_WG is None else X_WG,
            "opening": self.opening[rows],
            "quality": self.quality[rows],
        }
        for value in values.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
        some.__dict__.update(values)
        return some


def place(sets: Mapping[str, GraspSet], X_WO: Mapping[str, Pose]) -> Candidates:
    """Return the grasps of the objects in ``X_WO``, in its order, each object's at its single pose.

    Raises `UnknownName` for an object without grasps, `InvalidValue` for a batch of poses and `Mismatch`
    where the sets were made for different grippers.
    """
    for name, pose in X_WO.items():
        if name not in sets:
            raise UnknownName("object with stored grasps", name, sets)
        if pose.shape != ():
            raise InvalidValue(f"batch shape of the pose of {name}", pose.shape, "(), a single pose")
    chosen = [sets[name] for name in X_WO]
    for other in chosen[1:]:
        if other.gripper != chosen[0].gripper:
            raise Mismatch(f"grasp set of {other.object_name}", other.gripper, chosen[0].gripper)
    counts = [len(s) for s in chosen]
    placed = [X_WO[s] @ g.X_OG for s, g in zip(X_WO, chosen, strict=True)]
    return Candidates(
        object_names=tuple(X_WO),
        object_index=np.repeat(np.arange(len(chosen)), counts),
        grasp_index=np.concatenate([np.zeros(0, dtype=np.int64), *map(np.arange, counts)]),
        X_WG=Pose.concatenate([Pose.identity((0,)), *placed]),
        opening=np.concatenate([np.zeros(0), *(s.opening for s in chosen)]),
        quality=np.concatenate([np.zeros(0), *(s.quality for s in chosen)]),
        jaw_symmetric=all(s.jaw_symmetric for s in chosen),
        X_WO={name: X for name, X in X_WO.items() if sets[name].made_on_mesh},
    )
