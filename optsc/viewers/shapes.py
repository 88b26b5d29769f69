"""Solid shapes as shaded triangles, for the painter's algorithm (far ones are drawn first)."""

from __future__ import annotations

import numpy as np

from optsc.geometry import Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.viewers.drawing import Colour

_LIGHT = np.array([0.30, -0.50, 0.81])
# Corner c of a box has its upper coordinate along x, y, z where bit 2, 1, 0 of c is set.
_CORNERS = np.array([[c >> 2 & 1, c >> 1 & 1, c & 1] for c in range(8)], dtype=bool)
_SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
_TRIANGLES = np.concatenate([_SIDES[:, [0, 1, 2]], _SIDES[:, [0, 2, 3]]])


def mesh_triangles(mesh: TriangleMesh, X_WO: Pose) -> Array:
    """Return the triangles of ``mesh`` in the world (F, 3, 3) [m]."""
    return X_WO.apply(mesh.vertices)[mesh.faces]


def box_triangles(boxes: Array, X_WT: Pose) -> Array:
    """Return the surface of boxes (K, 2, 3), lower and upper corners in T, in the world (12 K, 3, 3) [m]."""
    boxes = np.asarray(boxes, dtype=float)
    corners = np.where(_CORNERS, boxes[:, None, 1], boxes[:, None, 0])
    return X_WT.apply(corners)[:, _TRIANGLES].reshape(-1, 3, 3)


def fork_boxes(opening: float = 0.08, thickness: float = 0.006) -> Array:
    """Return a small fork (4, 2, 3) [m] that stands for a gripper with its jaws ``opening`` [m] apart.

    Two tines reach to the tool's origin along z, a bar joins them, a stem shows where the hand is.
    """
    h, t = 0.5 * opening, thickness
    return np.array(
        [
            [[-t / 2, h, -0.040], [t / 2, h + t, 0.008]],
            [[-t / 2, -h - t, -0.040], [t / 2, -h, 0.008]],
            [[-t / 2, -h - t, -0.040 - t], [t / 2, h + t, -0.040]],
            [[-t / 2, -t / 2, -0.095], [t / 2, t / 2, -0.040 - t]],
        ]
    )


def refined(triangles: Array, longest: float) -> Array:
    """Return ``triangles`` (F, 3, 3) cut in two at their longest sides until none is longer than ``longest``.

    A painter's algorithm sorts triangles by their middles: the smaller they are, the fewer it gets wrong.
    """
    done = []
    while len(triangles):
        side = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
        long = side.max(axis=1) > longest
        done.append(triangles[~long])
        triangles, start = triangles[long], np.argmax(side[long], axis=1)
        rows = np.arange(len(triangles))
        a, b, c = (triangles[rows, (start + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        triangles = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done) if done else triangles


def normals(triangles: Array) -> Array:
    """Return the unit normals (F, 3) of ``triangles`` (F, 3, 3), seen counter-clockwise."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.where(length > 0.0, length, 1.0)


def facing(triangles: Array, towards: Array) -> Array:
    """Return those of ``triangles`` (F, 3, 3) whose front is seen from the direction ``towards`` (3,)."""
    return triangles[normals(triangles) @ towards > 0.0]


def shaded(triangles: Array, colour: Colour) -> Array:
    """Return a colour (F, 3) for each of ``triangles``: ``colour`` lit from above and the right."""
    lit = 0.62 + 0.30 * normals(triangles) @ (_LIGHT / np.linalg.norm(_LIGHT))
    # Bright sides are mixed with white and dark ones with black, so that a hue stays the same hue.
    white = np.clip(lit - 0.72, 0.0, 1.0)[:, None] * 1.4
    dark = np.clip(lit / 0.72, 0.0, 1.0)[:, None]
    return np.clip(np.asarray(colour) * dark * (1.0 - white) + white, 0.0, 1.0)


def shadow(triangles: Array) -> Array:
    """Return ``triangles`` (F, 3, 3) dropped onto the plane z = 0."""
    return triangles * np.array([1.0, 1.0, 0.0])
