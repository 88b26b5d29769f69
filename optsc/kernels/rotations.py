"""Rotations as CasADi expressions: unit quaternions (w, x, y, z), rotation vectors, rotation matrices."""

from __future__ import annotations

import casadi
import numpy as np


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

    There the vector shrinks to zero; its direction still points the right way. For a controller, which sees half a
    turn only as something far beyond the error it acts on.
    """
    axis = _skew_part(D)
    sine = casadi.sqrt(casadi.dot(axis, axis) + 1e-300)
    cosine = 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0)
    angle = casadi.atan2(sine, cosine)
    return casadi.if_else(sine < 1e-9, axis, (angle / sine) * axis)


def tool_deviation(
    R_WT: casadi.SX, p_WT: casadi.SX, R_goal: casadi.SX, p_goal: casadi.SX
) -> tuple[casadi.SX, casadi.SX]:
    """Return the deviation (6,) of a tool from its target, and what turns angular velocity into its rates.

    In the target's axes: position [m], tilt about x and y, roll about z [rad]. The tilt is the rotation vector,
    in the x y plane, that takes the target's z axis to the tool's; what is left is the roll:

        D = R*ᵀ R,    tilt = acos(D₂₂) (-D₁₂, D₀₂) / √(D₀₂² + D₁₂²),    roll = atan2(D₁₀ - D₀₁, D₀₀ + D₁₁)

    Unlike the rotation vector of D, this says the same of the tilt whatever the roll is. The matrix (3, 3) maps
    angular velocity in the target's axes to the rates of tilt and roll. Where the z axes are opposite, the tilt
    is half a turn about x and the roll arbitrary.
    """
    D = R_goal.T @ R_WT
    x, y, z = D[0, 2], D[1, 2], D[2, 2]
    square = x * x + y * y
    sine = casadi.sqrt(square)
    angle = casadi.atan2(sine, z)
    aligned = casadi.logic_and(z > 0, square < 1e-8)
    # f = angle / sine as a function of the cosine z has the derivative (z f - 1) / (1 - z²), at z = 1 -1/3.
    f = casadi.if_else(aligned, 1 + square / 6, angle / (sine + 1e-200))
    slope = casadi.if_else(square < 1e-8, -1 / 3, (z * f - 1) / (square + 1e-200))
    half_turn = casadi.logic_and(z < 0, sine < 1e-8)
    f = casadi.if_else(half_turn, 0, f)
    tilt_x = casadi.if_else(half_turn, np.pi, -f * y)
    N, M = D[1, 0] - D[0, 1], D[0, 0] + D[1, 1]
    scale = M * M + N * N + 1e-200
    rates = casadi.blockcat(
        [
            [f * z - slope * y * y, slope * x * y, -f * x],
            [slope * x * y, f * z - slope * x * x, -f * y],
            [(N * D[2, 1] - M * D[2, 0]) / scale, -(M * D[2, 1] + N * D[2, 0]) / scale, 1],
        ]
    )
    deviation = casadi.vertcat(R_goal.T @ (p_WT - p_goal), tilt_x, f * x, casadi.atan2(N, M))
    return deviation, rates
