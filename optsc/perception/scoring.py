"""How well guesses of a pose explain a view, in both directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optsc.geometry.rotation import Array
from optsc.perception.freespace import FreeSpace
from optsc.perception.guesses import Guesses
from optsc.perception.templates import Template


@dataclass(frozen=True, eq=False)
class Fit:
    """How guesses (B) fit; all arrays (B,).

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


def closeness(guesses: Guesses, points: Array, template: Template, tolerance: float) -> Array:
    """Return the seen points' half of the score alone (B,): cheap enough for thousands of guesses."""
    d, _ = template.field.lookup(guesses.to_object(points))
    return np.clip(1.0 - (d / tolerance) ** 2, 0.0, None).mean(axis=1)


def fit(
    guesses: Guesses,
    points: Array,
    template: Template,
    space: FreeSpace,
    *,
    tolerance: float,
    table_height: float,
    count: int,
) -> Fit:
    """Return how ``guesses`` of ``template`` fit the measured ``points`` (M, 3) and the free space.

    Args:
        guesses: X_WO.
        points: measured (M, 3) [m], in W.
        template: the shape.
        space: what the image says about free space.
        tolerance: how far a seen point may be from the surface [m].
        table_height: of the table in W [m].
        count: of the template's points to look for in the image.
    """
    d, _ = template.field.lookup(guesses.to_object(points))
    square = (d / tolerance) ** 2
    near = square <= 1.0
    inliers = near.mean(axis=1)
    residual = tolerance * np.sqrt((square * near).sum(axis=1) / np.maximum(near.sum(axis=1), 1))
    close = np.clip(1.0 - square, 0.0, None).mean(axis=1)
    placed = guesses.to_world(template.points[:count])
    through, seen = space.judge(placed)
    through |= placed[..., 2] < table_height - space.tolerance
    violations = through.sum(axis=1) / np.maximum((through | seen).sum(axis=1), 1)
    return Fit(close - violations, close, inliers, residual, violations)


def shape_distance(guesses: Guesses, other: Guesses, template: Template, count: int = 300) -> Array:
    """Return how far the template's surface at ``other`` (one guess) sticks out of that at ``guesses`` (B,) [m].

    The mean over the twentieth of the points that sticks out farthest, in the worse of the two directions: zero for
    poses that a symmetry makes equal, and large for a mug whose handle alone has turned.
    """
    points = template.points[:count]
    there = other.to_world(points)[0]
    out, _ = template.field.lookup(guesses.to_object(there))
    back, _ = template.field.lookup((guesses.to_world(points) - other.t[0]) @ other.R[0])
    worst = max(count // 20, 1)
    return np.maximum(*(np.sort(np.abs(d), axis=1)[:, -worst:].mean(axis=1) for d in (out, back)))
