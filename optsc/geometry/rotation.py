"""Unit quaternions (w, x, y, z) as arrays of shape (..., 4).

``q`` and ``-q`` are the same rotation in every function. Formulas: J. Sola, "Quaternion kinematics for
the error-state Kalman filter", 2017, and D. Q. Huynh, "Metrics for 3D rotations", 2009.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optsc.errors import InvalidValue

Array = NDArray[np.float64]

UNIT_TOLERANCE = 1e-6
"""How far the norm of a quaternion from outside may be from one before it is refused."""


def checked(quaternion: ArrayLike, field: str = "quaternion") -> Array:
    """Return ``quaternion`` (..., 4) normalised to rounding; raise `InvalidValue` unless finite and unit."""
    q = np.asarray(quaternion, dtype=float)
    if q.shape[-1:] != (4,):
        raise InvalidValue(field, q.shape, "shape (..., 4), ordered w, x, y, z")
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.all(np.abs(norm - 1.0) <= UNIT_TOLERANCE):
        raise InvalidValue(field, q.tolist(), f"finite and of unit norm within {UNIT_TOLERANCE}")
    return q / norm


def _components(array: ArrayLike) -> list[Array]:
    """Split along the last axis; plain indexing is several times quicker than moving axes."""
    array = np.asarray(array, dtype=float)
    return [array[..., i] for i in range(array.shape[-1])]


def multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """Hamilton product: the rotation ``b`` followed by ``a``; shapes (..., 4) broadcast."""
    aw, ax, ay, az = _components(a)
    bw, bx, by, bz = _components(b)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(q: ArrayLike) -> Array:
    """Return the inverse rotation of ``q`` (..., 4)."""
    return np.asarray(q, dtype=float) * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: ArrayLike, vector: ArrayLike) -> Array:
    """Rotate vectors (..., 3) by ``q`` (..., 4); leading axes broadcast."""
    w, x, y, z = _components(q)
    a, b, c = _components(vector)
    # v + 2 w (u x v) + 2 u x (u x v), written out: numpy's cross product costs more than all of this.
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return np.stack([a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx], axis=-1)


def to_matrix(q: ArrayLike) -> Array:
    """Return rotation matrices (..., 3, 3)."""
    w, x, y, z = _components(q)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def from_matrix(matrix: ArrayLike) -> Array:
    """Return the quaternions (..., 4) of rotation matrices (..., 3, 3); raise `InvalidValue` if they are none.

    Shepperd's method: of the four equivalent formulas the best conditioned one is taken for each matrix.
    """
    R = np.asarray(matrix, dtype=float)
    if R.shape[-2:] != (3, 3):
        raise InvalidValue("rotation matrix", R.shape, "shape (..., 3, 3)")
    identity_error = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3))
    if not (np.all(identity_error <= 1e-6) and np.all(np.linalg.det(R) > 0)):
        raise InvalidValue("rotation matrix", R.tolist(), "orthonormal within 1e-6, determinant +1")
    m00, m11, m22 = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    squares = np.stack([1 + m00 + m11 + m22, 1 + m00 - m11 - m22, 1 - m00 + m11 - m22, 1 - m00 - m11 + m22], -1)
    d0, d1, d2 = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    s0, s1, s2 = R[..., 2, 1] + R[..., 1, 2], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 0] + R[..., 0, 1]
    columns = np.stack(
        [
            np.stack([squares[..., 0], d0, d1, d2], -1),
            np.stack([d0, squares[..., 1], s2, s1], -1),
            np.stack([d1, s2, squares[..., 2], s0], -1),
            np.stack([d2, s1, s0, squares[..., 3]], -1),
        ],
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)
    q = np.take_along_axis(columns, best[..., None, None], axis=-2)[..., 0, :]
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def exp(rotation_vector: ArrayLike) -> Array:
    """Return the rotation about ``rotation_vector`` (..., 3) by its length [rad]."""
    v = np.asarray(rotation_vector, dtype=float)
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    # np.sinc is sin(pi x) / (pi x): exact at zero, so no branch is needed for small angles.
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * v], axis=-1)


def log(q: ArrayLike) -> Array:
    """Return the shortest rotation vector (..., 3) [rad] of ``q``, at most pi long."""
    q = np.asarray(q, dtype=float)
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    scale = np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 2.0)
    return scale * q[..., 1:]


def slerp(start: ArrayLike, end: ArrayLike, fraction: ArrayLike) -> Array:
    """Return the rotation at ``fraction`` of the shortest path from ``start`` to ``end``."""
    step = log(multiply(conjugate(start), end))
    return multiply(start, exp(np.asarray(fraction, dtype=float)[..., None] * step))


def chord(a: ArrayLike, b: ArrayLike) -> Array:
    """Return min(||a - b||, ||a + b||) [-], the paper's orientation distance; 2 sin(angle / 4), at most sqrt(2)."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    return np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


def wrapped(angle: ArrayLike) -> Array:
    """Return angles (...) [rad] that are the same but for whole turns, in [-π, π]."""
    angle = np.asarray(angle, dtype=float)
    return angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi))


def angle(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the angle [rad], in [0, pi], of the rotation from ``a`` to ``b``.

    4 atan2 of the two chords keeps its digits near zero, where acos of the scalar product loses them.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    minus, plus = np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)
    return 4.0 * np.arctan2(np.minimum(minus, plus), np.maximum(minus, plus))


def random(rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Array:
    """Return rotations (*shape, 4), uniform on SO(3)."""
    q = rng.normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)
