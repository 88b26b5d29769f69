"""Path feasibility: whether the arm can follow the straight path to a grasp, and what it would touch on it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from enum import IntEnum
from itertools import pairwise
from typing import TypeVar

import numpy as np

from optsc.control.approach import Approach
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates
from optsc.robot import RobotModel
from optsc.robot.rollout import path_rollout, straight_line_rollout
from optsc.selection import Target
from optsc.selection.reach import ClearRows

_Item = TypeVar("_Item")

SPEED_LIMIT_SHARE = 0.5
"""Share of a joint's velocity limit (tuned here): a servo that is damped near singularities lags behind beyond it."""


class PathFeasibility(IntEnum):
    """How well the arm can follow the straight path to a grasp, and up from there; the less, the better."""

    FREE = 0
    """It can, and touches nothing."""
    SPEED_LIMITED = 1
    """The same, but some joint comes near its greatest speed, as it does near a singularity."""
    COLLIDING = 2
    """It can, but would touch something."""
    INFEASIBLE = 3
    """It cannot."""


def most_feasible(items: Iterable[_Item], feasibility: Callable[[_Item], PathFeasibility]) -> _Item | None:
    """Return the first item with a free path, without any the first with the next best path, else None.

    A path that would touch something is better than none: what is known of a scene errs on the careful side, and the
    operator sees what happens.
    """
    best, taken = PathFeasibility.INFEASIBLE, None
    for item in items:
        found = feasibility(item)
        if found < best:
            best, taken = found, item
        if best is PathFeasibility.FREE:
            break
    return taken


def grasp_path(settings: Approach, X_WT: Pose, X_WP: Pose, X_WG: Pose) -> list[Pose]:
    """Return the poses between which the robot moves straight to execute a grasp, from X_WT on.

    The lift belongs to it: with an object in the hand there is no other grasp to go to.

    Args:
        settings: how the robot moves by itself.
        X_WT, X_WP, X_WG: the tool now, at the pre-grasp and at the grasp.
    """
    lifted = Pose(X_WG.quaternion, X_WG.translation + [0.0, 0.0, settings.lift])
    return [X_WT, X_WP, X_WG, lifted]


def grasp_path_feasibility(
    robot: RobotModel,
    settings: Approach,
    q: Array,
    X_WT: Pose,
    target: Target,
    candidates: Candidates,
    clear: ClearRows | None = None,
) -> PathFeasibility:
    """Return how well the arm can follow the straight path to a grasp, and up with the object.

    Args:
        robot: the arm.
        settings: how it moves by itself.
        q: its configuration (n,) [rad].
        X_WT: where its tool is led from.
        target: the grasp, one of ``candidates``.
        candidates: the grasps of the scene.
        clear: the scene's collision check; without it nothing is in the way. What is touched up to the pre-grasp
            counts, and from there on what is touched but for the object by the hand.
    """
    legs: list[Array] = []
    speed = 0.0
    for here, there in pairwise(grasp_path(settings, X_WT, target.X_WP, target.X_WG)):
        rollout = straight_line_rollout(
            robot,
            q if not legs else legs[-1][-1],
            here,
            Pose.stack([there]),
            speed=settings.speed,
            angular_speed=settings.angular_speed,
        )
        if not rollout.completed[0]:
            return PathFeasibility.INFEASIBLE
        legs.append(rollout.configurations[0, : int(rollout.steps[0])])
        speed = max(speed, float(rollout.speed[0]))
    good = PathFeasibility.FREE if speed <= SPEED_LIMIT_SHARE else PathFeasibility.SPEED_LIMITED
    if clear is None:
        return good
    before, at_it = legs[0], np.concatenate(legs[1:])
    # Both are checked in one call, so the end of the shorter one is repeated.
    rows = np.arange(max(len(before), len(at_it)))
    before, at_it = (part[np.minimum(rows, len(part) - 1)] for part in (before, at_it))
    free = clear(at_it, before, candidates.select(np.full(len(rows), target.candidate)))
    return good if np.all(free) else PathFeasibility.COLLIDING


def can_travel(robot: RobotModel, settings: Approach, q: Array, waypoints: Sequence[Pose]) -> bool:
    """Tell whether an arm in configuration ``q`` (n,) can lead its tool along the straight path through ``waypoints``.

    The path is followed in short steps, each from the configuration of the one before; it ends where a pose has no
    configuration within the joint limits, or only one that the joints cannot get to in time. A grasp may be reached and
    its pre-grasp too, and yet lie behind a joint limit on the path.
    """
    start, *others = waypoints
    return bool(which_can_travel(robot, settings, q, start, [X_WT[None] for X_WT in others])[0])


def which_can_travel(
    robot: RobotModel, settings: Approach, q: Array, start: Pose, waypoints: Sequence[Pose]
) -> np.ndarray:
    """Return which of N paths (N,) an arm in configuration ``q`` (n,) can lead its tool along; see `can_travel`.

    All paths begin at the pose ``start``; ``waypoints`` has for each leg the poses (N,) at its end.
    """
    return path_rollout(
        robot, q, start, waypoints, speed=settings.speed, angular_speed=settings.angular_speed
    ).completed
