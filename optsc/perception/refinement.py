"""Pose refinement by ICP: many hypotheses at once on the distance field, or the best few by small_gicp.

The distance field gives the foot of every point without a search for neighbours, so one Gauss-Newton step of
hundreds of hypotheses is a handful of array operations.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from optsc.geometry.rotation import Array
from optsc.perception.distance_field import DistanceField
from optsc.perception.pose_hypotheses import PoseHypotheses
from optsc.perception.templates import Template

if TYPE_CHECKING:
    from small_gicp import KdTree, PointCloud

PLANAR = (0, 1, 5)
"""Shift along x and y and turn about z: how an object moves that keeps resting on the table."""
FREE = (0, 1, 2, 3, 4, 5)
"""All of position and rotation."""

Method = Literal["gicp", "plane", "field"]

_LONGEST_SHIFT, _LARGEST_TURN = 0.02, 0.35  # [m], [rad] of one step
_NEIGHBOURS = 10
_FIELD_REACHES = (1.0, 1.0, 0.8, 0.8, 0.6, 0.6)


def align(
    hypotheses: PoseHypotheses,
    points: Array,
    field: DistanceField,
    reaches: tuple[float, ...],
    *,
    freedom: tuple[int, ...] = PLANAR,
) -> PoseHypotheses:
    """Return the hypotheses after one Gauss-Newton step per entry of ``reaches``.

    Minimised is the sum of w d^2 over the points, d their signed distance to the surface and w Tukey's weight
    (1 - (d / reach)^2)^2 within ``reach``, 0 beyond. Linearised with a shift u and a turn r about the points' centre c,
    d changes by -g (u + r x (p - c)), g the outward gradient in W.

    Args:
        points: measured (M, 3) [m], in W.
        reaches: from far to near [m].
        freedom: which of shift and turn (x, y, z, x, y, z) may change.
    """
    pivot = points.mean(axis=0)
    index = list(freedom)
    for reach in reaches:
        H, b = normal_equations(hypotheses, points, field, reach, pivot)
        H, b = H[:, index][:, :, index], b[:, index]
        damping = 1e-3 * np.trace(H, axis1=1, axis2=2)[:, None, None] / len(index) * np.eye(len(index))
        # So that damping means the same to a turn and to a shift.
        scale = np.where(np.array(index) < 3, 1.0, 0.05)
        step = np.linalg.solve(H + damping * scale**2 + 1e-12 * np.eye(len(index)), b[..., None])[..., 0]
        whole = np.zeros((len(hypotheses), 6))
        whole[:, index] = step
        turn, shift = _limited(whole[:, 3:], _LARGEST_TURN), _limited(whole[:, :3], _LONGEST_SHIFT)
        hypotheses = hypotheses.moved(turn, shift, pivot)
    return hypotheses


def normal_equations(
    hypotheses: PoseHypotheses, points: Array, field: DistanceField, reach: float, pivot: Array
) -> tuple[Array, Array]:
    """Return H (B, 6, 6) and b (B, 6) of the weighted least squares, for shift and turn about ``pivot``."""
    d, g = field.lookup(hypotheses.to_object(points))
    gradient = g @ hypotheses.R.swapaxes(1, 2)
    weight = np.clip(1.0 - (d / reach) ** 2, 0.0, None) ** 2
    rows = np.concatenate([gradient, np.cross((points - pivot)[None], gradient)], axis=-1)
    weighted = rows * weight[..., None]
    return weighted.swapaxes(1, 2) @ rows, (weighted * d[..., None]).sum(axis=1)


def _limited(vector: Array, longest: float) -> Array:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector * np.minimum(1.0, longest / np.maximum(length, 1e-12))


def refine(
    hypotheses: PoseHypotheses,
    points: Array,
    template: Template,
    method: Method,
    reach: float,
    iterations: int = 20,
) -> PoseHypotheses:
    """Return the hypotheses after ICP.

    Args:
        points: measured (M, 3) [m], in W.
        method: ``gicp``: plane to plane (A. Segal, D. Haehnel, S. Thrun, Generalized-ICP, 2009); ``plane``: point to
            plane, both of small_gicp against the template's points; ``field``: point to exact surface, on the
            distance field.
        reach: pairs farther apart do not count [m].
        iterations: at most, of small_gicp.
    """
    if method == "field":
        return align(hypotheses, points, template.field, tuple(reach * r for r in _FIELD_REACHES), freedom=FREE)
    import small_gicp

    target, tree = _target(template)
    source = small_gicp.PointCloud(points)
    small_gicp.estimate_covariances(source, num_neighbors=_NEIGHBOURS, num_threads=1)
    R, t = np.array(hypotheses.R), np.array(hypotheses.t)
    for i in range(len(hypotheses)):
        start = np.eye(4)
        start[:3, :3], start[:3, 3] = R[i].T, -R[i].T @ t[i]
        result = small_gicp.align(
            target,
            source,
            tree,
            start,
            registration_type="GICP" if method == "gicp" else "PLANE_ICP",
            max_correspondence_distance=reach,
            num_threads=1,
            max_iterations=iterations,
            rotation_epsilon=1e-4,
            translation_epsilon=1e-5,
        )
        T = result.T_target_source
        if np.all(np.isfinite(T)):
            R[i], t[i] = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
    return PoseHypotheses(R, t)


def covariance(
    hypothesis: PoseHypotheses,
    points: Array,
    template: Template,
    tolerance: float,
    noise: float,
    footprint: float,
) -> Array:
    """Return the covariance (6, 6) of a pose: shift of O's origin [m], then turn [rad], both along W's axes.

    With H the Hessian of half the sum of squared distances, each divided by the variance s^2 of a distance:
    (H / s^2 + P)^-1, where P stands for what is known before the fit: that the position is good to `footprint` and
    that a turn is not further off than half a turn. So what the view does not settle has a large variance instead of
    none; what a template's continuous symmetry leaves open, such as the turn of a can, is taken out of H.

    Args:
        points: measured (M, 3) [m], in W, independent of each other.
        tolerance: distances up to this count [m].
        noise: least standard deviation of a distance [m].
        footprint: standard deviation of the position without the fit [m].
    """
    H, _ = normal_equations(hypothesis, points, template.field, tolerance, hypothesis.t[0])
    if template.round:
        # The facets of a round shape and the noise of its gradients must not pass for knowledge of its turn.
        axis = np.concatenate([np.zeros(3), hypothesis.R[0, :, 2]])
        blind = np.eye(6) - np.outer(axis, axis)
        H = blind @ H @ blind
    d, _ = template.field.lookup(hypothesis.to_object(points))
    near = np.abs(d[0]) <= tolerance
    s = max(noise, float(np.sqrt(np.mean(d[0][near] ** 2)))) if near.any() else tolerance
    prior = np.diag([footprint**-2.0] * 3 + [np.pi**-2.0] * 3)
    C = np.linalg.inv(H[0] / s**2 + prior)
    return 0.5 * (C + C.T)


@lru_cache(maxsize=64)
def _target(template: Template) -> tuple[PointCloud, KdTree]:
    import small_gicp

    cloud = small_gicp.PointCloud(np.array(template.points))
    small_gicp.estimate_normals_covariances(cloud, num_neighbors=_NEIGHBOURS, num_threads=1)
    return cloud, small_gicp.KdTree(cloud)
