"""Rotations of one pose as plain tuples of floats: several times quicker than arrays of four numbers.

For the control loop only, where one pose is handled at a time; everything else uses `optsc.geometry.rotation`,
and a test holds both equal. Quaternions are (w, x, y, z), unit; ``q`` and ``-q`` are the same rotation.
"""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin, sqrt

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation ``b`` followed by ``a``."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse rotation."""
    return q[0], -q[1], -q[2], -q[3]


def normalised(q: Quaternion) -> Quaternion:
    """Return ``q`` with unit norm; it must not be zero."""
    scale = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale


def rotate(q: Quaternion, v: Vector) -> Vector:
    """Return the vector turned by ``q``."""
    w, x, y, z = q
    a, b, c = v
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx


def exp(v: Vector) -> Quaternion:
    """Return the rotation about ``v`` by its length [rad]."""
    angle = hypot(*v)
    if angle < 1e-9:
        return normalised((1.0, 0.5 * v[0], 0.5 * v[1], 0.5 * v[2]))
    scale = sin(0.5 * angle) / angle
    return cos(0.5 * angle), scale * v[0], scale * v[1], scale * v[2]


def log(q: Quaternion) -> Vector:
    """Return the shortest rotation vector [rad] of ``q``."""
    w, x, y, z = q if q[0] >= 0 else (-q[0], -q[1], -q[2], -q[3])
    sine = hypot(x, y, z)
    scale = 2.0 if sine < 1e-12 else 2.0 * atan2(sine, w) / sine
    return scale * x, scale * y, scale * z


def angle(q: Quaternion) -> float:
    """Return the angle [rad], in [0, pi], of the rotation ``q``."""
    return 2.0 * atan2(hypot(q[1], q[2], q[3]), abs(q[0]))


def shortened(v: Vector, length: float) -> Vector:
    """Return ``v``, made ``length`` long where it is longer."""
    norm = hypot(*v)
    if norm <= length:
        return v
    scale = length / norm
    return v[0] * scale, v[1] * scale, v[2] * scale


def twist_about(q: Quaternion, axis: Vector) -> float:
    """Return the angle [rad], in (-pi, pi], that ``q`` turns about the unit ``axis`` (swing-twist decomposition)."""
    along = q[1] * axis[0] + q[2] * axis[1] + q[3] * axis[2]
    if along == 0.0 and q[0] == 0.0:
        return 0.0
    turn = 2.0 * atan2(along, q[0])
    return turn - 2.0 * pi if turn > pi else turn + 2.0 * pi if turn <= -pi else turn
