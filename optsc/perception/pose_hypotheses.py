"""Pose hypotheses: batches of poses of one template, and where a search begins.

The first hypotheses come from a template's resting poses, from all of SO(3), or from matched features (open3d,
optional), shifted so that what the template would show meets what was seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.perception.templates import Template

_POINTS = 200  # of a template that are placed to see where they would show
_WORTH_SHIFTING = 0.008  # [m]
_RANSAC_RUNS, _RANSAC_TRIES, _RANSAC_CONFIDENCE = 4, 20_000, 0.999


@dataclass(frozen=True, eq=False)
class PoseHypotheses:
    """Poses X_WO that a template may have: rotations (B, 3, 3) and positions (B, 3) [m]."""

    R: Array
    t: Array

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, index: object) -> PoseHypotheses:
        return PoseHypotheses(self.R[index], self.t[index])  # type: ignore[call-overload]

    @classmethod
    def of(cls, poses: Pose) -> PoseHypotheses:
        """Return a batch of poses (B,) as hypotheses."""
        return cls(poses.rotation_matrix(), np.array(poses.translation))

    @classmethod
    def joined(cls, parts: Sequence[PoseHypotheses]) -> PoseHypotheses:
        """Return the hypotheses of all ``parts``, in order; there may be none."""
        R, t = [np.zeros((0, 3, 3)), *(p.R for p in parts)], [np.zeros((0, 3)), *(p.t for p in parts)]
        return cls(np.concatenate(R), np.concatenate(t))

    def pose(self, index: int) -> Pose:
        """Return one hypothesis as a pose."""
        # The nearest rotation: products of many rotations drift by rounding.
        U, _, Vt = np.linalg.svd(self.R[index])
        return Pose(rotation.from_matrix(U @ Vt), self.t[index])

    def to_object(self, points_W: Array) -> Array:
        """Return points (M, 3) of W in the frame O of every hypothesis (B, M, 3)."""
        return (points_W[None] - self.t[:, None]) @ self.R

    def to_world(self, points_O: Array) -> Array:
        """Return points (M, 3) of O in W for every hypothesis (B, M, 3)."""
        return points_O[None] @ self.R.swapaxes(1, 2) + self.t[:, None]

    def moved(self, turn: Array, shift: Array, pivot: Array) -> PoseHypotheses:
        """Return the hypotheses turned by rotation vectors (B, 3) [rad] about ``pivot`` (3,) and shifted (B, 3) [m]."""
        Q = rotation.to_matrix(rotation.exp(turn))
        return PoseHypotheses(Q @ self.R, pivot + np.einsum("bij,bj->bi", Q, self.t - pivot) + shift)


def resting_starts(
    template: Template, points: Array, eye: Array, table_height: float, count: int, slack: float = 0.012
) -> PoseHypotheses:
    """Return starts (B) that rest on the table: resting poses x yaw angles x positions.

    The centre of what the template would show to the camera is put on the centre of what was seen. Where the template
    would show more than was seen, because something hides it, it is also shifted so that either end meets.

    Args:
        points: measured (M, 3) [m], in W.
        eye: position of the camera in W (3,) [m].
        count: of yaw angles.
        slack: a resting pose that is lower than the highest points by more than this is left out [m].
    """
    rest = template.resting.rotation_matrix()
    height = template.resting.translation[:, 2]
    tops = (template.points @ rest.swapaxes(1, 2))[..., 2].max(axis=1) + height
    tall = tops >= np.percentile(points[:, 2], 98.0) - table_height - slack
    parts = []
    for R, z in zip(rest[tall], height[tall], strict=True):
        upright = abs(R[2, 2]) > 1.0 - 1e-6
        if upright and template.round:
            yaws = _yaws(1)
        else:
            order = template.symmetry if upright else 1
            number = max(count // order, 1)
            yaws = _yaws(number * order)[:number]
        parts.append(_placed(yaws @ R, template, points, eye, table_height + z))
    return PoseHypotheses.joined(parts)


def free_starts(template: Template, points: Array, eye: Array, count: int, rng: np.random.Generator) -> PoseHypotheses:
    """Return starts with rotations from all of SO(3), for what rests on something else than the table."""
    R = rotation.to_matrix(rotation.random(rng, (count,)))
    return _placed(R, template, points, eye, None)


def _placed(R: Array, template: Template, points: Array, eye: Array, z: float | None) -> PoseHypotheses:
    """Return hypotheses with rotations (B, 3, 3), each at one to nine positions; ``z`` of O is given or follows too."""
    seen = points.mean(axis=0)
    sight = seen - eye
    sight /= np.linalg.norm(sight)
    axes = _horizontal(sight)
    shape = template.points[:_POINTS] @ R.swapaxes(1, 2)
    facing = np.clip(-(template.normals[:_POINTS] @ R.swapaxes(1, 2)) @ sight, 0.0, None)
    centre = (facing[..., None] * shape).sum(axis=1) / np.maximum(facing.sum(axis=1), 1e-9)[:, None]
    base = seen - centre
    if z is not None:
        base[:, 2] = z
    along = shape @ axes.T
    shown = np.where((facing > 0.05)[..., None], along, np.nan)
    low, high = np.nanmin(shown, axis=1), np.nanmax(shown, axis=1)
    low_seen, high_seen = np.percentile(points @ axes.T, [1.0, 99.0], axis=0)
    gap = (high - low) - (high_seen - low_seen)
    to_low, to_high = low_seen - (low + base @ axes.T), high_seen - (high + base @ axes.T)
    found = [PoseHypotheses(R, base)]
    for i in range(2):
        hidden = gap[:, i] > _WORTH_SHIFTING
        for shift in (to_low[:, i], to_high[:, i]):
            found.append(PoseHypotheses(R[hidden], (base + shift[:, None] * axes[i])[hidden]))
    both = (gap > _WORTH_SHIFTING).all(axis=1)
    for first in (to_low[:, 0], to_high[:, 0]):
        for second in (to_low[:, 1], to_high[:, 1]):
            moved = base + first[:, None] * axes[0] + second[:, None] * axes[1]
            found.append(PoseHypotheses(R[both], moved[both]))
    return PoseHypotheses.joined(found)


def _horizontal(sight: Array) -> Array:
    """Return two horizontal unit vectors (2, 3): across a line of sight, and along it."""
    across = np.cross(sight, [0.0, 0.0, 1.0])
    length = np.linalg.norm(across)
    across = across / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.stack([across, np.cross([0.0, 0.0, 1.0], across)])


def _yaws(count: int) -> Array:
    """Return rotations about z (count, 3, 3) by equal parts of a full turn."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return rotation.to_matrix(rotation.exp(angle[:, None] * np.array([0.0, 0.0, 1.0])))


def feature_starts(template: Template, points: Array, voxel: float, seed: int = 0) -> PoseHypotheses:
    """Return starts (B) from fast point feature histograms (R. Rusu, N. Blodow, M. Beetz, 2009) matched by RANSAC.

    Args:
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
        return PoseHypotheses.joined([])
    pipeline = o3d.pipelines.registration
    found = []
    for run in range(_RANSAC_RUNS):
        o3d.utility.random.seed(seed * _RANSAC_RUNS + run)
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
            pipeline.RANSACConvergenceCriteria(_RANSAC_TRIES, _RANSAC_CONFIDENCE),
        )
        found.append(np.linalg.inv(np.asarray(result.transformation)))
    M = np.stack(found)
    return PoseHypotheses(M[:, :3, :3].copy(), M[:, :3, 3].copy())


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
