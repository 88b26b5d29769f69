"""Shape completion: the seen points, and the rest as the template has it, each point marked (compensated cloud)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from optsc.checks import Positive, require
from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PointCloud, Pose, TriangleMesh, rotation
from optsc.geometry.rotation import Array
from optsc.perception.scoring import free_space
from optsc.perception.templates import Template
from optsc.sampling.surface import mesh_area

SPACING = 0.0025
"""From one filled-in point to the next [m]: the density that the search for grasps on clouds needs."""
COMMON = 0.006
"""Points of one explanation of a view count as common where every other has its surface within this distance [m]."""

_TRIES = 8.0  # random points for each that is kept
_MOST = 200_000  # points that are filled in at most


def complete_cloud(
    cloud_W: PointCloud,
    template: Template,
    X_WO: Pose,
    *,
    image: DepthImage | None = None,
    robot_depth: Array | None = None,
    alternatives: Sequence[Pose] = (),
    spacing: float = SPACING,
    distance: float = 0.004,
    outlier: float = 0.010,
) -> PointCloud:
    """Return the seen points and the template's unseen ones in O, with normals and `PointCloud.seen`.

    A point of the template is added if no seen point is within ``distance`` and the camera did not see through it.
    Where the seen points have normals, only those that face the same side count: of a thin wall, one side is seen.

    Args:
        cloud_W: measured points, in W.
        X_WO: where it was registered.
        image: what was measured; without it no point of the template is left out for being seen through.
        alternatives: other poses of the same template that explain the view as well: what they do not agree about, such
            as a mug's hidden handle, is not filled in.
        spacing: from one point of the template to the next, about [m].
        distance: how far a seen point speaks for its surroundings [m].
        outlier: seen points farther from the template than this belong to something else and are left out [m].

    Raises:
        InvalidValue: a length that is not above 0, a ``spacing`` that takes too many points, or a batch of poses.
    """
    for name, value in (("spacing", spacing), ("distance", distance), ("outlier", outlier)):
        require(name, value, Positive)
    if X_WO.shape != ():
        raise InvalidValue("X_WO", X_WO.shape, "a single pose")
    points = X_WO.inverse().apply(cloud_W.points).reshape(-1, 3)
    d, gradient = template.field.lookup(points)
    near = np.abs(d) <= outlier
    if cloud_W.normals is not None:
        normals = rotation.rotate(rotation.conjugate(X_WO.quaternion), cloud_W.normals)
    else:
        normals = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)
    surface, outward = even_points(template.mesh, spacing)
    facing = normals[near] if cloud_W.normals is not None else None
    missing = ~_near_seen(surface, outward, points[near], facing, distance)
    for other in alternatives:
        there, _ = template.field.lookup((other.inverse() @ X_WO).apply(surface))
        missing &= np.abs(there) <= COMMON
    if image is not None:
        through, _ = free_space(image, robot_depth).classify(X_WO.apply(surface))
        missing &= ~through
    return PointCloud(
        np.concatenate([points[near], surface[missing]]),
        np.concatenate([normals[near], outward[missing]]),
        np.repeat([True, False], [near.sum(), missing.sum()]),
    )


@lru_cache(maxsize=32)
def even_points(mesh: TriangleMesh, spacing: float) -> tuple[Array, Array]:
    """Return points (N, 3) about ``spacing`` [m] apart all over a surface, and their outward normals (N, 3).

    Of random points, one for each cube of that size and each of the six directions that a surface can mostly face:
    both sides of a thin wall have theirs. The same input gives the same points.

    Raises:
        InvalidValue: more than 200000 points would be needed.
    """
    area = mesh_area(mesh)
    if area > _MOST * spacing**2:
        raise InvalidValue("spacing", spacing, f"at least {np.sqrt(area / _MOST):.2g} m for at most {_MOST} points")
    points, normals = mesh.sample(np.random.default_rng(0), int(np.ceil(_TRIES * area / spacing**2)))
    cubes = np.floor(points / spacing)
    axis = np.argmax(np.abs(normals), axis=1)
    side = 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0.0)
    off = np.abs(points - (cubes + 0.5) * spacing).max(axis=1)
    order = np.argsort(off, kind="stable")  # what is nearest to the middle of its cube comes first
    cells = np.concatenate([cubes, side[:, None]], axis=1)[order]
    _, first = np.unique(cells, axis=0, return_index=True)
    kept = np.sort(order[first])
    result = points[kept], normals[kept]
    for array in result:
        array.flags.writeable = False
    return result


def _near_seen(points: Array, outward: Array, seen: Array, facing: Array | None, distance: float) -> np.ndarray:
    """Return which points (N, 3) have a seen one within ``distance`` [m], facing the same side if that is known.

    At right angles two surfaces are as far apart as ``distance`` along them: p and n distance/sqrt(2) are compared.
    """
    from scipy.spatial import cKDTree

    if len(seen) == 0:
        return np.zeros(len(points), dtype=bool)
    if facing is not None:
        weight = distance / np.sqrt(2.0)
        seen, points = np.hstack([seen, weight * facing]), np.hstack([points, weight * outward])
    return cKDTree(seen).query(points, distance_upper_bound=distance)[0] <= distance
