"""Which part of a template a camera would see, and which part it saw."""

from __future__ import annotations

import numpy as np

from optsc.geometry.rotation import Array
from optsc.perception.freespace import FreeSpace
from optsc.perception.guesses import Guesses
from optsc.perception.templates import Template

_FACING = 0.1  # cosine; what is seen at a more grazing angle is seen or not by chance


def self_visible(template: Template, guess: Guesses, space: FreeSpace) -> np.ndarray:
    """Return which of the template's points (N,) bool the camera would see if nothing else were there.

    Those that face it and have no other point of the template in front, in an image whose pixels are as large as the
    points are apart.
    """
    camera, X_WC = space.image.camera, space.image.X_WC
    local = X_WC.inverse().apply(guess.to_world(template.points)[0])
    normals = template.normals @ guess.R[0].T @ X_WC.rotation_matrix()
    z = local[:, 2]
    facing = -(normals * local).sum(axis=1) > _FACING * np.linalg.norm(local, axis=1)
    if not (z > 1e-6).all():
        return np.zeros(len(z), dtype=bool)
    pixel = 1.5 * template.spacing * camera.fx / float(np.median(z))
    u, v, _ = camera.project(local)
    column, row = (np.floor((a - a.min()) / pixel).astype(int) + 1 for a in (u, v))
    nearest = np.full((row.max() + 2, column.max() + 2), np.inf)
    np.minimum.at(nearest, (row[facing], column[facing]), z[facing])
    return np.asarray(facing & (z <= nearest[row, column] + 1.5 * space.tolerance))


def visible_fraction(template: Template, guess: Guesses, space: FreeSpace) -> float:
    """Return the share of what the camera would see of the template alone that it did see, 0 to 1."""
    shown = self_visible(template, guess, space)
    _, seen = space.judge(guess.to_world(template.points)[0])
    total = _weights(template, guess, space)[shown].sum()
    return float(_weights(template, guess, space)[shown & seen].sum() / total) if total > 0.0 else 0.0


def _weights(template: Template, guess: Guesses, space: FreeSpace) -> Array:
    """Return the area that each point stands for in the image, but for a factor (N,)."""
    towards = space.image.X_WC.translation - guess.to_world(template.points)[0]
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    return np.clip(((template.normals @ guess.R[0].T) * towards).sum(axis=1), 0.0, None)
