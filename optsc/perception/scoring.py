"""Scores of pose hypotheses: are the seen points on the template, and is the template nowhere in free space?

And the error of a pose whose true value is known (ADD-S).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, Pose
from optsc.geometry.rotation import Array
from optsc.perception.pose_hypotheses import PoseHypotheses
from optsc.perception.templates import Template

_FACING = 0.1  # cosine; what is seen at a more grazing angle is seen or not by chance


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """A depth image prepared for asking about many points.

    Attributes:
        image: what was measured.
        front: (H, W) the nearest surface around each pixel [m]; NaN where the pixel was not measured.
        tolerance: how far a point has to be in front of what was measured to be seen through [m].
    """

    image: DepthImage
    front: Array
    tolerance: float

    def classify(self, points: Array) -> tuple[np.ndarray, np.ndarray]:
        """Return for points (..., 3) in W [m] whether each was seen through and whether it was seen, both (...) bool.

        Seen through: the camera measured something behind it, all around its pixel. Seen: it measured about its
        depth. Neither: something is in front, nothing was measured, or it is outside the image.
        """
        camera, X_WC = self.image.camera, self.image.X_WC
        local = (points - X_WC.translation) @ X_WC.rotation_matrix()
        z = local[..., 2]
        inverse = 1.0 / np.maximum(z, 1e-6)
        u = np.clip(camera.cx + camera.fx * local[..., 0] * inverse, -1.0, camera.width)
        v = np.clip(camera.cy + camera.fy * local[..., 1] * inverse, -1.0, camera.height)
        u, v = np.rint(u).astype(np.int32), np.rint(v).astype(np.int32)
        inside = (z > 1e-6) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        pixel = np.where(inside, v * camera.width + u, 0)
        with np.errstate(invalid="ignore"):
            through = inside & (self.front.ravel()[pixel] > z + self.tolerance)
            seen = inside & (np.abs(self.image.depth.ravel()[pixel] - z) <= self.tolerance)
        return through, seen


def free_space(
    image: DepthImage, robot_depth: Array | None = None, *, tolerance: float = 0.008, radius: int = 2
) -> FreeSpace:
    """Return what ``image`` says about free space.

    Args:
        robot_depth: (H, W) depth of the arm's own surface [m], infinite where it is not; it hides what is behind it
            even where the camera measured nothing.
        radius: half the side of the neighbourhood that has to be behind a point, in pixels: it forgives small errors
            of the pose at the edges of an object.

    Raises:
        InvalidValue: a robot_depth of another size than the image.
    """
    from scipy.ndimage import minimum_filter

    nearest = np.where(np.isnan(image.depth), np.inf, image.depth)
    if robot_depth is not None:
        if robot_depth.shape != nearest.shape:
            raise InvalidValue("robot_depth", robot_depth.shape, f"shape {nearest.shape}, that of the image")
        nearest = np.fmin(nearest, robot_depth)
    unknown = ~np.isfinite(nearest)
    front = minimum_filter(nearest, size=2 * radius + 1, mode="nearest")
    front[unknown] = np.nan
    return FreeSpace(image, front, float(tolerance))


@dataclass(frozen=True, eq=False)
class Fit:
    """How hypotheses (B) fit; all arrays (B,).

    Attributes:
        score: `closeness` less `violations`; 1 is perfect.
        closeness: mean over the seen points of max(0, 1 - (d / tolerance)^2), d the distance to the template.
        inliers: share of the seen points within the tolerance.
        residual: root mean square distance of those [m].
        violations: of the template's points that the camera saw or saw through, the share that it saw through,
            or that are below the table.
    """

    score: Array
    closeness: Array
    inliers: Array
    residual: Array
    violations: Array

    def __getitem__(self, index: object) -> Fit:
        arrays = (self.score, self.closeness, self.inliers, self.residual, self.violations)
        return Fit(*(a[index] for a in arrays))  # type: ignore[call-overload]


def closeness(hypotheses: PoseHypotheses, points: Array, template: Template, tolerance: float) -> Array:
    """Return the seen points' half of the score alone (B,): cheap enough for thousands of hypotheses."""
    d, _ = template.field.lookup(hypotheses.to_object(points))
    return np.clip(1.0 - (d / tolerance) ** 2, 0.0, None).mean(axis=1)


