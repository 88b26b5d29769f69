"""Object templates: known shapes that a camera's view is compared with, and what is computed of them beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from optsc.cache import Arrays, computed_once, content_key
from optsc.checks import Between, Positive, require
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.geometry.rotation import Array
from optsc.perception.distance_field import DistanceField, distance_field
from optsc.perception.resting import (
    CONTINUOUS,
    box_symmetries,
    resting_poses,
    turned_least,
    vertical_symmetry,
)
from optsc.sampling.surface import is_closed, mesh_area

LARGEST, SMALLEST = 2.0, 0.005
"""A template's longest edge has to lie between these [m]; beyond them its unit is suspected."""

_UNREADABLE = (ValueError, TypeError, KeyError, IndexError, AttributeError, OSError, ImportError)
"""What trimesh raises for what is no mesh; the last where it would guess an encoding by a package that is not there."""

_LEAST_VOLUME = 1e-9  # [m^3], a cubic millimetre

_CACHE = "templates"
_VERSION = 1
"""Rises with every change that makes another template of the same mesh: what was kept is then computed again."""
_COMPUTED = frozenset(
    ("points", "normals", "symmetry", "resting_quaternion", "resting_translation")
    + ("diameter", "corner", "step", "distance", "gradient")
)


@dataclass(frozen=True, eq=False)
class Template:
    """A known shape in its frame O: origin at the centre of its base, z up.

    Attributes:
        name: what it is called.
        mesh: its surface.
        points: evenly spread over the surface (N, 3) [m], in an order in which every first part is spread evenly too.
        normals: outward, unit (N, 3).
        symmetry: about the z axis: 0 continuous, n: n-fold, 1: none.
        resting: the poses (K,) in which it rests on the plane z = 0, without yaw; readiest first.
        diameter: largest distance between two of its points [m].
        field: signed distance to the surface.
    """

    name: str
    mesh: TriangleMesh
    points: Array
    normals: Array
    symmetry: int
    resting: Pose
    diameter: float
    field: DistanceField

    @property
    def round(self) -> bool:
        """Whether a turn about the z axis of O makes no difference."""
        return self.symmetry == CONTINUOUS

    @property
    def spacing(self) -> float:
        """How far `points` lie apart, about [m]: the edge of the square that each stands for."""
        return float(np.sqrt(mesh_area(self.mesh) / len(self.points)))

    @cached_property
    def symmetries(self) -> Pose:
        """The turns X_OS (K,) of `box_symmetries` that map the shape onto itself, none at all first."""
        return box_symmetries(self.points, self.field)

    def nearest_equivalent(self, X_WO: Pose, X_before: Pose) -> Pose:
        """Return, of the poses in which the shape looks the same as at X_WO, the one turned least from X_before.

        Without it a can that is put down elsewhere might be said to stand on its head.
        """
        same = [X_WO @ X for X in self.symmetries]
        if self.round:
            same = [turned_least(X, X_before) for X in same]
        return min(same, key=lambda X: float(rotation.angle(X.quaternion, X_before.quaternion)))


def template_from_mesh(
    name: str,
    mesh: TriangleMesh,
    *,
    count: int = 1500,
    symmetry_tolerance: float = 0.0015,
    seed: int = 0,
    keep: bool = False,
) -> Template:
    """Return the template of a surface that is given in O.

    Args:
        mesh: closed if possible; of an open one the convex hull decides how it rests.
        count: of surface points.
        symmetry_tolerance: how far turned points may lie off the surface to call it symmetric [m].
        seed: of the surface points; same mesh and seed, same template.
        keep: whether what is computed is kept in the per-user cache, and taken from there if it is there already.

    Raises:
        InvalidValue: the mesh encloses no volume, is inside out, or its size makes its unit suspicious.
    """
    _check_size(name, mesh)
    _check_volume(name, mesh)
    require("number of surface points", count, Between(10, 100_000))

    def compute() -> Arrays:
        return _computed(mesh, count, symmetry_tolerance, seed)

    if keep:
        key = content_key(_VERSION, mesh.vertices, mesh.faces, count, symmetry_tolerance, seed)
        arrays = computed_once(_CACHE, key, _COMPUTED, compute)
    else:
        arrays = compute()
    for array in arrays.values():
        array.flags.writeable = False
    field = DistanceField(arrays["corner"], float(arrays["step"]), arrays["distance"], arrays["gradient"])
    resting = Pose(arrays["resting_quaternion"], arrays["resting_translation"])
    points, normals = arrays["points"], arrays["normals"]
    return Template(name, mesh, points, normals, int(arrays["symmetry"]), resting, float(arrays["diameter"]), field)


def _computed(mesh: TriangleMesh, count: int, symmetry_tolerance: float, seed: int) -> Arrays:
    """Return all that takes time, by the names in `_COMPUTED`."""
    rng = np.random.default_rng(seed)
    field = distance_field(mesh, rng, step=max(0.003, float(mesh.extents.max()) / 120.0))
    points, normals = _spread(*mesh.sample(rng, 8 * count), count)
    symmetry = vertical_symmetry(points, field, symmetry_tolerance)
    resting = resting_poses(mesh, symmetry)
    return {
        "points": points,
        "normals": normals,
        "symmetry": np.array(symmetry),
        "resting_quaternion": resting.quaternion,
        "resting_translation": resting.translation,
        "diameter": np.array(_diameter(mesh)),
        "corner": field.corner,
        "step": np.array(field.step),
        "distance": field.distance,
        "gradient": field.gradient,
    }


