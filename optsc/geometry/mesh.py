"""Triangle meshes as plain arrays, so that no room above depends on a mesh library."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A surface in its own frame.

    Attributes:
        vertices: (V, 3) [m].
        faces: (F, 3) indices of vertices, counter-clockwise seen from outside.
    """

    vertices: Array
    faces: np.ndarray

    def __post_init__(self) -> None:
        vertices = np.array(self.vertices, dtype=float)
        faces = np.array(self.faces, dtype=np.int64)
        if vertices.ndim != 2 or vertices.shape[1:] != (3,) or not np.all(np.isfinite(vertices)):
            raise InvalidValue("mesh vertices", vertices.shape, "finite, shape (V, 3) [m]")
        if faces.ndim != 2 or faces.shape[1:] != (3,) or len(faces) == 0:
            raise InvalidValue("mesh faces", faces.shape, "shape (F, 3), at least one face")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InvalidValue("mesh face index", int(faces.max()), f"0 to {len(vertices) - 1}")
        vertices.flags.writeable = faces.flags.writeable = False
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    @property
    def extents(self) -> Array:
        """Size of the axis-aligned bounding box (3,) [m]."""
        return np.ptp(self.vertices, axis=0)

    @property
    def centre(self) -> Array:
        """Middle of the axis-aligned bounding box (3,) [m]."""
        return 0.5 * (self.vertices.min(axis=0) + self.vertices.max(axis=0))

    @property
    def hash(self) -> str:
        """SHA-256 of the geometry rounded to a micrometre, so that it outlives storage formats."""
        digest = hashlib.sha256(np.round(self.vertices * 1e6).astype("<i8").tobytes())
        digest.update(self.faces.astype("<i8").tobytes())
        return digest.hexdigest()

    def clustered(self, cell: float) -> TriangleMesh:
        """Return a coarser mesh for pictures: the vertices of each cube of size ``cell`` [m] become their mean.

        Vertex clustering after Rossignac and Borrel 1993. Faces that collapse, and copies of a face, are left
        out; where all collapse, the mesh is returned as it is. Raises `InvalidValue` unless ``cell`` is above 0.
        """
        if not 0.0 < cell < np.inf:
            raise InvalidValue("cell of the clustering", cell, "finite, above 0 m")
        cubes = np.floor((self.vertices - self.vertices.min(axis=0)) / cell).astype(np.int64)
        _, cluster, count = np.unique(cubes, axis=0, return_inverse=True, return_counts=True)
        vertices = np.zeros((len(count), 3))
        np.add.at(vertices, cluster.ravel(), self.vertices)
        faces = cluster.ravel()[self.faces]
        faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
        if len(faces) == 0:
            return self
        # The same face begins at any of its corners; its least index first makes copies equal.
        start = np.argmin(faces, axis=1)
        turned = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, axis=1)
        return TriangleMesh(vertices / count[:, None], np.unique(turned, axis=0))

    def sample(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Return ``count`` points (count, 3) [m], uniform by area, and their outward unit normals (count, 3)."""
        corners = self.vertices[self.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        double_area = np.linalg.norm(cross, axis=1)
        face = rng.choice(len(self.faces), size=count, p=double_area / double_area.sum())
        u, v = rng.random((2, count))
        outside = u + v > 1.0
        u, v = np.where(outside, 1 - u, u), np.where(outside, 1 - v, v)
        a, b, c = np.moveaxis(corners[face], 1, 0)
        points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
        return points, cross[face] / double_area[face, None]
