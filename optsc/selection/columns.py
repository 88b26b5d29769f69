"""What a reach table can measure of its rows besides the manipulability, on request: these take longer.

A cost or a filter names the columns it reads, and only those that the rule or a filter names are worked out.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.geometry.rotation import Array

if TYPE_CHECKING:
    from optsc.robot import RobotModel
    from optsc.selection.motion import StraightMotion

CLEARANCE = "clearance"
"""Least clearance at pre-grasp and grasp [m]: to the arm itself, to the table and to all but the grasped object."""
WAY = "way"
"""1 where the arm gets from where it stands to the pre-grasp and on to the grasp on straight lines, else 0."""
WAY_SPEED = "speed on the way"
"""Greatest share of its velocity limit that a joint needs on that way, at most `WORST_SPEED` [-]."""
WAY_MANIPULABILITY = "manipulability on the way"
"""Least manipulability on that way."""
WAY_CLEARANCE = "clearance on the way"
"""Least clearance on that way [m]."""
COLUMNS = (CLEARANCE, WAY, WAY_SPEED, WAY_MANIPULABILITY, WAY_CLEARANCE)
ON_THE_WAY = frozenset({WAY, WAY_SPEED, WAY_MANIPULABILITY, WAY_CLEARANCE})
WORST_SPEED = 2.0
"""What a way counts that the arm does not get along: twice what its joints can do."""
OVERLAP = -0.1
"""Clearances below this [m] all count as this: how deep capsules overlap tells nothing."""


class Measure(Protocol):
    """How well the arm can move: `optsc.robot.manipulability.Manipulability`, or anything alike."""

    def evaluate(self, robot: RobotModel, q: Array) -> Array:
        """Return the measure (...) at postures ``q`` (..., n); higher is better."""


@runtime_checkable
class TellsDistances(Protocol):
    """A collision check that also knows clearances: `optsc.selection.GraspClearance`."""

    def distances(self, q: Array, hand_may_touch: np.ndarray | None) -> Array:
        """Return the clearances (R,) [m] of postures (R, n), but for an object each that the hand may touch."""


class RowsToMeasure(NamedTuple):
    """R rows that were reached.

    Attributes:
        robot: the arm.
        seeds: (R, n) where the arm stood.
        q_pregrasp, q_grasp: (R, n) postures.
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


def needed(parts: Iterable[Any]) -> frozenset[str]:
    """Return the columns that costs and filters read."""
    return frozenset().union(*(part.columns for part in parts))


def checked(columns: frozenset[str], motion: StraightMotion | None, clear: Any) -> frozenset[str]:
    """Return ``columns`` if they can be measured; raise `UnknownName` or `InvalidValue` if not."""
    for name in sorted(columns):
        if name not in COLUMNS:
            raise UnknownName("column", name, COLUMNS)
        if name in ON_THE_WAY and motion is None:
            raise InvalidValue(f"motion for the {name}", None, "a StraightMotion")
        if name in (CLEARANCE, WAY_CLEARANCE) and not isinstance(clear, TellsDistances):
            raise InvalidValue(
                f"collision check for the {name}", clear, "one that knows distances: GraspClearance"
            )
    return columns


def measure(
    columns: frozenset[str],
    rows: RowsToMeasure,
    manipulability: Measure,
    motion: StraightMotion | None,
    clear: Any,
) -> dict[str, Array]:
    """Return the ``columns`` (R,) of rows; see `checked` for what they need."""
    found: dict[str, Array] = {}
    if CLEARANCE in columns:
        at_grasp = clear.distances(rows.q_grasp, rows.names)
        found[CLEARANCE] = np.maximum(np.minimum(at_grasp, clear.distances(rows.q_pregrasp, None)), OVERLAP)
    if not columns & ON_THE_WAY or motion is None:
        return found
    travel = motion.travel(rows.seeds, rows.X_WP, rows.X_WG)
    found[WAY] = travel.gone.astype(float)
    found[WAY_SPEED] = np.where(travel.gone, np.minimum(travel.speed, WORST_SPEED), WORST_SPEED)
    if WAY_MANIPULABILITY in columns:
        M = manipulability.evaluate(rows.robot, travel.postures)
        M = np.where(np.isfinite(M), M, 0.0)
        # Where the arm gets stuck it cannot move as it should.
        found[WAY_MANIPULABILITY] = np.where(travel.gone, M.min(axis=1), 0.0)
    if WAY_CLEARANCE in columns:
        count, each, n = travel.postures.shape
        names = np.where(travel.close, rows.names[:, None], "")
        distance = clear.distances(travel.postures.reshape(-1, n), names.ravel())
        found[WAY_CLEARANCE] = np.maximum(distance.reshape(count, each).min(axis=1), OVERLAP)
    return found
