"""Near a singularity: which direction of the tool is being lost."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optsc.geometry.rotation import Array
from optsc.robot import RobotModel

LENGTH = 0.15
"""Metres that a radian counts for where linear and angular velocities are compared: the reach of a gripper."""
DIRECTIONS = ("along x", "along y", "along z", "about x", "about y", "about z")


class LostDirection(NamedTuple):
    """The direction (6,) of the tool frame that the arm can move least in, and its least singular value [m]."""

    direction: Array
    singular_value: float

    @property
    def name(self) -> str:
        """The axis of the tool that it is mostly along or about."""
        return DIRECTIONS[int(np.argmax(np.abs(self.direction)))]


def lost_direction(robot: RobotModel, q: Array) -> LostDirection:
    """Return the direction of the tool that is lost most at posture ``q`` (n,): the last left singular vector.

    Angular rows of the Jacobian are scaled by `LENGTH`, so that its singular values have one unit. Below six joints the
    directions that no posture gives are left out.
    """
    R = robot.forward(q).rotation_matrix()
    J = robot.jacobian(q)
    tool = np.vstack([R.T @ J[:3], LENGTH * (R.T @ J[3:])])
    U, sigma, _ = np.linalg.svd(tool)
    return LostDirection(U[:, len(sigma) - 1], float(sigma[-1]))


def towards(lost: LostDirection, error: Array) -> float:
    """Return the share, in [0, 1], of the pose error (6,) that lies in the lost direction."""
    scaled = error * np.array([1.0, 1.0, 1.0, LENGTH, LENGTH, LENGTH])
    size = float(np.linalg.norm(scaled))
    return abs(float(lost.direction @ scaled)) / size if size > 0 else 0.0
