"""Solids from convex pieces: pieces made from points, and their exact union.

A solid is written down once, as its convex pieces. Its surface is computed from them, so what is seen
and what is touched agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry import TriangleMesh
from optsc.geometry.rotation import Array

if TYPE_CHECKING:
    from manifold3d import Manifold

SIDES = 32
"""Facets of everything round: normals are within 6 degrees of the round ones."""

_GRID = 1e-6  # [m]; vertices are put on it, so that rounding in a later digit cannot change the mesh's hash


def hull(points: ArrayLike) -> TriangleMesh:
    """Return the convex hull of points (..., 3) [m]; raise `InvalidValue` if they span no volume."""
    from manifold3d import Manifold

    flat = np.asarray(points, dtype=float).reshape(-1, 3)
    return _surface(Manifold.hull_points(np.round(flat / _GRID) * _GRID))


def union(parts: Sequence[TriangleMesh]) -> TriangleMesh:
    """Return the watertight surface of the union of closed ``parts``; the same bytes in every process."""
    from manifold3d import Manifold, Mesh64, OpType

    solids = [Manifold(Mesh64(part.vertices.copy(), part.faces.astype(np.uint64))) for part in parts]
    return _surface(Manifold.batch_boolean(solids, OpType.Add).simplify(_GRID))


def circle(radius: float, height: float = 0.0, sides: int = SIDES) -> Array:
    """Return a regular polygon (sides, 3) about the z axis [m] with a facet, not a corner, towards +x."""
    angle = (np.arange(sides) + 0.5) * (2 * np.pi / sides)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(sides, height)], axis=-1)


def revolved(profile: ArrayLike, sides: int = SIDES) -> TriangleMesh:
    """Return the body of a convex profile (P, 2) of radius and height [m], turned about the z axis."""
    return hull([circle(radius, height, sides) for radius, height in np.asarray(profile, dtype=float)])


def tube(inner: float, outer: float, bottom: float, top: float, sides: int = SIDES) -> list[TriangleMesh]:
    """Return a round wall standing on ``bottom``, as one wedge per facet; radii and heights in [m]."""
    rings = np.stack([circle(r, z, sides) for r in (inner, outer) for z in (bottom, top)])
    return [hull(rings[:, [i, (i + 1) % sides]]) for i in range(sides)]


def loft(sections: ArrayLike) -> list[TriangleMesh]:
    """Return the pieces between neighbours in a row of convex sections (S, K, 3) [m]."""
    rings = np.asarray(sections, dtype=float)
    return [hull(rings[i : i + 2]) for i in range(len(rings) - 1)]


def cuboid(lower: ArrayLike, upper: ArrayLike, chamfer: float = 0.0) -> TriangleMesh:
    """Return an axis-aligned box with bevelled edges from corner ``lower`` to ``upper`` (3,) [m]."""
    low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
    inwards = np.sign((low + high) / 2 - corners) * chamfer
    # Each face is drawn in by the chamfer along its two own directions, which bevels all edges.
    return hull([corners + inwards * (1 - np.eye(3)[axis]) for axis in range(3)])


def _surface(solid: Manifold) -> TriangleMesh:
    """Return the solid's surface on the grid, vertices and faces in an order that depends on nothing else."""
    if solid.is_empty() or solid.volume() <= 0.0:
        raise InvalidValue("volume of a solid", solid.volume(), "above 0 m^3: points that span a volume, closed pieces")
    raw = solid.to_mesh64()
    grid = np.round(np.asarray(raw.vert_properties)[:, :3] / _GRID).astype(np.int64)
    vertices, index = np.unique(grid, axis=0, return_inverse=True)
    faces = index.reshape(-1)[np.asarray(raw.tri_verts, dtype=np.int64)]
    faces = np.take_along_axis(faces, (np.argmin(faces, axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    return TriangleMesh(np.asarray(vertices * _GRID, dtype=np.float64), faces[np.lexsort(faces.T[::-1])])
