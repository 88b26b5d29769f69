"""An object's surface as points: what the gripper is tested against, whether from a mesh or from a camera."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optsc.geometry import TriangleMesh
from optsc.geometry.rotation import Array

_SHARP = np.cos(np.radians(20.0))


class Surface(NamedTuple):
    """Points of a surface in the object's frame."""

    points: Array
    """(N, 3) [m]."""
    normals: Array
    """Outward unit normals (N, 3)."""
    areas: Array
    """Area that each point stands for (N,) [m^2]; zero for points that only mark an edge."""

    def every(self, step: int) -> Surface:
        """Return every ``step``-th point; the areas keep their sum in the mean."""
        return Surface(self.points[::step], self.normals[::step], self.areas[::step] * step)


def sample_surface(mesh: TriangleMesh, spacing: float, rng: np.random.Generator) -> Surface:
    """Return points about ``spacing`` [m] apart, uniform by area, shuffled among points along sharp edges.

    The edges are sampled as well because they are what sticks out furthest, and random points miss them.
    """
    area = mesh_area(mesh)
    count = max(int(np.ceil(area / spacing**2)), 100)
    points, normals = mesh.sample(rng, count)
    edge_points, edge_normals = _sharp_edges(mesh, spacing)
    areas = np.concatenate([np.full(count, area / count), np.zeros(len(edge_points))])
    points, normals = np.concatenate([points, edge_points]), np.concatenate([normals, edge_normals])
    order = rng.permutation(len(points))
    return Surface(points[order], normals[order], areas[order])


def mesh_area(mesh: TriangleMesh) -> float:
    """Return the surface area [m^2]."""
    return float(0.5 * np.linalg.norm(face_crosses(mesh), axis=1).sum())


def face_crosses(mesh: TriangleMesh) -> Array:
    """Return the outward face normals (F, 3), twice the face's area long [m^2]."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return np.cross(b - a, c - a)


def is_closed(mesh: TriangleMesh) -> bool:
    """Tell whether every edge is shared by faces that run along it in opposite directions."""
    forth = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    back = forth[:, ::-1]
    return np.array_equal(forth[np.lexsort(forth.T)], back[np.lexsort(back.T)])


def centre_of_mass(mesh: TriangleMesh) -> Array:
    """Return the centre of the enclosed volume (3,) [m], or of the surface where it encloses none.

    Volume: the sum of the tetrahedra between each face and one point (the divergence theorem).
    """
    corners = mesh.vertices[mesh.faces] - mesh.centre
    if is_closed(mesh):
        six_volumes = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
        if six_volumes.sum() > 0.0:
            return mesh.centre + six_volumes @ corners.sum(axis=1) / (4.0 * six_volumes.sum())
    weights = np.linalg.norm(face_crosses(mesh), axis=1)
    return mesh.centre + weights @ corners.mean(axis=1) / weights.sum()


def _sharp_edges(mesh: TriangleMesh, spacing: float) -> tuple[Array, Array]:
    """Return points about ``spacing`` apart along edges between faces that turn by more than 20 degrees."""
    crosses = face_crosses(mesh)
    lengths = np.linalg.norm(crosses, axis=1)
    normals = crosses / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(mesh.faces)), 3)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    pairs = np.nonzero(np.all(edges[1:] == edges[:-1], axis=1))[0]
    first, second = normals[owner[pairs]], normals[owner[pairs + 1]]
    sharp = np.einsum("ei,ei->e", first, second) < _SHARP
    pairs, outwards = pairs[sharp], (first + second)[sharp]
    start, end = np.moveaxis(mesh.vertices[edges[pairs]], 1, 0)
    counts = np.ceil(np.linalg.norm(end - start, axis=1) / spacing).astype(int) + 1
    edge = np.repeat(np.arange(len(pairs)), counts)
    within = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    fraction = (within / np.maximum(counts[edge] - 1, 1))[:, None]
    # A knife edge's two normals cancel; the length then only must not be divided by.
    outwards /= np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9)
    return start[edge] + fraction * (end - start)[edge], outwards[edge]
