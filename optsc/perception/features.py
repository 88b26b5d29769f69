"""Starts from matched features, for what neither rests on the table nor is found by trying: open3d, optional."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.perception.guesses import Guesses
from optsc.perception.templates import Template

_RUNS, _TRIES, _CONFIDENCE = 4, 20_000, 0.999


def feature_starts(template: Template, points: Array, voxel: float, seed: int = 0) -> Guesses:
    """Return starts (B) from fast point feature histograms (R. Rusu, N. Blodow, M. Beetz, 2009) matched by RANSAC.

    Args:
        template: the shape.
        points: measured (M, 3) [m], in W.
        voxel: both clouds are thinned to this [m].
        seed: same arguments and seed, same starts.

    Raises:
        InvalidValue: open3d cannot be imported.
    """
    o3d = _open3d()
    # open3d refuses read-only arrays, hence the copies.
    source, source_features = _described(o3d, np.array(template.points), voxel)
    target, target_features = _described(o3d, np.array(points), voxel)
    if len(target.points) < 10:
        return Guesses(np.zeros((0, 3, 3)), np.zeros((0, 3)))
    pipeline = o3d.pipelines.registration
    found = []
    for run in range(_RUNS):
        o3d.utility.random.seed(seed * _RUNS + run)
        result = pipeline.registration_ransac_based_on_feature_matching(
            target,
            source,
            target_features,
            source_features,
            True,
            2.0 * voxel,
            pipeline.TransformationEstimationPointToPoint(False),
            3,
            [
                pipeline.CorrespondenceCheckerBasedOnEdgeLength(0.85),
                pipeline.CorrespondenceCheckerBasedOnDistance(2.0 * voxel),
            ],
            pipeline.RANSACConvergenceCriteria(_TRIES, _CONFIDENCE),
        )
        found.append(np.linalg.inv(np.asarray(result.transformation)))
    M = np.stack(found)
    return Guesses(M[:, :3, :3].copy(), M[:, :3, 3].copy())


def _described(o3d: ModuleType, points: Array, voxel: float) -> tuple[Any, Any]:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(voxel)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(3.0 * voxel, 20))
    if len(cloud.points):
        # The sign of a normal is unknown on both sides; away from the middle is right for most of both.
        away = np.asarray(cloud.points) - np.asarray(cloud.points).mean(axis=0)
        normals = np.asarray(cloud.normals)
        flip = (normals * away).sum(axis=1) < 0.0
        cloud.normals = o3d.utility.Vector3dVector(np.where(flip[:, None], -normals, normals))
    search = o3d.geometry.KDTreeSearchParamHybrid(6.0 * voxel, 60)
    return cloud, o3d.pipelines.registration.compute_fpfh_feature(cloud, search)


def _open3d() -> ModuleType:
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise InvalidValue(
            "SearchSettings.features",
            True,
            f"False, or install the extra: pip install 'optsc[features]' ({error})",
        ) from error
    return open3d
