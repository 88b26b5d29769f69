"""The compensated cloud: what was seen, and the rest as the template has it, each point marked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PointCloud, Pose, rotation
from optsc.geometry.rotation import Array
from optsc.perception.freespace import free_space
from optsc.perception.templates import Template


def completed(
    cloud_W: PointCloud,
    template: Template,
    X_WO: Pose,
    *,
    image: DepthImage | None = None,
    robot_depth: Array | None = None,
    alternatives: Sequence[Pose] = (),
    distance: float = 0.006,
    outlier: float = 0.010,
) -> PointCloud:
    """Return the seen points and the template's unseen ones in O, with normals and `PointCloud.seen`.

    A point of the template is added if no seen point is within ``distance`` and the camera did not see through it.

    Args:
        cloud_W: measured points, in W.
        template: the shape.
        X_WO: where it was registered.
        image: what was measured; without it no point of the template is left out for being seen through.
        robot_depth: see `free_space`.
        alternatives: other poses of the same template that explain the view as well: what they do not agree about, such
            as a mug's handle that nobody saw, is not filled in.
        distance: about the spacing of the template's points [m].
        outlier: seen points farther from the template than this belong to something else and are left out [m].

    Raises:
        InvalidValue: a distance that is not above 0, or a batch of poses.
    """
    from scipy.spatial import cKDTree

    for name, value in (("distance", distance), ("outlier", outlier)):
        if not 0.0 < value < float("inf"):
            raise InvalidValue(name, value, "finite, more than 0 m")
    if X_WO.shape != ():
        raise InvalidValue("X_WO", X_WO.shape, "a single pose")
    points = X_WO.inverse().apply(cloud_W.points).reshape(-1, 3)
    d, gradient = template.field.lookup(points)
    near = np.abs(d) <= outlier
    if cloud_W.normals is not None:
        normals = rotation.rotate(rotation.conjugate(X_WO.quaternion), cloud_W.normals)
    else:
        normals = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)
    missing = np.ones(len(template.points), dtype=bool)
    if near.any():
        missing = cKDTree(points[near]).query(template.points, distance_upper_bound=distance)[0] > distance
    for other in alternatives:
        there, _ = template.field.lookup((other.inverse() @ X_WO).apply(template.points))
        missing &= np.abs(there) <= distance
    if image is not None:
        through, _ = free_space(image, robot_depth).judge(X_WO.apply(template.points))
        missing &= ~through
    return PointCloud(
        np.concatenate([points[near], template.points[missing]]),
        np.concatenate([normals[near], template.normals[missing]]),
        np.concatenate([np.ones(int(near.sum()), dtype=bool), np.zeros(int(missing.sum()), dtype=bool)]),
    )
