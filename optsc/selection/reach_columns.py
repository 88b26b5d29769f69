"""Columns of the reach table: clearance, path feasibility, joint speed and manipulability along the approach.

These take longer than the manipulability at the grasp. A cost or a filter names the columns that it reads; only those
that the rule or a filter names are measured.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from optsc.checks import Checked, Positive
from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.geometry.rotation import Array

if TYPE_CHECKING:
    from optsc.robot import RobotModel
    from optsc.robot.manipulability import ManipulabilityMeasure
    from optsc.robot.rollout import StraightLineRollout

CLEARANCE = "clearance"
"""Least clearance at pre-grasp and grasp [m]: to the arm itself, to the table and to all but the grasped object."""
PATH = "path"
"""1 where the arm gets from where it stands to the pre-grasp and on to the grasp on straight lines, else 0."""
PATH_SPEED = "speed on the path"
"""Greatest share of its velocity limit that a joint needs on that path, at most `WORST_SPEED` [-]."""
PATH_MANIPULABILITY = "manipulability on the path"
"""Least manipulability on that path."""
PATH_CLEARANCE = "clearance on the path"
"""Least clearance on that path [m]."""
COLUMNS = (CLEARANCE, PATH, PATH_SPEED, PATH_MANIPULABILITY, PATH_CLEARANCE)
ON_THE_PATH = frozenset({PATH, PATH_SPEED, PATH_MANIPULABILITY, PATH_CLEARANCE})
WORST_SPEED = 2.0
"""What a path counts that the arm cannot complete: twice what its joints can do."""
OVERLAP = -0.1
"""Clearances below this [m] all count as this: how deep capsules overlap tells nothing."""
TO_PREGRASP, TO_GRASP = 6, 2
"""Configurations at which the two parts of the path are measured."""


@runtime_checkable
class DistanceCheck(Protocol):
    """A collision check that also knows clearances, such as `optsc.collision.GraspClearance`."""

    def distances(self, q: Array, hand_may_touch: np.ndarray | None) -> Array:
        """Return the clearances (R,) [m] of configurations (R, n), but for an object each that the hand may touch."""


class ApproachRollout(NamedTuple):
    """R straight paths from the present configuration by the pre-grasps to the grasps, rolled out.

    Attributes:
        completed: (R,) whether the arm gets to the end.
        speed: (R,) greatest share of its velocity limit that any joint needs.
        q: (R, S, n) configurations, evenly spread over what is completed of each part [rad].
        close: (S,) which of them are on the last part, where the hand comes to the object.
    """

    completed: np.ndarray
    speed: Array
    q: Array
    close: np.ndarray


@dataclass(frozen=True, eq=False)
class StraightMotion(Checked):
    """The approach as it would be executed: straight to the pre-grasp and on to the grasp, rolled out step by step.

    Attributes:
        robot: the arm.
        speed, angular_speed: of the tool [m/s, rad/s], whichever takes longer on a path.
    """

    robot: RobotModel
    speed: Annotated[float, Positive] = 0.1
    angular_speed: Annotated[float, Positive] = 0.5

    def approach(self, q_pregrasp: Array, X_WP: Pose, standoff: float) -> tuple[Array, np.ndarray]:
        """Return the configurations (R, n) at the ends of lines from pre-grasp to grasp, and which are reached (R,).

        The grasp lies ``standoff`` [m] ahead of the pre-grasp along the approach axis.
        """
        from optsc.robot.rollout import forward_rollout

        line = forward_rollout(
            self.robot, q_pregrasp, X_WP, standoff, speed=self.speed, angular_speed=self.angular_speed
        )
        return line.q, line.completed

    def rollout(self, q: Array, X_WP: Pose, X_WG: Pose) -> ApproachRollout:
        """Return the paths from configurations ``q`` (R, n) by the pre-grasps to the grasps (R,)."""
        start = self.robot.forward(q[:1]) if np.all(q == q[0]) else self.robot.forward(q)
        first = self._line(q, start, X_WP)
        sampled = np.repeat(first.q[:, None], TO_PREGRASP + TO_GRASP, axis=1)
        sampled[:, :TO_PREGRASP] = _spread(first, TO_PREGRASP)
        completed, speed = first.completed.copy(), first.speed.copy()
        rows = np.flatnonzero(completed)
        last = self._line(first.q[rows], X_WP[rows], X_WG[rows])
        sampled[rows, TO_PREGRASP:] = _spread(last, TO_GRASP)
        completed[rows], speed[rows] = last.completed, np.maximum(speed[rows], last.speed)
        return ApproachRollout(completed, speed, sampled, np.arange(TO_PREGRASP + TO_GRASP) >= TO_PREGRASP)

    def _line(self, q: Array, start: Pose, end: Pose) -> StraightLineRollout:
        from optsc.robot.rollout import straight_line_rollout

        return straight_line_rollout(self.robot, q, start, end, speed=self.speed, angular_speed=self.angular_speed)


def _spread(line: StraightLineRollout, count: int) -> Array:
    """Return ``count`` configurations (R, count, n) of each line, the last one that was reached among them."""
    share = np.arange(1, count + 1) / count
    index = np.maximum(np.ceil(share * line.steps[:, None]).astype(np.int64) - 1, 0)
    # Where not a single step was completed, the first entry repeats where the arm stands.
    return np.take_along_axis(line.configurations, index[:, :, None], axis=1)


def needed(parts: Iterable[Any]) -> frozenset[str]:
    """Return the columns that costs and filters read."""
    return frozenset().union(*(part.columns for part in parts))


def require_measurable(columns: frozenset[str], motion: StraightMotion | None, clear: Any) -> None:
    """Raise `UnknownName` or `InvalidValue` unless ``columns`` can be measured with what is given."""
    for name in sorted(columns):
        if name not in COLUMNS:
            raise UnknownName("column", name, COLUMNS)
        if name in ON_THE_PATH and motion is None:
            raise InvalidValue(f"motion for the {name}", None, "a StraightMotion")
        if name in (CLEARANCE, PATH_CLEARANCE) and not isinstance(clear, DistanceCheck):
            raise InvalidValue(f"collision check for the {name}", clear, "one that knows distances: GraspClearance")


class ReachedRows(NamedTuple):
    """R rows that were reached.

    Attributes:
        robot: the arm.
        seeds: (R, n) where the arm stood.
        q_pregrasp, q_grasp: (R, n) configurations.
        X_WP, X_WG: (R,) poses.
        names: (R,) the objects.
    """

    robot: RobotModel
    seeds: Array
    q_pregrasp: Array
    q_grasp: Array
    X_WP: Pose
    X_WG: Pose
    names: np.ndarray


def measured(
    columns: frozenset[str],
    rows: ReachedRows,
    manipulability: ManipulabilityMeasure,
    motion: StraightMotion | None,
    clear: Any,
) -> dict[str, Array]:
    """Return the ``columns`` (R,) of rows; see `require_measurable` for what they need."""
    found: dict[str, Array] = {}
    if CLEARANCE in columns:
        at_grasp = clear.distances(rows.q_grasp, rows.names)
        found[CLEARANCE] = np.maximum(np.minimum(at_grasp, clear.distances(rows.q_pregrasp, None)), OVERLAP)
    if not columns & ON_THE_PATH or motion is None:
        return found
    path = motion.rollout(rows.seeds, rows.X_WP, rows.X_WG)
    found[PATH] = path.completed.astype(float)
    found[PATH_SPEED] = np.where(path.completed, np.minimum(path.speed, WORST_SPEED), WORST_SPEED)
    if PATH_MANIPULABILITY in columns:
        M = manipulability.evaluate(rows.robot, path.q)
        M = np.where(np.isfinite(M), M, 0.0)
        # Where the arm gets stuck it cannot move as it should.
        found[PATH_MANIPULABILITY] = np.where(path.completed, M.min(axis=1), 0.0)
    if PATH_CLEARANCE in columns:
        count, each, n = path.q.shape
        names = np.where(path.close, rows.names[:, None], "")
        distance = clear.distances(path.q.reshape(-1, n), names.ravel())
        found[PATH_CLEARANCE] = np.maximum(distance.reshape(count, each).min(axis=1), OVERLAP)
    return found
