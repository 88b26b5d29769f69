"""Straight-line rollouts: how far an arm gets along straight tool paths, many of them at once."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import Positive, require
from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.kernels.kernel import BatchKernel, build_batch_kernel
from optsc.kernels.rollout import STEPS, rollout
from optsc.robot.model import RobotModel

STEP_TIME = 0.15
"""Time between two configurations that are evaluated [s]: 15 mm at the paper's speed."""
PATHS_PER_LOOP = 4
"""Paths in one compiled loop: few, because an empty place costs as much as a path."""
ROLLOUT_ENDS = ("", "joint limits", "joint speed")
"""What ended a rollout, in words, by its code."""


class StraightLineRollout(NamedTuple):
    """Rollouts of N paths.

    Attributes:
        q: the last configuration (N, n) [rad].
        end: (N,) what ended the rollout, an index into `ROLLOUT_ENDS`; 0 where the path was completed.
        share: (N,) of the path that was completed.
        speed: (N,) greatest share of its velocity limit that any joint needed, also at the step that failed.
        steps: (N,) number of configurations that were reached, at most `STEPS`.
        configurations: (N, STEPS, n) one after another; after the last one it is repeated.
    """

    q: Array
    end: np.ndarray
    share: Array
    speed: Array
    steps: np.ndarray
    configurations: Array

    @property
    def completed(self) -> np.ndarray:
        """Which paths (N,) were followed to their end."""
        return self.end == 0


@lru_cache(maxsize=16)
def _kernel(robot: RobotModel) -> BatchKernel:
    return build_batch_kernel(rollout(robot.chain), PATHS_PER_LOOP, shared=2)


def duration(shift: Array, turn: Array, speed: float, angular_speed: float) -> Array:
    """Return how long paths (N,) take [s] at steady speeds: as long as the shift or the turn, whichever is slower."""
    return np.maximum(np.linalg.norm(shift, axis=-1) / speed, np.linalg.norm(turn, axis=-1) / angular_speed)


def straight_line_rollout(
    robot: RobotModel,
    q: ArrayLike,
    start: Pose,
    end: Pose,
    *,
    speed: float,
    angular_speed: float,
) -> StraightLineRollout:
    """Move the tool along straight lines, turning about one axis, and return how far the arm gets.

    A rollout ends where the tool's next pose has no configuration within the joint limits near the last one, or one
    that the joints cannot reach in time.

    Args:
        robot: the arm.
        q: configurations (n,) or (N, n) [rad] that hold the tool at the starts.
        start: poses X_WT, () or (N,).
        end: poses X_WT (N,).
        speed, angular_speed: of the tool [m/s, rad/s].

    Raises:
        InvalidValue: a configuration or pose is not finite, a speed not positive, or shapes do not fit.
    """
    first = np.broadcast_to(start.quaternion, (len(end), 4))
    turn = rotation.log(rotation.multiply(end.quaternion, rotation.conjugate(first)))
    shift = end.translation - start.translation
    return _rolled_out(robot, q, first, start.translation, shift, turn, (speed, angular_speed))


def forward_rollout(
    robot: RobotModel, q: ArrayLike, start: Pose, distance: float, *, speed: float, angular_speed: float
) -> StraightLineRollout:
    """Move the tool along its own approach axis (z) by ``distance`` [m] from N poses; see `straight_line_rollout`."""
    w, x, y, z = start.quaternion.T
    axis = np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)
    none, speeds = np.zeros((len(start), 3)), (speed, angular_speed)
    return _rolled_out(robot, q, start.quaternion, start.translation, distance * axis, none, speeds)


def _rolled_out(
    robot: RobotModel,
    q: ArrayLike,
    quaternion: Array,
    p: Array,
    shift: Array,
    turn: Array,
    speeds: tuple[float, float],
) -> StraightLineRollout:
    require("speed of the tool", speeds[0], Positive)
    require("angular speed of the tool", speeds[1], Positive)
    count, n = len(shift), robot.n
    line = np.empty((count, 13))
    line[:, :4], line[:, 4:7], line[:, 7:10], line[:, 10:] = quaternion, p, shift, turn
    if not np.isfinite(line).all():
        raise InvalidValue("poses of a path", line.tolist(), "finite")
    time = duration(shift, turn, *speeds)
    steps = np.clip(np.ceil(time / STEP_TIME), 1, STEPS)[:, None]
    pace = np.maximum(time[:, None], 1e-6) / steps
    at_start = np.broadcast_to(robot.checked(q), (count, n))
    limits = np.concatenate(robot.limits.positions)
    last, flat = _kernel(robot)(at_start, line, steps, pace, shared=(limits, robot.limits.velocity))
    done = last[:, n]
    return StraightLineRollout(
        q=last[:, :n],
        end=last[:, n + 2].astype(np.int8),
        share=done / steps[:, 0],
        speed=last[:, n + 1],
        steps=done.astype(np.int64),
        configurations=flat.reshape(count, STEPS, n),
    )
