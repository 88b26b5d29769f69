"""Where to begin: a template's resting poses, turned and shifted so that what it would show meets what was seen."""

from __future__ import annotations

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.perception.guesses import Guesses, yaws
from optsc.perception.templates import Template

_POINTS = 200
_WORTH_SHIFTING = 0.008  # [m]


def resting_starts(
    template: Template, points: Array, eye: Array, table_height: float, count: int, slack: float = 0.012
) -> Guesses:
    """Return starts (B) that rest on the table: resting poses x yaw angles x positions.

    The centre of what the template would show to the camera is put on the centre of what was seen. Where the template
    would show more than was seen, because something hides it, it is also shifted so that either end meets.

    Args:
        template: the shape.
        points: measured (M, 3) [m], in W.
        eye: position of the camera in W (3,) [m].
        table_height: of the table in W [m].
        count: of yaw angles.
        slack: a resting pose that is lower than the highest points by more than this is left out [m].
    """
    rest = template.resting.rotation_matrix()
    height = template.resting.translation[:, 2]
    tops = (template.points @ rest.swapaxes(1, 2))[..., 2].max(axis=1) + height
    tall = tops >= np.percentile(points[:, 2], 98.0) - table_height - slack
    parts = []
    for R, z in zip(rest[tall], height[tall], strict=True):
        upright = abs(R[2, 2]) > 1.0 - 1e-6
        number = 1 if template.round and upright else count
        if upright and template.symmetry > 1:
            number = max(count // template.symmetry, 1)
        turned = yaws(number)
        if upright and template.symmetry > 1:
            turned = yaws(number * template.symmetry)[:number]
        parts.append(_placed(turned @ R, template, points, eye, table_height + z))
    if not parts:
        return Guesses(np.zeros((0, 3, 3)), np.zeros((0, 3)))
    return Guesses.joined(parts)


def free_starts(
    template: Template, points: Array, eye: Array, count: int, rng: np.random.Generator
) -> Guesses:
    """Return starts with rotations from all of SO(3), for what rests on something else than the table."""
    R = rotation.to_matrix(rotation.random(rng, (count,)))
    return _placed(R, template, points, eye, None)


def _placed(R: Array, template: Template, points: Array, eye: Array, z: float | None) -> Guesses:
    """Return guesses with rotations (B, 3, 3), each at one to nine positions; ``z`` of O is given or follows too."""
    seen = points.mean(axis=0)
    look = seen - eye
    look /= np.linalg.norm(look)
    axes = _horizontal(look)
    shape = template.points[:_POINTS] @ R.swapaxes(1, 2)
    facing = np.clip(-(template.normals[:_POINTS] @ R.swapaxes(1, 2)) @ look, 0.0, None)
    centre = (facing[..., None] * shape).sum(axis=1) / np.maximum(facing.sum(axis=1), 1e-9)[:, None]
    base = seen - centre
    if z is not None:
        base[:, 2] = z
    along = shape @ axes.T
    shown = np.where((facing > 0.05)[..., None], along, np.nan)
    low, high = np.nanmin(shown, axis=1), np.nanmax(shown, axis=1)
    low_seen, high_seen = np.percentile(points @ axes.T, [1.0, 99.0], axis=0)
    gap = (high - low) - (high_seen - low_seen)
    to_low, to_high = low_seen - (low + base @ axes.T), high_seen - (high + base @ axes.T)
    found = [Guesses(R, base)]
    for i in range(2):
        hidden = gap[:, i] > _WORTH_SHIFTING
        for shift in (to_low[:, i], to_high[:, i]):
            found.append(Guesses(R[hidden], (base + shift[:, None] * axes[i])[hidden]))
    both = (gap > _WORTH_SHIFTING).all(axis=1)
    for first in (to_low[:, 0], to_high[:, 0]):
        for second in (to_low[:, 1], to_high[:, 1]):
            moved = base + first[:, None] * axes[0] + second[:, None] * axes[1]
            found.append(Guesses(R[both], moved[both]))
    return Guesses.joined(found)


def _horizontal(look: Array) -> Array:
    """Return two horizontal unit vectors (2, 3): across the line of sight, and along it."""
    across = np.cross(look, [0.0, 0.0, 1.0])
    length = np.linalg.norm(across)
    across = across / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.stack([across, np.cross([0.0, 0.0, 1.0], across)])


def pose_starts(X_WO: Pose) -> Guesses:
    """Return a batch of poses that somebody else proposes, such as the last known ones, as starts."""
    return Guesses.of(X_WO)