def fit(
    hypotheses: PoseHypotheses,
    points: Array,
    template: Template,
    space: FreeSpace,
    *,
    tolerance: float,
    table_height: float,
    count: int,
) -> Fit:
    """Return how ``hypotheses`` of ``template`` fit the measured ``points`` (M, 3) and the free space.

    Args:
        points: measured (M, 3) [m], in W.
        tolerance: how far a seen point may be from the surface [m].
        count: of the template's points to look for in the image.
    """
    d, _ = template.field.lookup(hypotheses.to_object(points))
    square = (d / tolerance) ** 2
    near = square <= 1.0
    inliers = near.mean(axis=1)
    residual = tolerance * np.sqrt((square * near).sum(axis=1) / np.maximum(near.sum(axis=1), 1))
    close = np.clip(1.0 - square, 0.0, None).mean(axis=1)
    placed = hypotheses.to_world(template.points[:count])
    through, seen = space.classify(placed)
    through |= placed[..., 2] < table_height - space.tolerance
    violations = through.sum(axis=1) / np.maximum((through | seen).sum(axis=1), 1)
    return Fit(close - violations, close, inliers, residual, violations)


def shape_distance(hypotheses: PoseHypotheses, other: PoseHypotheses, template: Template, count: int = 300) -> Array:
    """Return how far the template's surface at ``other`` (one pose) sticks out of that at ``hypotheses`` (B,) [m].

    The mean over the twentieth of the points that sticks out farthest, in the worse of the two directions: zero for
    poses that a symmetry makes equal, and large for a mug whose handle alone has turned.
    """
    points = template.points[:count]
    there = other.to_world(points)[0]
    out, _ = template.field.lookup(hypotheses.to_object(there))
    back, _ = template.field.lookup((hypotheses.to_world(points) - other.t[0]) @ other.R[0])
    worst = max(count // 20, 1)
    return np.maximum(*(np.sort(np.abs(d), axis=1)[:, -worst:].mean(axis=1) for d in (out, back)))


def self_visible(template: Template, pose: PoseHypotheses, space: FreeSpace) -> np.ndarray:
    """Return which points (N,) bool of a template at one pose the camera would see were nothing else there.

    Those that face it and have no other point of the template in front, in an image whose pixels are as large as the
    points are apart.
    """
    camera, X_WC = space.image.camera, space.image.X_WC
    local = X_WC.inverse().apply(pose.to_world(template.points)[0])
    normals = template.normals @ pose.R[0].T @ X_WC.rotation_matrix()
    z = local[:, 2]
    facing = -(normals * local).sum(axis=1) > _FACING * np.linalg.norm(local, axis=1)
    if not (z > 1e-6).all():
        return np.zeros(len(z), dtype=bool)
    pixel = 1.5 * template.spacing * camera.fx / float(np.median(z))
    u, v, _ = camera.project(local)
    column, row = (np.floor((a - a.min()) / pixel).astype(int) + 1 for a in (u, v))
    nearest = np.full((row.max() + 2, column.max() + 2), np.inf)
    np.minimum.at(nearest, (row[facing], column[facing]), z[facing])
    return np.asarray(facing & (z <= nearest[row, column] + 1.5 * space.tolerance))


def visible_fraction(template: Template, pose: PoseHypotheses, space: FreeSpace) -> float:
    """Return the share of what the camera would see of the template alone that it did see, 0 to 1."""
    points = pose.to_world(template.points)[0]
    shown = self_visible(template, pose, space)
    _, seen = space.classify(points)
    towards = space.image.X_WC.translation - points
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    # The area in the image that each point stands for, but for a factor.
    area = np.clip(((template.normals @ pose.R[0].T) * towards).sum(axis=1), 0.0, None)
    total = area[shown].sum()
    return float(area[shown & seen].sum() / total) if total > 0.0 else 0.0


def add_s(points: Array, X_true: Pose, X_found: Pose) -> float:
    """Return ADD-S [m]: the mean distance from each true point to the nearest found one.

    mean over p of min over p' of |X_true p - X_found p'| (S. Hinterstoisser et al., 2012, equation 7; the name is
    that of Y. Xiang et al., PoseCNN, 2018). It does not see a difference that the shape does not show.

    Args:
        points: of the model's surface (N, 3) [m], in O, evenly spread.
        X_true, X_found: poses of O in one and the same frame.

    Raises:
        InvalidValue: no points.
    """
    from scipy.spatial import cKDTree

    if points.ndim != 2 or points.shape[1:] != (3,) or len(points) == 0:
        raise InvalidValue("points of the model", points.shape, "shape (N, 3), at least one point")
    nearest, _ = cKDTree(X_found.apply(points)).query(X_true.apply(points))
    return float(nearest.mean())
