"""The approach as it would be driven: straight to the pre-grasp and on to the grasp, posture by posture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose
from optsc.geometry.rotation import Array

if TYPE_CHECKING:
    from optsc.robot import RobotModel
    from optsc.robot.rollout import StraightLineRollout

TO_PREGRASP, TO_GRASP = 6, 2
"""Postures that are looked at on the two parts of the way."""


class Travel(NamedTuple):
    """R ways from the present posture to the grasps.

    Attributes:
        gone: (R,) whether the arm gets to the end.
        speed: (R,) greatest share of its velocity limit that any joint needs.
        postures: (R, S, n) postures on the way, evenly spread over what is gone of each part [rad].
        close: (S,) which of them are on the last part, where the hand comes to the object.
    """

    gone: np.ndarray
    speed: Array
    postures: Array
    close: np.ndarray


@dataclass(frozen=True, eq=False)
class StraightMotion:
    """How the robot leads its tool.

    Attributes:
        robot: the arm.
        speed, angular_speed: of the tool [m/s, rad/s], whichever takes longer on a way.
    """

    robot: RobotModel
    speed: float = 0.1
    angular_speed: float = 0.5

    def __post_init__(self) -> None:
        for name in ("speed", "angular_speed"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise InvalidValue(name, value, "positive and finite")

    def approach(self, q_pregrasp: Array, X_WP: Pose, standoff: float) -> tuple[Array, np.ndarray]:
        """Return the postures (R, n) at the ends of the lines from pre-grasp to grasp, and which are gone (R,).

        The grasp lies ``standoff`` [m] ahead of the pre-grasp along the approach axis.
        """
        from optsc.robot.rollout import forward_rollout

        rollout = forward_rollout(
            self.robot, q_pregrasp, X_WP, standoff, speed=self.speed, angular_speed=self.angular_speed
        )
        return rollout.q, rollout.completed

    def travel(self, q: Array, X_WP: Pose, X_WG: Pose) -> Travel:
        """Return the ways from postures ``q`` (R, n) by the pre-grasps to the grasps (R,)."""
        start = self.robot.forward(q[:1]) if np.all(q == q[0]) else self.robot.forward(q)
        first = self._rollout(q, start, X_WP)
        postures = np.repeat(first.q[:, None], TO_PREGRASP + TO_GRASP, axis=1)
        postures[:, :TO_PREGRASP] = _spread(first, TO_PREGRASP)
        gone, speed = first.completed.copy(), first.speed.copy()
        rows = np.flatnonzero(gone)
        last = self._rollout(first.q[rows], X_WP[rows], X_WG[rows])
        postures[rows, TO_PREGRASP:] = _spread(last, TO_GRASP)
        gone[rows], speed[rows] = last.completed, np.maximum(speed[rows], last.speed)
        return Travel(gone, speed, postures, np.arange(TO_PREGRASP + TO_GRASP) >= TO_PREGRASP)

    def _rollout(self, q: Array, start: Pose, end: Pose) -> StraightLineRollout:
        from optsc.robot.rollout import straight_line_rollout

        return straight_line_rollout(
            self.robot, q, start, end, speed=self.speed, angular_speed=self.angular_speed
        )


def _spread(rollout: StraightLineRollout, count: int) -> Array:
    """Return ``count`` postures (R, count, n) of each way, the last one that was reached among them."""
    share = np.arange(1, count + 1) / count
    index = np.maximum(np.ceil(share * rollout.steps[:, None]).astype(np.int64) - 1, 0)
    # Where not a single step was gone, the first entry repeats where the arm stands.
    return np.take_along_axis(rollout.configurations, index[:, :, None], axis=1)
