"""Looking ahead: whether the arm can go where it is about to be sent."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from optsc.control.approach import Approach
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.ik.batch import solve_ik
from optsc.robot import RobotModel

STEP_TIME = 0.15
"""Time between two postures that are looked at [s]: 15 mm at the paper's speed."""


def can_travel(robot: RobotModel, settings: Approach, q: Array, waypoints: list[Pose]) -> bool:
    """Tell whether an arm in posture ``q`` (n,) can lead its tool along the straight way through ``waypoints``.

    The way is followed in short steps, each from the posture of the one before; it ends where a pose has no posture
    within the joint limits, or only one that the joints cannot get to in time. A grasp may well be reached and its
    pre-grasp too, and yet lie behind a joint limit on the way.
    """
    rng = np.random.default_rng(0)
    for start, end in pairwise(waypoints):
        length = float(np.linalg.norm(end.translation - start.translation))
        turn = float(rotation.angle(end.quaternion, start.quaternion))
        duration = max(length / settings.speed, turn / settings.angular_speed)
        count = max(1, int(np.ceil(duration / STEP_TIME)))
        way = start.interpolate(end, np.arange(1, count + 1) / count)
        for X_WT in way:
            solution = solve_ik(robot, X_WT, rng=rng, seeds=q, restarts=0)
            step = np.abs(solution.q - q)
            if not solution.success or np.any(step > robot.limits.velocity * duration / count):
                return False
            q = solution.q
    return True
