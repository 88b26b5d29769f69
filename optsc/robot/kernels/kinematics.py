"""Forward kinematics and Jacobian of an arm as CasADi functions, built from the model's joint placements.

pinocchio's wheel carries no symbolic kinematics, so the chain is written out once more here; a test holds
both equal.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi
import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.robot.model import RobotModel

ROUNDING = 1e-15
"""Entries of placements this near to 0 or 1 come from rounded right angles; exact ones make the code
shorter."""


def constant(array: Array) -> casadi.SX:
    """Return a matrix whose exact zeros and ones vanish from the generated code."""
    snapped = np.where(np.abs(array - np.round(array)) < ROUNDING, np.round(array), array)
    return casadi.SX(casadi.sparsify(casadi.DM(snapped)))


def axis_of(robot: RobotModel, index: int) -> tuple[Array, bool]:
    """Return the unit axis (3,) of a joint in its own frame, and whether it slides; raise `InvalidValue`."""
    joint = robot.model.joints[index + 1]
    data = joint.createData()
    joint.calc(data, np.zeros(1))
    # The motion subspace tells the axis of every joint type alike: linear part, then angular part.
    linear, angular = np.ravel(data.S)[:3], np.ravel(data.S)[3:]
    if np.any(linear) == np.any(angular):
        kind = f"type of joint {robot.joint_names[index]}"
        raise InvalidValue(kind, joint.shortname(), "revolute or prismatic")
    return (linear, True) if np.any(linear) else (angular, False)


def rotation_about(axis: Array, angle: casadi.SX) -> casadi.SX:
    """Return the rotation matrix about a unit axis by Rodrigues' formula: a aᵀ + cos (I - a aᵀ) + sin [a]×."""
    projection = constant(np.outer(axis, axis))
    cross = constant(np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]]))
    rest = constant(np.eye(3) - np.outer(axis, axis))
    return projection + casadi.cos(angle) * rest + casadi.sin(angle) * cross


class JointFrame(NamedTuple):
    """The frame of a joint: rotation and position in W, the joint's axis in W, whether it slides."""

    R: casadi.SX
    p: casadi.SX
    axis: casadi.SX
    origin: casadi.SX
    slides: bool


def joint_frames(robot: RobotModel, q: casadi.SX) -> list[JointFrame]:
    """Return the frame that each joint moves, for a serial chain."""
    R, p = casadi.SX.eye(3), casadi.SX(3, 1)
    frames = []
    for i in range(robot.n):
        placement = robot.model.jointPlacements[i + 1]
        p, R = p + R @ constant(placement.translation), R @ constant(placement.rotation)
        local, slides = axis_of(robot, i)
        axis, origin = R @ constant(local), p
        p, R = (p + axis * q[i], R) if slides else (p, R @ rotation_about(local, q[i]))
        frames.append(JointFrame(R, p, axis, origin, slides))
    return frames


def chain(robot: RobotModel, q: casadi.SX) -> tuple[casadi.SX, casadi.SX, casadi.SX]:
    """Return R_WT (3, 3), p_WT (3,) [m] and the Jacobian (6, n) as expressions in the posture ``q`` (n,).

    Raises:
        InvalidValue: a joint is neither revolute nor prismatic, or the arm branches.
    """
    model = robot.model
    if list(model.parents)[1:] != list(range(robot.n)):
        raise InvalidValue("parents of the joints", list(model.parents)[1:], "one serial chain")
    R, p = casadi.SX.eye(3), casadi.SX(3, 1)
    axes: list[tuple[casadi.SX, casadi.SX, bool]] = []
    for i in range(robot.n):
        placement = model.jointPlacements[i + 1]
        p = p + R @ constant(placement.translation)
        R = R @ constant(placement.rotation)
        axis, slides = axis_of(robot, i)
        axes.append((R @ constant(axis), p, slides))
        if slides:
            p = p + axes[-1][0] * q[i]
        else:
            R = R @ rotation_about(axis, q[i])
    tip = model.frames[robot.tip_id].placement
    p, R = p + R @ constant(tip.translation), R @ constant(tip.rotation)
    columns = [
        casadi.vertcat(axis, casadi.SX(3, 1))
        if slides
        else casadi.vertcat(casadi.cross(axis, p - origin), axis)
        for axis, origin, slides in axes
    ]
    return casadi.densify(R), casadi.densify(p), casadi.densify(casadi.horzcat(*columns))


def forward_kinematics(robot: RobotModel) -> casadi.Function:
    """Return the function q (n,) -> R_WT (3, 3), p_WT (3,) [m]."""
    q = casadi.SX.sym("q", robot.n)
    R, p, _ = chain(robot, q)
    return casadi.Function("forward_kinematics", [q], [R, p], ["q"], ["R_WT", "p_WT"])


def jacobian(robot: RobotModel) -> casadi.Function:
    """Return the function q (n,) -> Jacobian (6, n) of T: linear over angular velocity, in W's axes."""
    q = casadi.SX.sym("q", robot.n)
    return casadi.Function("jacobian", [q], [chain(robot, q)[2]], ["q"], ["J_WT"])


def kinematics(robot: RobotModel) -> casadi.Function:
    """Return the function q (n,) -> R_WT (3, 3), p_WT (3,) [m], Jacobian (6, n): one pass for all three."""
    q = casadi.SX.sym("q", robot.n)
    return casadi.Function("kinematics", [q], [*chain(robot, q)], ["q"], ["R_WT", "p_WT", "J_WT"])
