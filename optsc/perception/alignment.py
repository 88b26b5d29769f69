"""Point-to-surface ICP on the distance field, of many guesses in one go.

The distance field gives the foot of every point without a search for neighbours, so one Gauss-Newton step of
hundreds of guesses is a handful of array operations.
"""

from __future__ import annotations

import numpy as np

from optsc.geometry.rotation import Array
from optsc.perception.field import DistanceField
from optsc.perception.guesses import Guesses

PLANAR = (0, 1, 5)
"""Shift along x and y and turn about z: how a thing moves that keeps resting on the table."""
FREE = (0, 1, 2, 3, 4, 5)
"""All of position and rotation."""

_LONGEST_SHIFT, _LARGEST_TURN = 0.02, 0.35  # [m], [rad] of one step


def aligned(
    guesses: Guesses,
    points: Array,
    field: DistanceField,
    reaches: tuple[float, ...],
    *,
    freedom: tuple[int, ...] = PLANAR,
) -> Guesses:
    """Return the guesses after one Gauss-Newton step per entry of ``reaches``.

    Minimised is the sum of w d^2 over the points, d their signed distance to the surface and w Tukey's weight
    (1 - (d / reach)^2)^2 within ``reach``, 0 beyond. Linearised with a shift u and a turn r about the points' centre c,
    d changes by -g (u + r x (p - c)), g the outward gradient in W.

    Args:
        guesses: to start from.
        points: measured (M, 3) [m], in W.
        field: of the template.
        reaches: from far to near [m].
        freedom: which of shift and turn (x, y, z, x, y, z) may change.
    """
    pivot = points.mean(axis=0)
    index = list(freedom)
    for reach in reaches:
        H, b = normal_equations(guesses, points, field, reach, pivot)
        H, b = H[:, index][:, :, index], b[:, index]
        damping = 1e-3 * np.trace(H, axis1=1, axis2=2)[:, None, None] / len(index) * np.eye(len(index))
        scale = np.where(
            np.array(index) < 3, 1.0, 0.05
        )  # so that damping means the same to a turn and to a shift
        step = np.linalg.solve(H + damping * scale**2 + 1e-12 * np.eye(len(index)), b[..., None])[..., 0]
        whole = np.zeros((len(guesses), 6))
        whole[:, index] = step
        guesses = guesses.moved(
            _limited(whole[:, 3:], _LARGEST_TURN), _limited(whole[:, :3], _LONGEST_SHIFT), pivot
        )
    return guesses


def normal_equations(
    guesses: Guesses, points: Array, field: DistanceField, reach: float, pivot: Array
) -> tuple[Array, Array]:
    """Return H (B, 6, 6) and b (B, 6) of the weighted least squares, for shift and turn about ``pivot``."""
    d, g = field.lookup(guesses.to_object(points))
    gradient = g @ guesses.R.swapaxes(1, 2)
    weight = np.clip(1.0 - (d / reach) ** 2, 0.0, None) ** 2
    rows = np.concatenate([gradient, np.cross((points - pivot)[None], gradient)], axis=-1)
    weighted = rows * weight[..., None]
    return weighted.swapaxes(1, 2) @ rows, (weighted * d[..., None]).sum(axis=1)


def _limited(vector: Array, longest: float) -> Array:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector * np.minimum(1.0, longest / np.maximum(length, 1e-12))
