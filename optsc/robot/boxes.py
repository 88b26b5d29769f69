"""Boxes around convex parts: few bodies that hold an obstacle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import TriangleMesh
from optsc.geometry.rotation import Array

FLAT = 1e-6
"""A part whose points lie within this distance of a plane [m] has no volume."""
FILL = 1.1
"""Two boxes become one where that takes up no more than this times the volume of both."""
TURNS = 18
"""Directions about the vertical that a box is tried in."""


def box_around(points: Array) -> tuple[Array, Array, Array]:
    """Return rotation (3, 3), centre (3,) and half extents (3,) [m] of a small box that holds points (N, 3).

    The least of the boxes along the main directions and of those that stand upright in the points' own frame.
    """
    angle = np.arange(TURNS) * (0.5 * np.pi / TURNS)
    upright = np.zeros((TURNS, 3, 3))
    upright[:, 0, 0] = upright[:, 1, 1] = np.cos(angle)
    upright[:, 1, 0], upright[:, 0, 1] = np.sin(angle), -np.sin(angle)
    upright[:, 2, 2] = 1.0
    main = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2].T
    main = main * np.sign(np.linalg.det(main))
    frames = np.concatenate([upright, main[None]])
    local = points @ frames  # (F, N, 3)
    low, high = local.min(axis=1), local.max(axis=1)
    best = int(np.argmin(np.prod(high - low, axis=1)))
    return frames[best], frames[best] @ (0.5 * (low + high)[best]), 0.5 * (high - low)[best]


class _Group(NamedTuple):
    """Points and the box around them."""

    points: Array
    box: tuple[Array, Array, Array]

    @property
    def volume(self) -> float:
        return float(8.0 * np.prod(self.box[2]))

    def with_other(self, other: _Group) -> _Group:
        return _group(np.concatenate([self.points, other.points]))


def _group(points: Array) -> _Group:
    return _Group(points, box_around(points))


def boxes_of(parts: Sequence[TriangleMesh], most: int, name: str) -> tuple[Array, Array, Array]:
    """Return rotations (B, 3, 3), centres (B, 3) and half extents (B, 3) [m] of boxes that hold all parts.

    Starting with one box for each part, the two that make the least of a larger box become one, until there are at
    most ``most`` and no two fill a common box.

    Raises:
        InvalidValue: ``most`` below one, no parts, or a part without volume.
    """
    if most < 1 or not parts:
        raise InvalidValue(f"boxes of {name}", (most, len(parts)), "at least one box and one part")
    clouds = [np.asarray(part.vertices) for part in parts]
    for points in clouds:
        if len(points) < 4 or np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] < FLAT:
            raise InvalidValue(
                f"a part of {name}", points.shape, f"points (V, 3) that span more than {FLAT} m"
            )
    groups = dict(enumerate(_group(points) for points in clouds))
    joined: dict[tuple[int, int], _Group] = {}
    for new in range(len(groups), 2 * len(groups)):
        pairs = [(a, b) for a in groups for b in groups if a < b]
        for a, b in pairs:
            if (a, b) not in joined:
                joined[a, b] = groups[a].with_other(groups[b])
        if not pairs:
            break
        a, b = min(pairs, key=lambda p: joined[p].volume - groups[p[0]].volume - groups[p[1]].volume)
        fills = joined[a, b].volume <= FILL * (groups[a].volume + groups[b].volume)
        if len(groups) <= most and not fills:
            break
        del groups[a], groups[b]
        groups[new] = joined[a, b]
    boxes = [group.box for group in groups.values()]
    return (
        np.array([R for R, _, _ in boxes]),
        np.array([c for _, c, _ in boxes]),
        np.array([h for *_, h in boxes]),
    )
