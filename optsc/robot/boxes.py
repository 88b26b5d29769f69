"""Boxes around convex parts: few bodies that hold an obstacle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import TriangleMesh
from optsc.geometry.rotation import Array
from optsc.robot.collision import FLAT

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


def boxes_of(parts: Sequence[TriangleMesh], most: int, name: str) -> tuple[Array, Array, Array]:
    """Return rotations (B, 3, 3), centres (B, 3) and half extents (B, 3) [m] of boxes that hold all parts.

    Starting with one box for each part, the two that make the least of a larger box become one, until there are at
    most ``most`` and no two fill a common box.

    Raises:
        InvalidValue: ``most`` below one, no parts, or a part without volume.
    """
    if most < 1 or not parts:
        raise InvalidValue(f"boxes of {name}", (most, len(parts)), "at least one box and one part")
    groups = [np.asarray(part.vertices) for part in parts]
    for points in groups:
        if len(points) < 4 or np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] < FLAT:
            raise InvalidValue(f"a part of {name}", points.shape, f"points (V, 3) that span more than {FLAT} m")
    boxes = [box_around(points) for points in groups]
    volume = [_volume(box) for box in boxes]
    joined: dict[tuple[int, int], tuple[tuple[Array, Array, Array], float]] = {}
    alive = list(range(len(groups)))
    while len(alive) > 1:
        best, cost, fills = (-1, -1), np.inf, False
        for i, a in enumerate(alive):
            for b in alive[i + 1 :]:
                if (a, b) not in joined:
                    box = box_around(np.concatenate([groups[a], groups[b]]))
                    joined[a, b] = box, _volume(box)
                added = joined[a, b][1] - volume[a] - volume[b]
                if added < cost:
                    best, cost, fills = (a, b), added, joined[a, b][1] <= FILL * (volume[a] + volume[b])
        if len(alive) <= most and not fills:
            break
        a, b = best
        groups.append(np.concatenate([groups[a], groups[b]]))
        boxes.append(joined[best][0])
        volume.append(joined[best][1])
        alive = [k for k in alive if k not in best] + [len(groups) - 1]
    chosen = [boxes[k] for k in alive]
    return tuple(np.array([box[k] for box in chosen]) for k in range(3))  # type: ignore[return-value]


def _volume(box: tuple[Array, Array, Array]) -> float:
    return float(8.0 * np.prod(box[2]))
