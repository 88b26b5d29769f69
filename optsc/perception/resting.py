"""Stable resting poses of a rigid object on a table, and the turns that map its shape onto itself."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.geometry.rotation import Array
from optsc.perception.distance_field import DistanceField
from optsc.sampling.surface import is_closed

CONTINUOUS = 0
"""The order of symmetry of what looks the same at every angle."""
SAME = 0.002
"""A turned surface is the same if no more than one point in twenty is farther than this from it [m]."""

_ORDERS, _ANGLES = range(12, 1, -1), 29  # a prime number of angles: none of them is a multiple of a symmetry


def vertical_symmetry(points: Array, field: DistanceField, tolerance: float) -> int:
    """Return the order of symmetry about the z axis of O: 0 continuous, n: n-fold, 1: none.

    Args:
        points: of the surface (N, 3) [m], in O.
        tolerance: how far a turned point may lie off the surface [m]; 99 of 100 points have to comply.
    """

    def same(angle: float) -> bool:
        c, s = np.cos(angle), np.sin(angle)
        turned = points @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
        return bool(np.percentile(np.abs(field.lookup(turned)[0]), 99.0) <= tolerance)

    if all(same(2.0 * np.pi * k / _ANGLES) for k in range(1, _ANGLES)):
        return CONTINUOUS
    return next((n for n in _ORDERS if same(2.0 * np.pi / n)), 1)


def box_symmetries(points: Array, field: DistanceField) -> Pose:
    """Return the poses X_OS (K,) among the quarter and half turns about O's axes that map the shape onto itself.

    The turns are about the middle of the shape's box; the first of them is none.

    Args:
        points: of the surface (N, 3) [m], in O.
    """
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    found = []
    for R in _cube_rotations():
        X = Pose(rotation.from_matrix(R), centre - R @ centre)
        distance, _ = field.lookup(X.apply(points))
        if np.mean(np.abs(distance) > SAME) <= 0.05:
            found.append(X)
    return Pose.stack(found)


def turned_least(X_WO: Pose, X_before: Pose) -> Pose:
    """Return X_WO turned about its own z so that its rotation is nearest to that of X_before.

    With A = R_before' R the trace of A R_z(a) is cos a (A00 + A11) + sin a (A01 - A10) + A22, greatest at a below.
    """
    A = X_before.rotation_matrix().T @ X_WO.rotation_matrix()
    a = float(np.arctan2(A[0, 1] - A[1, 0], A[0, 0] + A[1, 1]))
    return X_WO @ Pose.from_rotation_vector([0.0, 0.0, a], np.zeros(3))


def _cube_rotations() -> list[Array]:
    """Return the 24 rotations (3, 3) that map a cube onto itself, the identity first."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            R = np.zeros((3, 3))
            R[range(3), order] = signs
            if np.linalg.det(R) > 0.0:
                found.append(R)
    return found