def template_from_file(
    path: str | Path, name: str | None = None, *, unit: float = 1.0, keep_frame: bool = False
) -> Template:
    """Return the template of a mesh file (STL, OBJ, PLY and what else trimesh reads).

    Args:
        name: the file's name without its ending by default.
        unit: length of the file's unit [m]: 0.001 for millimetres.
        keep_frame: keep the file's frame as O. By default the origin is moved to the centre of the base.

    Raises:
        DamagedFile: there is no such file, or it is no mesh.
        InvalidValue: as `template_from_mesh`.
    """
    import trimesh

    path = Path(path)
    if not path.is_file():
        raise DamagedFile(path, "no such file")
    try:
        loaded = trimesh.load_mesh(path, process=True)
    except _UNREADABLE as error:
        raise DamagedFile(path, f"not readable as a mesh: {error}") from error
    faces = np.asarray(getattr(loaded, "faces", ()))
    if faces.ndim != 2 or len(faces) == 0 or faces.shape[1] != 3:
        raise DamagedFile(path, "holds no triangles")
    if not np.all(np.isfinite(loaded.vertices)):
        raise DamagedFile(path, "has vertices that are not finite")
    require("unit", unit, Positive)
    vertices = np.asarray(loaded.vertices, dtype=float) * unit
    if not keep_frame:
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        vertices = vertices - [*(0.5 * (low + high))[:2], low[2]]
    return template_from_mesh(name or path.stem, TriangleMesh(vertices, faces), keep=True)


@cache
def catalogue_template(name: str) -> Template:
    """Return the template of an object of `optsc.sim`; raise `UnknownName`."""
    from optsc.sim import object_model

    return template_from_mesh(name, object_model(name).mesh, keep=True)


def catalogue_templates(names: Sequence[str] | None = None) -> tuple[Template, ...]:
    """Return the templates of the objects of `optsc.sim`, all of them by default; raise `UnknownName`."""
    from optsc.sim import OBJECT_NAMES

    return tuple(catalogue_template(name) for name in (OBJECT_NAMES if names is None else names))


def templates_by_name(templates: Sequence[Template]) -> dict[str, Template]:
    """Return templates by their names; raise `InvalidValue` where two have the same."""
    by_name = {template.name: template for template in templates}
    if len(by_name) < len(templates):
        raise InvalidValue("templates", [template.name for template in templates], "each name once")
    return by_name


def _check_size(name: str, mesh: TriangleMesh) -> None:
    longest = float(mesh.extents.max())
    if longest > LARGEST:
        hint = "it looks like millimetres, so scale it by 0.001 (unit=0.001)"
        if longest < 3.0 * LARGEST:
            hint = "perhaps it is in another unit"
        raise InvalidValue(f"longest edge of template {name}", longest, f"at most {LARGEST} m; {hint}")
    if longest < SMALLEST:
        raise InvalidValue(
            f"longest edge of template {name}", longest, f"at least {SMALLEST} m; perhaps it was scaled twice"
        )


def _check_volume(name: str, mesh: TriangleMesh) -> None:
    valid = "above 1 mm^3: a closed surface that encloses something, faces counter-clockwise seen from outside"
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    if np.prod(high - low) <= _LEAST_VOLUME:
        raise InvalidValue(f"volume of template {name}", 0.0, valid)
    if is_closed(mesh):
        volume = float(np.linalg.det(mesh.vertices[mesh.faces] - mesh.centre).sum() / 6.0)
        if volume <= _LEAST_VOLUME:
            raise InvalidValue(f"volume of template {name}", volume, valid)
    else:
        resting_poses(mesh, 1)  # raises where even the hull is flat


def _spread(points: Array, normals: Array, count: int) -> tuple[Array, Array]:
    """Return ``count`` of the points, each the farthest from all before it (T. Gonzalez, 1985)."""
    chosen = np.zeros(count, dtype=int)
    nearest = np.full(len(points), np.inf)
    # Sums over columns are several times quicker than over rows of three.
    x, y, z = np.ascontiguousarray(points.T)
    for i in range(1, count):
        last = chosen[i - 1]
        dx, dy, dz = x - x[last], y - y[last], z - z[last]
        np.minimum(nearest, dx * dx + dy * dy + dz * dz, out=nearest)
        chosen[i] = int(np.argmax(nearest))
    return points[chosen].copy(), normals[chosen].copy()


def _diameter(mesh: TriangleMesh) -> float:
    from scipy.spatial import ConvexHull

    corners = mesh.vertices[ConvexHull(mesh.vertices).vertices]
    return float(np.sqrt(((corners[:, None] - corners[None]) ** 2).sum(-1).max()))
