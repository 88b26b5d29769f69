"""Where straight lines leave a solid."""

from __future__ import annotations

import numpy as np

from optsc.geometry import TriangleMesh
from optsc.geometry.rotation import Array
from optsc.sampling.products import thin_product

_CHUNK = 2_000_000  # ray-face pairs held in memory at once


def exits(
    mesh: TriangleMesh, origins: Array, directions: Array, longest: float
) -> tuple[np.ndarray, Array, Array]:
    """Return every crossing of rays (M, 3) through the surface from inside to outside.

    Returns:
        Index of the ray (C,), distance along it (C,) [m], in (0, ``longest``], and the outward unit normal
        there (C, 3).

    Source: T. Moeller, B. Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
    """
    step = max(1, _CHUNK // len(mesh.faces))
    found = [
        _exits(mesh, origins[i : i + step], directions[i : i + step], longest, i)
        for i in range(0, len(origins), step)
    ]
    rays, distances, normals = zip(*found, strict=True)
    return np.concatenate(rays), np.concatenate(distances), np.concatenate(normals)


def _exits(
    mesh: TriangleMesh, origins: Array, directions: Array, longest: float, offset: int
) -> tuple[np.ndarray, Array, Array]:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    ab, ac = b - a, c - a
    normal = np.cross(ab, ac)
    # Cramer's rule with everything that depends on the face alone taken out of the ray-face loop:
    # t = (a - o).n / d.n, and the barycentric coordinates are linear in the point of the face's plane.
    leaving = thin_product(directions, normal.T)
    plane = np.einsum("fi,fi->f", a, normal)
    usable = leaving > 1e-12 * np.linalg.norm(normal, axis=1)
    t = (plane - thin_product(origins, normal.T)) / np.where(usable, leaving, 1.0)
    square = np.maximum(np.einsum("fi,fi->f", normal, normal), 1e-300)
    u_axis, v_axis = np.cross(ac, normal) / square[:, None], np.cross(normal, ab) / square[:, None]
    u = (
        thin_product(origins, u_axis.T)
        - np.einsum("fi,fi->f", a, u_axis)
        + t * thin_product(directions, u_axis.T)
    )
    v = (
        thin_product(origins, v_axis.T)
        - np.einsum("fi,fi->f", a, v_axis)
        + t * thin_product(directions, v_axis.T)
    )
    ray, face = np.nonzero(usable & (t > 1e-6) & (t <= longest) & (u >= 0) & (v >= 0) & (u + v <= 1))
    return ray + offset, t[ray, face], normal[face] / np.sqrt(square[face])[:, None]
