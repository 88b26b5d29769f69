"""Forward kinematics and Jacobian of a serial chain as CasADi functions.

pinocchio's wheel carries no symbolic kinematics, so they are written out here; a test holds both equal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi
import numpy as np

from optsc.geometry.rotation import Array

ROUNDED_ENTRY = 1e-15
"""Entries of placements this near to 0 or 1 come from rounded right angles; exact ones make the code shorter."""


@dataclass(frozen=True, eq=False)
class Chain:
    """A serial chain of n joints between the world W and the tool frame T, all at zero.

    Attributes:
        rotation, translation: placement (n, 3, 3), (n, 3) [m] of each joint in the frame of the one before.
        axis: unit axis (n, 3) of each joint in its own frame.
        slides: whether each joint (n,) is prismatic; the others turn.
        tip_rotation, tip_translation: placement (3, 3), (3,) [m] of T in the frame of the last joint.
    """

    rotation: Array
    translation: Array
    axis: Array
    slides: tuple[bool, ...]
    tip_rotation: Array
    tip_translation: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.slides)


def _constant(array: Array) -> casadi.SX:
    """Return a matrix whose exact zeros and ones vanish from the generated code."""
    snapped = np.where(np.abs(array - np.round(array)) < ROUNDED_ENTRY, np.round(array), array)
    return casadi.SX(casadi.sparsify(casadi.DM(snapped)))


def _rotation_about(axis: Array, angle: casadi.SX) -> casadi.SX:
    """Return the rotation matrix about a unit axis by Rodrigues' formula: a aᵀ + cos (I - a aᵀ) + sin [a]×."""
    projection = _constant(np.outer(axis, axis))
    cross = _constant(np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]]))
    rest = _constant(np.eye(3) - np.outer(axis, axis))
    return projection + casadi.cos(angle) * rest + casadi.sin(angle) * cross


class JointFrame(NamedTuple):
    """The frame that a joint moves: rotation and position in W, the joint's axis and origin in W, its type."""

    R: casadi.SX
    p: casadi.SX
    axis: casadi.SX
    origin: casadi.SX
    slides: bool


def joint_frames(chain: Chain, q: casadi.SX) -> list[JointFrame]:
    """Return the frame that each joint moves."""
    R, p = casadi.SX.eye(3), casadi.SX(3, 1)
    frames = []
    for i, slides in enumerate(chain.slides):
        p, R = p + R @ _constant(chain.translation[i]), R @ _constant(chain.rotation[i])
        axis, origin = R @ _constant(chain.axis[i]), p
        p, R = (p + axis * q[i], R) if slides else (p, R @ _rotation_about(chain.axis[i], q[i]))
        frames.append(JointFrame(R, p, axis, origin, slides))
    return frames


def tool_kinematics(chain: Chain, q: casadi.SX) -> tuple[casadi.SX, casadi.SX, casadi.SX]:
    """Return R_WT (3, 3), p_WT (3,) [m] and the Jacobian (6, n) in W's axes as expressions in ``q`` (n,)."""
    frames = joint_frames(chain, q)
    R, p = frames[-1][:2]
    p, R = p + R @ _constant(chain.tip_translation), R @ _constant(chain.tip_rotation)
    columns = [
        casadi.vertcat(frame.axis, casadi.SX(3, 1))
        if frame.slides
        else casadi.vertcat(casadi.cross(frame.axis, p - frame.origin), frame.axis)
        for frame in frames
    ]
    return casadi.densify(R), casadi.densify(p), casadi.densify(casadi.horzcat(*columns))


def forward_kinematics(chain: Chain) -> casadi.Function:
    """Return the function q (n,) -> R_WT (3, 3), p_WT (3,) [m]."""
    q = casadi.SX.sym("q", chain.n)
    return casadi.Function("forward_kinematics", [q], tool_kinematics(chain, q)[:2], ["q"], ["R_WT", "p_WT"])


def kinematics(chain: Chain) -> casadi.Function:
    """Return the function q (n,) -> R_WT (3, 3), p_WT (3,) [m], Jacobian (6, n): one pass for all three."""
    q = casadi.SX.sym("q", chain.n)
    return casadi.Function("kinematics", [q], [*tool_kinematics(chain, q)], ["q"], ["R_WT", "p_WT", "J_WT"])


class Rates(NamedTuple):
    """Greatest joint velocities and accelerations, each (n,) [rad/s, rad/s^2]."""

    velocity: Array
    acceleration: Array
