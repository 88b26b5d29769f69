"""Capsules fixed to the joints of an arm: where their segments are, and the nearest points of segments and boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi
import numpy as np

from optsc.geometry.rotation import Array
from optsc.kernels.chain import Chain, joint_frames

TINY = 1e-12
"""Squares of lengths below this [m^2] count as zero."""


@dataclass(frozen=True, eq=False)
class LinkCapsules:
    """The capsules of an arm with its hand.

    Attributes:
        link: name of the link that each of the C capsules covers. The two fingers count as one body, in every
            position of the jaws.
        joint: (C,) the joint of the arm that carries it, 0 to n - 1; -1 for what no joint moves.
        ends: (C, 2, 3) ends of the segments in the frame of that joint [m].
        radius: (C,) [m].
        hand: (C,) bool: part of the hand.
    """

    link: tuple[str, ...]
    joint: np.ndarray
    ends: Array
    radius: Array
    hand: np.ndarray

    @property
    def length(self) -> Array:
        """Lengths (C,) of the segments [m]."""
        return np.linalg.norm(self.ends[:, 1] - self.ends[:, 0], axis=1)

    @property
    def moving(self) -> list[int]:
        """Numbers of the capsules that a joint moves."""
        return np.flatnonzero(self.joint >= 0).tolist()


def capsule_ends(chain: Chain, *sets: LinkCapsules) -> casadi.Function:
    """Return the function q (n,) -> ends (6, C) of the capsules' segments in W [m], for each of some sets of them."""
    q = casadi.SX.sym("q", chain.n)
    frames = joint_frames(chain, q)
    outputs = []
    for capsules in sets:
        columns = []
        for joint, ends in zip(capsules.joint.tolist(), capsules.ends, strict=True):
            R, p = (casadi.SX.eye(3), casadi.SX(3, 1)) if joint < 0 else frames[joint][:2]
            columns.append(casadi.vertcat(*(p + R @ casadi.DM(end) for end in ends)))
        outputs.append(casadi.densify(casadi.horzcat(*columns)))
    return casadi.Function("capsule_ends", [q], outputs)


def norm(x: casadi.SX) -> casadi.SX:
    """The Euclidean norm of a vector."""
    return casadi.sqrt(casadi.dot(x, x))


def clip(x: casadi.SX) -> casadi.SX:
    """The nearest number in [0, 1]."""
    return casadi.fmin(casadi.fmax(x, 0.0), 1.0)


def nearest_shares(a: Sequence[casadi.SX], b: Sequence[casadi.SX], c: casadi.SX) -> tuple[casadi.SX, ...]:
    """Return shares s, t of the points of two segments that are nearest after blending by ``c`` (2) [m^2], and phi."""
    u, w, between = a[1] - a[0], b[1] - b[0], a[0] - b[0]
    uu, ww, uw = casadi.dot(u, u), casadi.dot(w, w), casadi.dot(u, w)
    A, C = uu + 4.0 * c[0] + TINY, ww + 4.0 * c[1] + TINY
    p, r = casadi.dot(u, between) - 2.0 * c[0], -casadi.dot(w, between) - 2.0 * c[1]
    # minimise 1/2 A s^2 + p s - uw s t + 1/2 C t^2 + r t on the unit square
    s = clip((uw * -r - p * C) / (A * C - uw * uw))
    t = clip((uw * s - r) / C)
    s = clip((uw * t - p) / A)
    t = clip((uw * s - r) / C)
    blend = 4.0 * c[0] * (s - 0.5) ** 2 + 4.0 * c[1] * (t - 0.5) ** 2
    return s, t, blend


def nearest_to_box(a: casadi.SX, b: casadi.SX, half: casadi.SX, c: casadi.SX) -> casadi.SX:
    """Return the share t of a segment that is nearest to a box after blending by ``c``, in the box's axes.

    Half the derivative of the squared distance rises with t in straight pieces: between the two breaks where it
    changes its sign, the root is that of a line.
    """
    u = b - a

    def slope(t: casadi.SX) -> casadi.SX:
        p = a + t * u
        outside = p - casadi.fmin(casadi.fmax(p, -half), half)
        return casadi.dot(outside, u) + 4.0 * c * (t - 0.5)

    left, right = casadi.SX(0.0), casadi.SX(1.0)
    at_left, at_right = slope(left), slope(right)
    for k in range(3):
        for sign in (1.0, -1.0):
            safe = casadi.if_else(casadi.fabs(u[k]) < TINY, 1.0, u[k])
            t = clip((sign * half[k] - a[k]) / safe)
            value = slope(t)
            lower, higher = (
                casadi.logic_and(value <= 0.0, t >= left),
                casadi.logic_and(value >= 0.0, t <= right),
            )
            left, at_left = casadi.if_else(lower, t, left), casadi.if_else(lower, value, at_left)
            right, at_right = casadi.if_else(higher, t, right), casadi.if_else(higher, value, at_right)
    return left + (right - left) * clip(-at_left / casadi.fmax(at_right - at_left, 1e-15))
