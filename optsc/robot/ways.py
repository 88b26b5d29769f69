"""Straight ways of the tool, as the arm would go them: many at once, posture by posture."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.kernels.kernel import BatchKernel, build_batch_kernel
from optsc.kernels.rollout import STEPS, walk
from optsc.robot.model import RobotModel

STEP_TIME = 0.15
"""Time between two postures that are looked at [s]: 15 mm at the paper's speed."""
LOOP = 4
"""Ways in one compiled loop: few, because a place left empty is walked as well."""
REASONS = ("", "joint limits", "joint speed")
"""What ended a way, in words, by its code."""


class Walk(NamedTuple):
    """N ways as they were walked.

    Attributes:
        q: the last posture (N, n) [rad].
        end: (N,) what ended the way, an index into `REASONS`; 0 where it was gone to its end.
        share: (N,) of the way that was gone.
        speed: (N,) greatest share of its velocity limit that any joint needed, also at the step that failed.
        steps: (N,) number of postures that were reached, at most `STEPS`.
        postures: (N, STEPS, n) the postures one after another; after the last one it is repeated.
    """

    q: Array
    end: np.ndarray
    share: Array
    speed: Array
    steps: np.ndarray
    postures: Array

    @property
    def gone(self) -> np.ndarray:
        """Which ways (N,) were gone to their end."""
        return self.end == 0


@lru_cache(maxsize=16)
def _kernel(robot: RobotModel) -> BatchKernel:
    return build_batch_kernel(walk(robot.chain), LOOP, shared=2)


def duration(shift: Array, turn: Array, speed: float, angular_speed: float) -> Array:
    """Return how long ways (N,) take [s] at a steady speed: of the tool's path, or of its turn where that is slower."""
    return np.maximum(np.linalg.norm(shift, axis=-1) / speed, np.linalg.norm(turn, axis=-1) / angular_speed)


def walk_straight(
    robot: RobotModel,
    q: ArrayLike,
    start: Pose,
    end: Pose,
    *,
    speed: float,
    angular_speed: float,
) -> Walk:
    """Lead the tool along straight ways, turning about one axis, and return how far the arm gets.

    A way ends where the tool's next pose has no posture within the joint limits near the last one, or one that the
    joints cannot get to in time.

    Args:
        robot: the arm.
        q: postures (n,) or (N, n) [rad] that hold the tool at the starts.
        start: poses X_WT, () or (N,).
        end: poses X_WT (N,).
        speed, angular_speed: of the tool [m/s, rad/s].

    Raises:
        InvalidValue: a posture or pose is not finite, a speed not positive, or shapes do not fit.
    """
    if not (0.0 < speed < np.inf and 0.0 < angular_speed < np.inf):
        raise InvalidValue("speeds of the tool", (speed, angular_speed), "positive and finite")
    first = np.broadcast_to(start.quaternion, (len(end), 4))
    turn = rotation.log(rotation.multiply(end.quaternion, rotation.conjugate(first)))
    shift = end.translation - start.translation
    return _walk(robot, q, first, start.translation, shift, turn, (speed, angular_speed))


def walk_forwards(
    robot: RobotModel, q: ArrayLike, start: Pose, distance: float, *, speed: float, angular_speed: float
) -> Walk:
    """Lead the tool forwards along its own approach axis (z) from N poses; see `walk_straight`.

    Args:
        robot: the arm.
        q: postures (n,) or (N, n) [rad] that hold the tool at the starts.
        start: poses X_WT (N,).
        distance: how far [m].
        speed, angular_speed: of the tool [m/s, rad/s].

    Raises:
        InvalidValue: a posture or pose is not finite, or shapes do not fit.
    """
    w, x, y, z = start.quaternion.T
    axis = np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)
    none = np.zeros((len(start), 3))
    speeds = (speed, angular_speed)
    return _walk(robot, q, start.quaternion, start.translation, distance * axis, none, speeds)


def _walk(
    robot: RobotModel,
    q: ArrayLike,
    quaternion: Array,
    p: Array,
    shift: Array,
    turn: Array,
    speeds: tuple[float, float],
) -> Walk:
    count, n = len(shift), robot.n
    line = np.empty((count, 13))
    line[:, :4], line[:, 4:7], line[:, 7:10], line[:, 10:] = quaternion, p, shift, turn
    if not np.isfinite(line).all():
        raise InvalidValue("poses of a way", line.tolist(), "finite")
    time = duration(shift, turn, *speeds)
    steps = np.clip(np.ceil(time / STEP_TIME), 1, STEPS)[:, None]
    pace = np.maximum(time[:, None], 1e-6) / steps
    postures = np.broadcast_to(robot.checked(q), (count, n))
    limits = np.concatenate([robot.limits.lower, robot.limits.upper])
    walked, flat = _kernel(robot)(postures, line, steps, pace, shared=(limits, robot.limits.velocity))
    done = walked[:, n]
    return Walk(
        q=walked[:, :n],
        end=walked[:, n + 2].astype(np.int8),
        share=done / steps[:, 0],
        speed=walked[:, n + 1],
        steps=done.astype(np.int64),
        postures=flat.reshape(count, STEPS, n),
    )
