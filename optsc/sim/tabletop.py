"""Tabletop world: a table with objects in front of an arm, as a value; no simulation is started."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from optsc.checks import NonNegative, require
from optsc.errors import InvalidValue
from optsc.geometry import Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel
from optsc.sim.objects import ObjectModel, object_model
from optsc.sim.workspace import HALF_ANGLE, Band, comfortable_band

_ARRANGEMENTS, _TRIES = 200, 40


@dataclass(frozen=True, eq=False)
class Tabletop:
    """An arm on a table with objects: the table's top is z = 0 of W, the arm's base frame is W.

    Attributes:
        robot: the arm.
        objects: the objects by name.
        X_WO: their poses at the start, by name.
        seed: what the poses were drawn with.
    """

    robot: RobotModel
    objects: Mapping[str, ObjectModel]
    X_WO: Mapping[str, Pose]
    seed: int = 0

    def __post_init__(self) -> None:
        if tuple(self.objects) != tuple(self.X_WO):
            raise InvalidValue("objects with a pose", list(self.X_WO), f"the objects, in order: {list(self.objects)}")
        for field in ("objects", "X_WO"):
            object.__setattr__(self, field, MappingProxyType(dict(getattr(self, field))))

    @property
    def placed_parts(self) -> dict[str, tuple[tuple[TriangleMesh, ...], Pose]]:
        """Convex parts and pose X_WO of each object by name, as collision checks and pictures take them."""
        return {name: (model.parts, self.X_WO[name]) for name, model in self.objects.items()}


def tabletop(
    robot: RobotModel,
    objects: Sequence[str | ObjectModel] = ("mug", "can", "box"),
    seed: int = 0,
    *,
    spacing: float = 0.17,
    gap: float = 0.07,
) -> Tabletop:
    """Return objects standing upright at random places and yaws where ``robot`` grasps comfortably.

    Args:
        robot: the arm; its reach decides the region, see `optsc.sim.workspace`.
        objects: names from `OBJECT_NAMES` or user-defined models, each name once.
        seed: same robot, objects and seed, same poses.
        spacing: least distance between the centres of two objects [m].
        gap: least distance between the circles around two objects [m], so that a hand fits between them.

    Raises:
        UnknownName: there is no object of that name.
        InvalidValue: a name twice, or more objects than fit.
    """
    models = [object_model(entry) if isinstance(entry, str) else entry for entry in objects]
    names = [model.name for model in models]
    if len(set(names)) < len(names):
        raise InvalidValue("objects", names, "each name once")
    require("spacing", spacing, NonNegative)
    require("gap", gap, NonNegative)
    band, rng = comfortable_band(robot), np.random.default_rng(seed)
    radii = np.array([np.linalg.norm(model.mesh.vertices[:, :2], axis=1).max() for model in models])
    apart = np.maximum(spacing, radii[:, None] + radii + gap)
    places = _arranged(apart, band, rng)
    if places is None:
        room = f"{band.inner:.2f} to {band.outer:.2f} m from the base, {HALF_ANGLE} rad to both sides"
        valid = f"fewer or smaller ones: {room}, {apart.min():.2f} to {apart.max():.2f} m apart, they do not fit"
        raise InvalidValue("objects", names, valid)
    yaws = rng.uniform(-np.pi, np.pi, len(models))
    poses = [Pose.from_rotation_vector([0.0, 0.0, yaw], [*p, 0.0]) for yaw, p in zip(yaws, places, strict=True)]
    return Tabletop(robot, dict(zip(names, models, strict=True)), dict(zip(names, poses, strict=True)), int(seed))


def _arranged(apart: Array, band: Band, rng: np.random.Generator) -> Array | None:
    """Return places (N, 2) [m], uniform in the region, at least ``apart`` (N, N) [m]; None if none fit."""
    count = len(apart)
    for _ in range(_ARRANGEMENTS):
        places: list[Array] = []
        for index in range(count):
            r = np.sqrt(rng.uniform(band.inner**2, band.outer**2, _TRIES))
            angle = rng.uniform(-HALF_ANGLE, HALF_ANGLE, _TRIES)
            tries = np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1)
            others = np.array(places).reshape(-1, 2)
            distances = np.linalg.norm(tries[:, None] - others, axis=-1)
            free = np.flatnonzero((distances >= apart[index, :index]).all(axis=1))
            if len(free) == 0:
                break
            places.append(tries[free[0]])
        else:
            return np.array(places).reshape(-1, 2)
    return None
