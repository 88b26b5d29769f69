"""Antipodal proposals: tool poses whose jaws close on two opposite points of a surface."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.geometry.rotation import Array
from optsc.robot.gripper import Gripper
from optsc.sampling.contacts import cone_cosine, thin_product
from optsc.sampling.settings import AntipodalSettings
from optsc.sampling.surface import SurfacePoints

Propose = Callable[[np.random.Generator], Pose]
"""One round of sampling: poses X_OG (K,)."""
_POINTS = 300
_ANGLES = 8  # approach directions per pair of contacts, evenly about the closing axis
_DEPTH = 0.25  # the contacts lie within this share of the pad's length from its middle
_BESIDE = 1.5  # spacings of the points between a ray and the points that it is said to meet
_CHUNK = 2_000_000  # ray-face pairs computed at once


class ContactPairs(NamedTuple):
    """Pairs of opposite contacts."""

    first: Array
    """(C, 3) [m]."""
    direction: Array
    """Unit vectors from the first to the second (C, 3)."""
    width: Array
    """Distance of the two (C,) [m]."""


def propose(mesh: TriangleMesh, gripper: Gripper, settings: AntipodalSettings, rng: np.random.Generator) -> Pose:
    """Return poses X_OG (K,) of one round of antipodal sampling; nothing else about them is checked.

    From random points of the surface, rays go inwards within the friction cone. Wherever one comes out again,
    near enough for the jaws and within the friction cone there, is a second contact. Both together are tried
    with approach directions all around the closing axis and at a random depth between the pads.
    """
    points, normals = mesh.sample(rng, _POINTS)
    directions = within_cone(-normals, np.arctan(settings.friction), rng)
    ray, width, far_normals = exits(mesh, points, directions, gripper.max_opening - 2 * settings.clearance)
    antipodal = np.einsum("ci,ci->c", far_normals, directions[ray]) >= cone_cosine(settings.friction)
    ray, width = ray[antipodal], width[antipodal]
    return poses_across(ContactPairs(points[ray], directions[ray], width), gripper, rng)


def propose_on_points(
    surface: SurfacePoints, gripper: Gripper, settings: AntipodalSettings, rng: np.random.Generator
) -> Pose:
    """Return poses X_OG (K,) as `propose` does, for a surface that is known at points only.

    A ray meets the points within 1.5 spacings of it; of those that lie close together, one.
    """
    count, beside = min(_POINTS, len(surface.points)), _BESIDE * settings.spacing
    start = rng.choice(len(surface.points), count, replace=False)
    origins = surface.points[start]
    directions = within_cone(-surface.normals[start], np.arctan(settings.friction), rng)
    along = thin_product(directions, surface.points.T) - np.einsum("ri,ri->r", directions, origins)[:, None]
    square = (
        np.einsum("ri,ri->r", origins, origins)[:, None]
        + np.einsum("ni,ni->n", surface.points, surface.points)
        - 2.0 * thin_product(origins, surface.points.T)
    )
    longest = gripper.max_opening - 2 * settings.clearance
    hit = (along > 2.0 * beside) & (along < longest) & (square - along**2 < beside**2)
    hit &= thin_product(directions, surface.normals.T) >= cone_cosine(settings.friction)
    ray, point = np.nonzero(hit)
    width = along[ray, point]
    _, kept = np.unique(np.stack([ray, np.floor(width / (2.0 * beside))]), axis=1, return_index=True)
    ray, width = ray[kept], width[kept]
    return poses_across(ContactPairs(origins[ray], directions[ray], width), gripper, rng)


def poses_across(pairs: ContactPairs, gripper: Gripper, rng: np.random.Generator) -> Pose:
    """Return the poses (8 C,) at pairs of contacts: directions all around the closing axis, random depths."""
    y = np.repeat(pairs.direction, _ANGLES, axis=0)
    middle = np.repeat(pairs.first + 0.5 * pairs.width[:, None] * pairs.direction, _ANGLES, axis=0)
    count = len(pairs.width)
    turns = (np.tile(np.arange(_ANGLES), count) + np.repeat(rng.random(count), _ANGLES)) / _ANGLES
    z = _around(y, 2 * np.pi * turns)
    depth = _DEPTH * gripper.pad_size[1] * rng.uniform(-1.0, 1.0, len(z))
    R = np.stack([np.cross(y, z), y, z], axis=-1)
    return Pose(rotation.from_matrix(R), middle + depth[:, None] * z)


def within_cone(axes: Array, half_angle: float, rng: np.random.Generator) -> Array:
    """Return unit vectors (N, 3) within ``half_angle`` [rad] of unit vectors ``axes``, mostly near."""
    # Jaws that close far from a normal hold, but they turn the object first: half of all tilts are an eighth
    # of the cone at most.
    tilt, turn = half_angle * rng.random(len(axes)) ** 3, 2 * np.pi * rng.random(len(axes))
    return np.cos(tilt)[:, None] * axes + np.sin(tilt)[:, None] * _around(axes, turn)


def _around(axes: Array, angle: Array) -> Array:
    """Return unit vectors (N, 3) perpendicular to unit vectors ``axes``, at ``angle`` [rad] about them."""
    helper = np.eye(3)[np.argmin(np.abs(axes), axis=1)]
    u = np.cross(axes, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * np.cross(axes, u)


def exits(mesh: TriangleMesh, origins: Array, directions: Array, longest: float) -> tuple[np.ndarray, Array, Array]:
    """Return every crossing of rays (M, 3) through the surface from inside to outside.

    Returns:
        Index of the ray (C,), distance along it (C,) [m], in (0, ``longest``], and the outward unit normal
        there (C, 3).

    Source: T. Moeller, B. Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
    """
    step = max(1, _CHUNK // len(mesh.faces))
    found = [
        _exits(mesh, origins[i : i + step], directions[i : i + step], longest, i) for i in range(0, len(origins), step)
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
    u = thin_product(origins, u_axis.T) - np.einsum("fi,fi->f", a, u_axis) + t * thin_product(directions, u_axis.T)
    v = thin_product(origins, v_axis.T) - np.einsum("fi,fi->f", a, v_axis) + t * thin_product(directions, v_axis.T)
    ray, face = np.nonzero(usable & (t > 1e-6) & (t <= longest) & (u >= 0) & (v >= 0) & (u + v <= 1))
    return ray + offset, t[ray, face], normal[face] / np.sqrt(square[face])[:, None]