def resting_poses(
    mesh: TriangleMesh,
    symmetry: int,
    *,
    margin: float = 0.035,
    angle_tolerance: float = 0.12,
    minimum_solid_angle: float = 0.1,
) -> Pose:
    """Return the poses (K,) in which the object rests on z = 0, without yaw, the most probable first.

    A face of the convex hull is rested on if the centre of mass is above it by more than ``margin`` [rad] of tilt
    to either side. The solid angle under which the centre of mass sees the face says how readily it is landed on.
    Faces whose normals differ by less than ``angle_tolerance`` [rad], or by a symmetry about z, count once; those
    seen under less than ``minimum_solid_angle`` [sr] are left out, unless nothing else is stable.

    Raises:
        InvalidValue: the mesh encloses no volume.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(mesh.vertices)
    except QhullError as error:
        raise InvalidValue("volume of the mesh", 0.0, "above 0 m^3") from error
    centre = _centre_of_mass(mesh)
    kept: list[tuple[Array, float]] = []  # normal, solid angle
    for normal, angle, tilt in _facets(hull.points, hull.simplices, hull.equations, centre):
        if tilt <= margin:
            continue
        for i, (other, sum_of_angles) in enumerate(kept):
            if _equivalent(normal, other, symmetry, angle_tolerance):
                kept[i] = (other, sum_of_angles + angle)
                break
        else:
            kept.append((normal, angle))
    kept = sorted((e for e in kept if e[1] >= minimum_solid_angle), key=lambda e: -e[1]) or kept[:1]
    quaternions = np.array([_facing_down(normal) for normal, _ in kept]).reshape(-1, 4)
    lowest = [-rotation.rotate(q, mesh.vertices)[:, 2].min() for q in quaternions]
    translations = np.stack([np.zeros(len(kept)), np.zeros(len(kept)), np.array(lowest)], axis=-1)
    return Pose(quaternions, translations)


def _centre_of_mass(mesh: TriangleMesh) -> Array:
    """Return the centre of the enclosed volume (3,) [m]; that of the convex hull if the mesh is not closed."""
    vertices, faces = mesh.vertices, mesh.faces
    if not is_closed(mesh):
        from scipy.spatial import ConvexHull

        hull = ConvexHull(vertices)
        faces = hull.simplices.copy()
        corners = vertices[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inwards = (normal * hull.equations[:, :3]).sum(axis=1) < 0.0
        faces[inwards] = faces[inwards][:, ::-1]
    corners = vertices[faces] - mesh.centre
    volumes = np.linalg.det(corners)
    return mesh.centre + volumes @ corners.sum(axis=1) / (4.0 * volumes.sum())


def _facets(points: Array, simplices: np.ndarray, planes: Array, centre: Array) -> list[tuple[Array, float, float]]:
    """Return normal, solid angle and least tilt [rad] of each flat side of a hull, largest solid angle first.

    The tilt is that about the nearest edge at which the centre of mass leaves the side; below zero it already has.
    """
    _, side = np.unique(np.round(planes, 5), axis=0, return_inverse=True)
    found = []
    for index in range(side.max() + 1):
        of_side = side.reshape(-1) == index
        triangles, normal, offset = simplices[of_side], planes[of_side][0, :3], planes[of_side][0, 3]
        height = -float(normal @ centre + float(offset))
        foot = centre + height * normal
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        border, count = np.unique(edges, axis=0, return_counts=True)
        border = border[count == 1]
        middle = points[np.unique(triangles)].mean(axis=0)
        start, end = points[border[:, 0]], points[border[:, 1]]
        inwards = np.cross(normal, end - start)
        inwards *= np.sign((inwards * (middle - start)).sum(-1))[:, None]
        inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-12)
        inside = float((inwards * (foot - start)).sum(-1).min())
        angle = _solid_angle(points[triangles] - centre)
        found.append((normal, angle, float(np.arctan2(inside, height))))
    return sorted(found, key=lambda entry: -entry[1])


def _solid_angle(corners: Array) -> float:
    """Return the solid angle [sr] of triangles (T, 3, 3) seen from the origin (van Oosterom and Strackee, 1983)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    numerator = np.abs((a * np.cross(b, c)).sum(-1))
    denominator = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return float(2.0 * np.arctan2(numerator, denominator).sum())


def _equivalent(normal: Array, other: Array, symmetry: int, tolerance: float) -> bool:
    """Tell whether two directions agree within ``tolerance`` [rad] up to a symmetry about z."""
    if symmetry == CONTINUOUS:
        flat = np.array([np.hypot(normal[0], normal[1]), normal[2]])
        return bool(flat @ [np.hypot(other[0], other[1]), other[2]] > np.cos(tolerance))
    turns = 2.0 * np.pi * np.arange(symmetry) / symmetry
    x = normal[0] * np.cos(turns) - normal[1] * np.sin(turns)
    y = normal[0] * np.sin(turns) + normal[1] * np.cos(turns)
    return bool((x * other[0] + y * other[1] + normal[2] * other[2]).max() > np.cos(tolerance))


def _facing_down(normal: Array) -> Array:
    """Return the shortest turn that takes ``normal`` to -z."""
    axis = np.cross(normal, [0.0, 0.0, -1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(-normal[2])
    if sine < 1e-9:
        return np.array([1.0, 0.0, 0.0, 0.0]) if cosine > 0.0 else np.array([0.0, 1.0, 0.0, 0.0])
    return rotation.exp(axis / sine * np.arctan2(sine, cosine))
