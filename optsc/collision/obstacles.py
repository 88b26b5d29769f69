"""Obstacles: convex parts that must not be touched, and few bounding boxes that hold them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose, TriangleMesh
from optsc.geometry.rotation import Array

TABLE = "table"
"""What the table is called in a reason; no obstacle can have this name."""
THINNEST = 1e-6
"""A part whose points lie within this distance of a plane [m] has no volume."""
FILL = 1.1
"""Two boxes become one where that takes up no more than this times the volume of both."""
TURNS = 18
"""Directions about the vertical that a box is tried in."""

ObstacleShape: TypeAlias = TriangleMesh | Sequence[TriangleMesh]
"""A convex body, or the convex parts of one that is not; each mesh counts as its convex hull."""
Obstacles: TypeAlias = Mapping[str, tuple[ObstacleShape, Pose]]
"""Shape and pose X_WO of everything that must not be touched, by name."""


def checked_obstacles(obstacles: Obstacles | None, margin: float) -> dict[str, tuple[ObstacleShape, Pose]]:
    """Return obstacles to keep a margin [m] from; raise `InvalidValue` for a margin or a name that cannot be."""
    if not 0.0 <= margin < 1.0:
        raise InvalidValue("collision margin", margin, "0 to 1 m")
    obstacles = dict(obstacles or {})
    if TABLE in obstacles:
        raise InvalidValue("obstacle name", TABLE, "any name but that of the table")
    return obstacles


def convex_parts(shape: ObstacleShape) -> tuple[TriangleMesh, ...]:
    """Return the convex parts of a shape."""
    return (shape,) if isinstance(shape, TriangleMesh) else tuple(shape)


def is_flat(points: Array) -> bool:
    """Tell whether points (N, 3) span no volume."""
    return bool(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] < THINNEST)


class Boxes(NamedTuple):
    """Rotations (B, 3, 3), centres (B, 3) and half extents (B, 3) [m] of boxes."""

    rotation: Array
    centre: Array
    half: Array


def box_slots(count: int) -> int:
    """Return how many boxes to make room for: in steps, so that few functions are built for many scenes."""
    return max(4, 1 << max(count - 1, 0).bit_length())


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


class _Boxed(NamedTuple):
    """Points and the box around them."""

    points: Array
    box: tuple[Array, Array, Array]

    @classmethod
    def around(cls, points: Array) -> _Boxed:
        return cls(points, box_around(points))

    @property
    def volume(self) -> float:
        return float(8.0 * np.prod(self.box[2]))


def boxes_of(parts: Sequence[TriangleMesh], most: int, name: str) -> Boxes:
    """Return boxes that hold all parts.

    Starting with one box for each part, the two that make the least of a larger box become one, until there are at
    most ``most`` and no two fill a common box.

    Raises:
        InvalidValue: ``most`` below one, no parts, or a part without volume.
    """
    if most < 1 or not parts:
        raise InvalidValue(f"boxes of {name}", (most, len(parts)), "at least one box and one part")
    clouds = [np.asarray(part.vertices) for part in parts]
    for points in clouds:
        if len(points) < 4 or is_flat(points):
            raise InvalidValue(f"a part of {name}", points.shape, f"points (V, 3) that span more than {THINNEST} m")
    groups = dict(enumerate(_Boxed.around(points) for points in clouds))
    joined: dict[tuple[int, int], _Boxed] = {}
    for new in range(len(groups), 2 * len(groups)):
        pairs = [(a, b) for a in groups for b in groups if a < b]
        for a, b in pairs:
            if (a, b) not in joined:
                joined[a, b] = _Boxed.around(np.concatenate([groups[a].points, groups[b].points]))
        if not pairs:
            break
        a, b = min(pairs, key=lambda p: joined[p].volume - groups[p[0]].volume - groups[p[1]].volume)
        fills = joined[a, b].volume <= FILL * (groups[a].volume + groups[b].volume)
        if len(groups) <= most and not fills:
            break
        del groups[a], groups[b]
        groups[new] = joined[a, b]
    rotation, centre, half = zip(*(group.box for group in groups.values()), strict=True)
    return Boxes(np.array(rotation), np.array(centre), np.array(half))
