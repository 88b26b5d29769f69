"""Errors of registered poses, from surface to surface: ADD-S owes much of its value to the spacing of its points."""

from __future__ import annotations

import numpy as np

from optsc.geometry import Pose
from optsc.perception import Template


def surface_distance(template: Template, X_true: Pose, X_found: Pose) -> float:
    """Return ADD-S [m] for infinitely many found points: the mean distance from the true points to the found surface.

    Without the share that ADD-S owes to the spacing of its points, about a third of it, where a symmetry turns them.
    """
    d, _ = template.field.lookup((X_found.inverse() @ X_true).apply(template.points))
    return float(np.abs(d).mean())


def surface_tail(template: Template, X_true: Pose, X_found: Pose) -> float:
    """Return how far the twentieth of the surface sticks out that does so farthest [m], in the worse direction.

    ADD-S averages over the whole surface: a mug whose handle points elsewhere is 1 to 2 mm off by it, but about
    20 mm by this.
    """
    X = X_found.inverse() @ X_true
    worst = max(len(template.points) // 20, 1)
    out, _ = template.field.lookup(X.apply(template.points))
    back, _ = template.field.lookup(X.inverse().apply(template.points))
    return float(max(np.sort(np.abs(d))[-worst:].mean() for d in (out, back)))
