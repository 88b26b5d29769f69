"""Rotations as CasADi expressions: unit quaternions (w, x, y, z), rotation vectors, rotation matrices."""

from __future__ import annotations

import casadi


def multiply(a: casadi.SX, b: casadi.SX) -> casadi.SX:
    """Return the product (4) of two quaternions: the rotation b, then a."""
    w = a[0] * b[0] - casadi.dot(a[1:], b[1:])
    return casadi.vertcat(w, a[0] * b[1:] + b[0] * a[1:] + casadi.cross(a[1:], b[1:]))


def conjugate(q: casadi.SX) -> casadi.SX:
    """Return the inverse (4) of a unit quaternion."""
    return casadi.vertcat(q[0], -q[1:])


def exp(v: casadi.SX) -> casadi.SX:
    """Return the quaternion (4) of a rotation vector; the series of sin(x)/x below 1e-4 keeps all digits."""
    square = casadi.dot(v, v)
    half = 0.5 * casadi.sqrt(square + 1e-300)
    scale = casadi.if_else(square < 1e-8, 0.5 - square / 48.0, 0.5 * casadi.sin(half) / half)
    return casadi.vertcat(casadi.cos(half), scale * v)


def log(q: casadi.SX) -> casadi.SX:
    """Return the shortest rotation vector (3) of a unit quaternion; exact for small angles, at most π long."""
    q = casadi.if_else(q[0] < 0, -q, q)
    sine = casadi.sqrt(casadi.dot(q[1:], q[1:]) + 1e-300)
    scale = casadi.if_else(sine < 1e-9, 2.0, 2.0 * casadi.atan2(sine, q[0]) / sine)
    return scale * q[1:]


def to_matrix(quaternion: casadi.SX) -> casadi.SX:
    """Return the rotation matrix (3, 3) of a unit quaternion."""
    w, x, y, z = (quaternion[i] for i in range(4))
    return casadi.blockcat(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _skew_part(D: casadi.SX) -> casadi.SX:
    """Return sin(angle) times the axis (3) of a rotation matrix."""
    return 0.5 * casadi.vertcat(D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1])


def from_matrix(D: casadi.SX) -> casadi.SX:
    """Return the rotation vector (3) [rad], at most π long, of a rotation matrix.

    At half a turn D - Dᵀ vanishes, and with it what it says about the axis: the length is right there, and
    the axis is x.
    """
    v = _skew_part(D)
    sine, cosine = casadi.sqrt(casadi.dot(v, v)), 0.5 * (casadi.trace(D) - 1)
    angle = casadi.atan2(sine, cosine)
    # The tiny number keeps the quotient finite where there is no rotation; v is zero there.
    vector = v * (angle / (sine + 1e-200))
    half_turn = casadi.logic_and(cosine < 0, sine < 1e-8)
    return casadi.if_else(half_turn, casadi.vertcat(angle, 0, 0), vector)


def smooth_from_matrix(D: casadi.SX) -> casadi.SX:
    """Return the rotation vector (3) [rad] of a rotation matrix, without a jump of the axis at half a turn.

    There the vector shrinks to zero; its direction stays right. For a controller, which sees half a
    turn only as something far beyond the error it acts on.
    """
    axis = _skew_part(D)
    sine = casadi.sqrt(casadi.dot(axis, axis) + 1e-300)
    cosine = 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0)
    angle = casadi.atan2(sine, cosine)
    return casadi.if_else(sine < 1e-9, axis, (angle / sine) * axis)
