"""Fitting capsules: few round bodies of little volume that hold every point of a set of triangles.

A capsule is the set of points within a radius of a segment. Distances between capsules have closed forms and change
smoothly with the configuration, which distances between polyhedra do not. A capsule holds a triangle when it holds
the corners, so a link is covered by giving each of its triangles to one capsule.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from optsc.geometry.rotation import Array

MOST_CAPSULES = 3
"""Capsules that a link gets at most."""
WORTH = 0.9
"""One more capsule has to bring the volume of a link down to this share."""
GRID = 24
"""Points along each side of the grid that volumes of unions are counted on."""
ROUNDS = 4
"""Times that triangles are dealt out again among the capsules of a link."""
FIT_STEPS = 200
"""Trials in fitting one capsule."""
LONGEST_EDGE = 0.03
"""Triangles are cut until their edges are no longer [m], so that they fit into one of several capsules."""
ROUNDING = 1e-9
"""Added to a radius [m], so that rounding cannot leave a point outside."""


class Capsule(NamedTuple):
    """The points within ``radius`` [m] of the segment from ``a`` to ``b``, (3,) [m]."""

    a: Array
    b: Array
    radius: float

    @property
    def volume(self) -> float:
        """[m^3]."""
        length = float(np.linalg.norm(self.b - self.a))
        return np.pi * self.radius**2 * (length + 4.0 / 3.0 * self.radius)


def distance_to_segment(points: Array, a: Array, b: Array) -> Array:
    """Return the distances (N,) of points (N, 3) from the segment a to b."""
    along = b - a
    t = np.clip((points - a) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
    return np.linalg.norm(points - a - t[:, None] * along, axis=1)


def _around(points: Array, axis: Array, shift: Array, spare: float) -> Capsule:
    """Return the shortest capsule about the line through ``shift`` along ``axis`` that holds the points.

    Its radius is the greatest distance from the line, and ``spare`` more, which makes it shorter.
    """
    axis = axis / np.linalg.norm(axis)
    relative = points - shift
    z = relative @ axis
    square = np.maximum(np.einsum("ij,ij->i", relative, relative) - z * z, 0.0)
    radius = float(np.sqrt(square.max())) * (1.0 + abs(spare)) + ROUNDING
    cap = np.sqrt(radius * radius - square)
    low, high = float((z + cap).min()), float((z - cap).max())
    if low > high:
        low = high = 0.5 * (low + high)
        radius = float(np.linalg.norm(relative - low * axis, axis=1).max()) + ROUNDING
    return Capsule(shift + low * axis, shift + high * axis, radius)


def _rough_capsule(points: Array) -> tuple[Capsule, Array]:
    """Return the least of the capsules along the three main directions of the points, and its frame (3, 3)."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    frame = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    capsules = [_around(points, axis, centre, 0.0) for axis in frame]
    best = int(np.argmin([c.volume for c in capsules]))
    return capsules[best], np.roll(frame, -best, axis=0)


def fit_capsule(points: Array) -> Capsule:
    """Return a capsule of (locally) least volume that holds points (N, 3) [m]."""
    from scipy.optimize import minimize

    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    scale = max(float(np.ptp(points, axis=0).max()), 1e-6)
    rough, (axis, u, v) = _rough_capsule(points)

    def candidate(x: Array) -> Capsule:
        return _around(points, axis + x[0] * u + x[1] * v, centre + scale * (x[2] * u + x[3] * v), x[4])

    start = np.vstack([np.zeros(5), 0.1 * np.eye(5)])
    options = {"maxfev": FIT_STEPS, "initial_simplex": start, "xatol": 1e-4, "fatol": 1e-12}
    found = minimize(lambda x: candidate(x).volume, start[0], method="Nelder-Mead", options=options)
    return min(candidate(found.x), rough, key=lambda capsule: capsule.volume)


def _corner_points(triangles: Array) -> Array:
    """Return the extreme points among the corners of triangles (F, 3, 3)."""
    from scipy.spatial import ConvexHull, QhullError

    points = np.unique(triangles.reshape(-1, 3), axis=0)
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points


def _dealt(triangles: Array, capsules: Sequence[Capsule]) -> np.ndarray:
    """Return for each triangle the capsule that it sticks out of least."""
    out = [
        (distance_to_segment(triangles.reshape(-1, 3), c.a, c.b) / c.radius).reshape(-1, 3).max(axis=1)
        for c in capsules
    ]
    return np.argmin(out, axis=0)


def _cut(triangles: Array, count: int, direction: Array) -> np.ndarray:
    """Return the slice of ``count`` equal ones across a direction that each triangle's centre is in."""
    z = triangles.mean(axis=1) @ direction
    share = (z - z.min()) / max(float(np.ptp(z)), 1e-12)
    return np.minimum((share * count).astype(int), count - 1)


def _split(triangles: Array, longest: float) -> Array:
    """Return the triangles (F, 3, 3) with every edge longer than ``longest`` halved, again and again."""
    while True:
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        long = edges.max(axis=1) > longest
        if not long.any():
            return triangles
        rows, k = np.flatnonzero(long), edges[long].argmax(axis=1)
        a, b, c = (triangles[rows, (k + shift) % 3] for shift in range(3))
        middle = 0.5 * (a + b)
        halves = (np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1))
        triangles = np.concatenate([triangles[~long], *halves])


def _covered_by(triangles: Array, count: int) -> list[Capsule]:
    """Return ``count`` capsules of little volume that hold all triangles."""
    best, best_group = np.inf, np.zeros(len(triangles), dtype=int)
    axes = np.linalg.svd(triangles.reshape(-1, 3) - triangles.mean(axis=(0, 1)), full_matrices=False)[2]
    for direction in axes if count > 1 else axes[:1]:
        group = _cut(triangles, count, direction)
        for _ in range(ROUNDS):
            parts = [triangles[group == k] for k in range(count)]
            capsules = [_rough_capsule(_corner_points(part))[0] for part in parts if len(part)]
            if _volume(capsules) < best:
                best, best_group = _volume(capsules), group
            dealt = _dealt(triangles, capsules)
            if len(capsules) < count or np.array_equal(dealt, group):
                break
            group = dealt
    groups = [triangles[best_group == k] for k in range(count)]
    return [fit_capsule(_corner_points(group)) for group in groups if len(group)]


def _volume(capsules: Sequence[Capsule]) -> float:
    return sum(c.volume for c in capsules)


def cover(triangles: Array, most: int = MOST_CAPSULES) -> list[Capsule]:
    """Return up to ``most`` capsules that together hold all triangles (F, 3, 3) [m].

    More than one only where that saves much of the volume.
    """
    fine = _split(triangles, LONGEST_EDGE)
    covers = [_covered_by(fine, count) for count in range(1, most + 1)]
    return min(covers, key=lambda capsules: _union_volume(capsules) / WORTH ** len(capsules))


def _union_volume(capsules: Sequence[Capsule]) -> float:
    """Return the volume [m^3] of a union, counted on a grid."""
    reach = np.array([[c.a - c.radius, c.a + c.radius, c.b - c.radius, c.b + c.radius] for c in capsules])
    low, high = reach.min(axis=(0, 1)), reach.max(axis=(0, 1))
    sides = [np.linspace(low[k], high[k], GRID) for k in range(3)]
    points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.any([distance_to_segment(points, c.a, c.b) <= c.radius for c in capsules], axis=0)
    return float(inside.mean() * np.prod(high - low))
