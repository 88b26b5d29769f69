"""What is known of a scene between two looks: objects, where they are, and their stored grasps. Values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from optsc.geometry import DepthImage, PointCloud, Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates, GraspLibrary


class SceneEventKind(Enum):
    """What a look can bring about an object."""

    STORED = "seen for the first time, and grasps of it stored"
    MOVED = "moved, and its grasps with it"
    TOPPLED = "stands or lies differently, and its grasps were made anew"
    TAKEN = "in the hand, and neither an obstacle nor to be grasped"
    RETIRED = "gone, and its grasps with it"
    REFUSED = "seen, but without grasps"


class SceneEvent(NamedTuple):
    """What happened to one object at one look; ``words`` say why or by how much."""

    kind: SceneEventKind
    name: str
    words: str


class Explanation(NamedTuple):
    """A template at a pose that the view of an object fits."""

    template: str
    X_WO: Pose


class Grip(NamedTuple):
    """An object that was between the jaws: its pose in the tool's frame then, and the share of its points there."""

    X_TO: Pose
    share: float


@dataclass(frozen=True, eq=False)
class KnownObject:
    """An object as it was seen when it was learnt.

    Attributes:
        name: what it is called.
        template: name of the template that it is taken for; None for an unknown shape.
        X_WO: its pose.
        explanations: everything that its view fits, the one that is taken first; empty for an unknown shape.
        cloud: its points in O, the seen ones marked.
        doubtful: places in O where there may be something of it or not (M, 3) [m].
        image: where it was seen.
        pixels: (H, W) bool, its silhouette there.
        parts: convex pieces of it in O, for collision checks.
        stamp: when it was last seen unhidden [s].
    """

    name: str
    template: str | None
    X_WO: Pose
    explanations: tuple[Explanation, ...]
    cloud: PointCloud
    doubtful: Array
    image: DepthImage
    pixels: np.ndarray
    parts: tuple[TriangleMesh, ...]
    stamp: float

    @property
    def seen(self) -> Array:
        """What was seen of it (N, 3) in W [m]."""
        return self.X_WO.apply(self.cloud.points[self.cloud.seen_mask])

    @property
    def certain(self) -> bool:
        """Whether its view had a single explanation."""
        return len(self.explanations) == 1

    def at(self, X_WO: Pose) -> KnownObject:
        """Return the object in another place."""
        X_WW = X_WO @ self.X_WO.inverse()
        moved = tuple(Explanation(name, X_WW @ X) for name, X in self.explanations)
        return replace(self, X_WO=X_WO, explanations=moved)


@dataclass(frozen=True, eq=False)
class SceneState:
    """All known objects and the library of their grasps.

    Attributes:
        objects: by name.
        library: grasps of those that have any, in O. A set is replaced only by a look that nothing hides.
        grips: objects that were between the jaws when they were last where they were known to be.
        held: names of objects that the hand carries.
    """

    objects: Mapping[str, KnownObject] = field(default_factory=dict)
    library: GraspLibrary = field(default_factory=lambda: GraspLibrary({}))
    grips: Mapping[str, Grip] = field(default_factory=dict)
    held: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        object.__setattr__(self, "objects", MappingProxyType(dict(self.objects)))
        object.__setattr__(self, "grips", MappingProxyType(dict(self.grips)))

    @property
    def X_WO(self) -> dict[str, Pose]:
        """Pose of each object."""
        return {name: known.X_WO for name, known in self.objects.items()}

    @property
    def obstacles(self) -> dict[str, tuple[tuple[TriangleMesh, ...], Pose]]:
        """Shapes and poses of what stands around, for `optsc.robot.collision.CollisionModel.scene`."""
        return {
            name: (known.parts, known.X_WO) for name, known in self.objects.items() if name not in self.held
        }

    def place(self) -> Candidates:
        """Return all stored grasps, placed where their objects are, but for what is in the hand."""
        names = [name for name in self.library if name not in self.held]
        return self.library.place({name: self.objects[name].X_WO for name in names})

    def ages(self, now: float) -> dict[str, float]:
        """Return for how long each object has not been seen unhidden [s]."""
        return {name: now - known.stamp for name, known in self.objects.items()}

    def with_object(self, known: KnownObject) -> SceneState:
        """Return the memory with this object on the table, new or in place of that of its name."""
        grips = {name: grip for name, grip in self.grips.items() if name != known.name}
        objects = {**self.objects, known.name: known}
        return replace(self, objects=objects, grips=grips, held=self.held - {known.name})

    def with_held(self, name: str, X_WO: Pose) -> SceneState:
        """Return the memory with an object in the hand."""
        objects = {**self.objects, name: self.objects[name].at(X_WO)}
        return replace(self, objects=objects, held=self.held | {name})

    def without(self, name: str) -> SceneState:
        """Return the memory without an object and its grasps."""
        objects = {other: known for other, known in self.objects.items() if other != name}
        grips = {other: grip for other, grip in self.grips.items() if other != name}
        library = self.library.without(name) if name in self.library else self.library
        return SceneState(objects, library, grips, self.held - {name})
