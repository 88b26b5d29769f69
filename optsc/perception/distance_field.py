"""Signed distance field of a template on a grid: it makes hundreds of pose hypotheses cheap to score."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import TriangleMesh
from optsc.geometry.rotation import Array
from optsc.sampling.surface import face_crosses

_SAMPLES_PER_CELL, _CANDIDATES = 4.0, 4
_LARGEST = 4_000_000


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Signed distance to a surface, above zero outside, and its gradient at the centres of cubic cells.

    Attributes:
        corner: centre of the first cell (3,) [m].
        step: edge of a cell [m].
        distance: (X, Y, Z) float32 [m].
        gradient: (X, Y, Z, 3) float32, of unit length.
    """

    corner: Array
    step: float
    distance: np.ndarray
    gradient: np.ndarray

    def __post_init__(self) -> None:
        # One row per cell: distance and gradient come with a single gather.
        rows = np.concatenate([self.distance[..., None], self.gradient], axis=-1).reshape(-1, 4)
        object.__setattr__(self, "_rows", np.ascontiguousarray(rows, dtype=np.float32))

    def lookup(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances (...) [m] and gradients (..., 3) at ``points`` (..., 3) [m].

        First-order expansion about the centre of the cell: exact for planes, off by step^2 / (8 r) at most next to a
        surface of radius r. Beyond the grid the distance to the grid's border is added.
        """
        scaled = (points - self.corner) / self.step
        shape = self.distance.shape
        cell = np.clip(np.rint(scaled).astype(np.int32), 0, np.array(shape, dtype=np.int32) - 1)
        row = (cell[..., 0] * shape[1] + cell[..., 1]) * shape[2] + cell[..., 2]
        found = self._rows[row]  # type: ignore[attr-defined]
        offset = (scaled - cell) * self.step
        beyond = np.linalg.norm(np.maximum(np.abs(offset) - 0.5 * self.step, 0.0), axis=-1)
        inside = np.clip(offset, -0.5 * self.step, 0.5 * self.step)
        gradient = found[..., 1:]
        return found[..., 0] + (gradient * inside).sum(axis=-1) + beyond, gradient


def distance_field(
    mesh: TriangleMesh, rng: np.random.Generator, *, step: float = 0.003, margin: float = 0.02
) -> DistanceField:
    """Return the field of ``mesh`` on a grid that reaches ``margin`` [m] beyond it.

    Raises:
        InvalidValue: a grid of more than four million cells (a step too small for the mesh's size).
    """
    from scipy.spatial import cKDTree

    corner = mesh.vertices.min(axis=0) - margin
    shape = np.ceil((np.ptp(mesh.vertices, axis=0) + 2.0 * margin) / step).astype(int) + 1
    if np.prod(shape.astype(float)) > _LARGEST:
        raise InvalidValue("step of the distance field", step, f"large enough for at most {_LARGEST} cells")
    axes = [corner[i] + step * np.arange(shape[i]) for i in range(3)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points, owner = _face_samples(mesh, step, rng)
    _, near = cKDTree(points).query(cells, k=_CANDIDATES)
    distance, gradient = _signed(mesh, cells, owner[near])
    return DistanceField(corner, float(step), distance.reshape(shape).astype(np.float32), gradient.reshape(*shape, 3))


def _face_samples(mesh: TriangleMesh, step: float, rng: np.random.Generator) -> tuple[Array, np.ndarray]:
    """Return points on the surface (N, 3) and the face of each (N,); every face has some."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    area = 0.5 * np.linalg.norm(face_crosses(mesh), axis=1)
    counts = np.ceil(_SAMPLES_PER_CELL * area / step**2).astype(int) + 3
    owner = np.repeat(np.arange(len(area)), counts)
    u, v = rng.random((2, len(owner)))
    outside = u + v > 1.0
    u, v = np.where(outside, 1.0 - u, u)[:, None], np.where(outside, 1.0 - v, v)[:, None]
    return a[owner] + u * (b - a)[owner] + v * (c - a)[owner], owner


def _signed(mesh: TriangleMesh, points: Array, faces: np.ndarray) -> tuple[Array, Array]:
    """Return signed distances (N,) and their gradients (N, 3) to the nearest of candidate ``faces`` (N, K).

    On edges and corners, where several faces are nearest, the sum of their normals decides the sign.
    """
    best = np.full(len(points), np.inf)
    closest, outwards = np.zeros_like(points), np.zeros_like(points)
    corners = mesh.vertices[mesh.faces]
    normals = face_crosses(mesh)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    for k in range(faces.shape[1]):
        touch = _closest_point(points, *np.moveaxis(corners[faces[:, k]], 1, 0))
        d = np.linalg.norm(points - touch, axis=1)
        tie = np.abs(d - best) <= 1e-9
        nearer = (d < best) & ~tie
        outwards[nearer], closest[nearer] = normals[faces[nearer, k]], touch[nearer]
        outwards[tie] += normals[faces[tie, k]]
        best = np.where(nearer, d, best)
    away = points - closest
    sign = np.where((away * outwards).sum(axis=1) >= 0.0, 1.0, -1.0)
    on_it = best < 1e-6
    direction = sign[:, None] * away / np.maximum(best, 1e-12)[:, None]
    outwards /= np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-30)
    return sign * best, np.where(on_it[:, None], outwards, direction)


def _closest_point(p: Array, a: Array, b: Array, c: Array) -> Array:
    """Return the point of each triangle that is nearest to ``p``, all (N, 3).

    Barycentric regions as in C. Ericson, Real-Time Collision Detection, 2005, section 5.1.5.
    """
    ab, ac, ap, bp, cp = b - a, c - a, p - a, p - b, p - c
    d1, d2 = (ab * ap).sum(-1), (ac * ap).sum(-1)
    d3, d4 = (ab * bp).sum(-1), (ac * bp).sum(-1)
    d5, d6 = (ab * cp).sum(-1), (ac * cp).sum(-1)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2

    def share(part: Array, whole: Array) -> Array:
        return part / np.where(np.abs(whole) > 1e-30, whole, 1.0)

    total = va + vb + vc
    v, w = share(vb, total), share(vc, total)
    on_bc = (va <= 0) & (d4 - d3 >= 0) & (d5 - d6 >= 0)
    t = share(d4 - d3, (d4 - d3) + (d5 - d6))
    v, w = np.where(on_bc, 1.0 - t, v), np.where(on_bc, t, w)
    on_ac = (vb <= 0) & (d2 >= 0) & (d6 <= 0)
    v, w = np.where(on_ac, 0.0, v), np.where(on_ac, share(d2, d2 - d6), w)
    on_ab = (vc <= 0) & (d1 >= 0) & (d3 <= 0)
    v, w = np.where(on_ab, share(d1, d1 - d3), v), np.where(on_ab, 0.0, w)
    at_c, at_b, at_a = (d6 >= 0) & (d5 <= d6), (d3 >= 0) & (d4 <= d3), (d1 <= 0) & (d2 <= 0)
    v = np.where(at_c | at_a, 0.0, np.where(at_b, 1.0, v))
    w = np.where(at_c, 1.0, np.where(at_b | at_a, 0.0, w))
    return a + v[:, None] * ab + w[:, None] * ac
