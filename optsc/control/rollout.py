"""Looking ahead: whether the arm can go where it is about to be sent."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from optsc.control.approach import Approach
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel
from optsc.robot.ways import walk_straight


def can_travel(robot: RobotModel, settings: Approach, q: Array, waypoints: Sequence[Pose]) -> bool:
    """Tell whether an arm in posture ``q`` (n,) can lead its tool along the straight way through ``waypoints``.

    The way is followed in short steps, each from the posture of the one before; it ends where a pose has no posture
    within the joint limits, or only one that the joints cannot get to in time. A grasp may well be reached and its
    pre-grasp too, and yet lie behind a joint limit on the way.
    """
    start, *others = waypoints
    return bool(which_can_travel(robot, settings, q, start, [X_WT[None] for X_WT in others])[0])


def which_can_travel(
    robot: RobotModel, settings: Approach, q: Array, start: Pose, waypoints: Sequence[Pose]
) -> np.ndarray:
    """Return which of N ways (N,) an arm in posture ``q`` (n,) can lead its tool along; see `can_travel`.

    All ways begin at the pose ``start``; ``waypoints`` has for each leg the poses (N,) at its end.
    """
    gone = np.ones(len(waypoints[0]), dtype=bool)
    postures = np.repeat(np.asarray(q, dtype=float)[None], len(gone), axis=0)
    begin = Pose(np.tile(start.quaternion, (len(gone), 1)), np.tile(start.translation, (len(gone), 1)))
    for here, there in pairwise([begin, *waypoints]):
        rows = np.flatnonzero(gone)
        walk = walk_straight(
            robot,
            postures[rows],
            here[rows],
            there[rows],
            speed=settings.speed,
            angular_speed=settings.angular_speed,
        )
        gone[rows], postures[rows] = walk.gone, walk.q
    return gone
