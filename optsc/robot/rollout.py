"""Straight-line rollouts: how far an arm gets along straight tool paths, many of them at once."""

from __future__ import annotations

from collections.abc import Sequence
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
def _kernel(robot: RobotModel) -> tuple[BatchKernel, tuple[Array, Array]]:
    """Return the compiled rollout, and what all paths share: joint positions and velocities at most."""
    shared = np.concatenate(robot.limits.positions), robot.limits.velocity
    return build_batch_kernel(rollout(robot.chain), PATHS_PER_LOOP, shared=2), shared


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


class PathRollout(NamedTuple):
    """Rollouts of N paths of several straight legs, each leg from the configuration at the end of the one before.

    Attributes:
        completed: (N,) which paths were followed to their end.
        speed: (N,) greatest share of its velocity limit that any joint needed.
        q: (N, n) the last configuration of each.
        legs: for each path the configurations (S, n) of each leg, as far as it was followed.
        rolled: how many legs were rolled out altogether.
    """

    completed: np.ndarray
    speed: Array
    q: Array
    legs: tuple[tuple[Array, ...], ...]
    rolled: int


def path_rollout(
    robot: RobotModel,
    q: ArrayLike,
    start: Pose,
    waypoints: Sequence[Pose],
    *,
    speed: float,
    angular_speed: float,
) -> PathRollout:
    """Move the tool from a pose straight through ``waypoints``, N poses for each leg; see `straight_line_rollout`.

    Args:
        robot: the arm.
        q: configuration (n,) or (N, n) [rad] that holds the tool at the start.
        start: the pose X_WT at the start, () or (N,).
        waypoints: poses (N,) at the end of each leg.
        speed, angular_speed: of the tool [m/s, rad/s].

    Raises:
        InvalidValue: as for `straight_line_rollout`.
    """
    count = len(waypoints[0])
    ends = np.stack([X_WT.quaternion for X_WT in waypoints]), np.stack([X_WT.translation for X_WT in waypoints])
    quaternion, p = (np.empty_like(end) for end in ends)
    quaternion[0], p[0] = start.quaternion, start.translation
    quaternion[1:], p[1:] = ends[0][:-1], ends[1][:-1]
    turn = rotation.log(rotation.multiply(ends[0], rotation.conjugate(quaternion)))
    shift = ends[1] - p
    configurations = np.array(np.broadcast_to(robot.checked(q), (count, robot.n)))
    completed, greatest, rolled = np.ones(count, dtype=bool), np.zeros(count), 0
    legs: list[list[Array]] = [[] for _ in range(count)]
    for k in range(len(waypoints)):
        rows = np.flatnonzero(completed)
        if not len(rows):
            break
        some = configurations[rows]
        one = _rolled_out(
            robot, some, quaternion[k, rows], p[k, rows], shift[k, rows], turn[k, rows], (speed, angular_speed)
        )
        rolled += len(rows)
        completed[rows], configurations[rows] = one.completed, one.q
        greatest[rows] = np.maximum(greatest[rows], one.speed)
        for row, steps, found in zip(rows.tolist(), one.steps.tolist(), one.configurations, strict=True):
            legs[row].append(found[:steps])
    return PathRollout(completed, greatest, configurations, tuple(map(tuple, legs)), rolled)


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
    if not (speeds[0] > 0.0 and speeds[1] > 0.0):
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
    kernel, limits = _kernel(robot)
    last, flat = kernel(at_start, line, steps, pace, shared=limits)
    done = last[:, n]
    return StraightLineRollout(
        q=last[:, :n],
        end=last[:, n + 2].astype(np.int8),
        share=done / steps[:, 0],
        speed=last[:, n + 1],
        steps=done.astype(np.int64),
        configurations=flat.reshape(count, STEPS, n),
    )
