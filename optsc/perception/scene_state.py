"""Scene state: what is known between two observations, objects, their poses and stored grasps. Values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import NamedTuple

from optsc.geometry import Pose, TriangleMesh
from optsc.grasps import Candidates, GraspLibrary
from optsc.perception.known_objects import KnownObject


class SceneEventKind(Enum):
    """What an observation can bring about an object."""

    STORED = "seen for the first time, and grasps of it stored"
    MOVED = "moved, and its grasps with it"
    TOPPLED = "stands or lies differently, and has new grasps"
    TAKEN = "in the hand, and neither an obstacle nor to be grasped"
    RETIRED = "no longer there, and its grasps dropped"
    REFUSED = "seen, but without grasps"


class SceneEvent(NamedTuple):
    """What happened to one object in one observation; ``words`` say why or by how much."""

    kind: SceneEventKind
    name: str
    words: str


class Grip(NamedTuple):
    """An object that was between the jaws: its pose in the tool's frame then, and the share of its points there."""

    X_TO: Pose
    share: float


@dataclass(frozen=True, eq=False)
class SceneState:
    """All known objects and the library of their grasps.

    Attributes:
        objects: by name.
        library: grasps of those that have any, in O. A set is replaced only by an observation that nothing hides.
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
        """Shapes and poses of what stands around, for `optsc.collision.CollisionModel.scene`."""
        return {name: (known.parts, known.X_WO) for name, known in self.objects.items() if name not in self.held}

    def place(self) -> Candidates:
        """Return all stored grasps, placed where their objects are, but for what is in the hand."""
        names = [name for name in self.library if name not in self.held]
        return self.library.place({name: self.objects[name].X_WO for name in names})

    def ages(self, now: float) -> dict[str, float]:
        """Return for how long each object has not been seen unhidden [s]."""
        return {name: now - known.stamp for name, known in self.objects.items()}

    def with_object(self, known: KnownObject) -> SceneState:
        """Return the state with this object on the table, new or in place of that of its name."""
        grips = {name: grip for name, grip in self.grips.items() if name != known.name}
        objects = {**self.objects, known.name: known}
        return replace(self, objects=objects, grips=grips, held=self.held - {known.name})

    def with_held(self, name: str, X_WO: Pose) -> SceneState:
        """Return the state with an object in the hand."""
        objects = {**self.objects, name: self.objects[name].moved_to(X_WO)}
        return replace(self, objects=objects, held=self.held | {name})

    def without(self, name: str) -> SceneState:
        """Return the state without an object and its grasps."""
        objects = {other: known for other, known in self.objects.items() if other != name}
        grips = {other: grip for other, grip in self.grips.items() if other != name}
        library = self.library.without(name) if name in self.library else self.library
        return SceneState(objects, library, grips, self.held - {name})
