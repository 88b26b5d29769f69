"""How far a registered pose is from the true one."""

from __future__ import annotations

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.perception.templates import Template


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


def surface_distance(template: Template, X_true: Pose, X_found: Pose) -> float:
    """Return ADD-S [m] for infinitely many found points: the mean distance from the true points to the found surface.

    Without the share that ADD-S owes to the spacing of its points, about a third of it, where a symmetry turns them.
    """
    d, _ = template.field.lookup((X_found.inverse() @ X_true).apply(template.points))
    return float(np.abs(d).mean())


def surface_tail(template: Template, X_true: Pose, X_found: Pose) -> float:
    """Return how far the twentieth of the surface sticks out that does so farthest [m], in the worse direction.

    ADD-S averages over the whole surface: a mug whose handle points the wrong way is 1 to 2 mm off by it, but about
    20 mm by this.
    """
    X = X_found.inverse() @ X_true
    worst = max(len(template.points) // 20, 1)
    out, _ = template.field.lookup(X.apply(template.points))
    back, _ = template.field.lookup(X.inverse().apply(template.points))
    return float(max(np.sort(np.abs(d))[-worst:].mean() for d in (out, back)))
