"""Command and status of a tick: what held the motion back, also near a singularity."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np

from optsc.geometry.rotation import Array
from optsc.ik.avoidance import Nearness
from optsc.kernels.viable import Bound
from optsc.robot import RobotModel
from optsc.shaping import JointGuard

LENGTH = 0.15
"""Metres that a radian counts for where linear and angular velocities are compared: the reach of a gripper."""
DIRECTIONS = ("along x", "along y", "along z", "about x", "about y", "about z")


class Status(Enum):
    """What a tick did; `Command.reason` says why, in words."""

    FOLLOWING = "following"
    LIMITED = "held back by a joint limit"
    BLOCKED = "held back by something near"
    SINGULAR = "near a singularity"
    UNREACHABLE = "the target is out of reach"
    STALE = "no new target for too long"
    LATE = "the loop is late"
    INVALID = "the target was refused"
    STOPPING = "coming to rest"
    HOLDING = "at rest"
    LED = "led to where the arm is"
    UNSOLVED = "the solver found no motion"


class Command(NamedTuple):
    """One tick's joint command.

    Attributes:
        q, v, a: position, velocity and acceleration (n,) [rad, rad/s, rad/s^2]; a is the difference of v per tick.
        status: what the tick did.
        reason: why, in words; empty while following.
        error: reference minus commanded tool pose (6,), in the tool frame [m, rad].
        volume: Yoshikawa's index at the commanded configuration.
        iterations: of the solver.
        slack: how far the velocities had to miss the rows of collision avoidance [m/s]; zero while none had to give.
        outside: how far the joint furthest beyond its position limits is beyond them [rad]; zero when all are inside.
        late: by how much the tick came later than one period after the one before [s], where the loop says the time.
        missing: by how much the ticks so far have moved the command less than time has passed [s], likewise.
    """

    q: Array
    v: Array
    a: Array
    status: Status
    reason: str
    error: Array
    volume: float
    iterations: int
    slack: float = 0.0
    outside: float = 0.0
    late: float = 0.0
    missing: float = 0.0


def error_text(error: Exception) -> str:
    """Return type and message of an error, also of one whose message cannot be made."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # noqa: BLE001 - it may be a user's error with a faulty __str__
        return type(error).__name__


class Verdict(NamedTuple):
    """What held the motion of a tick back, and why, in words; the reason is empty while following."""

    status: Status
    reason: str


FOLLOWING = Verdict(Status.FOLLOWING, "")


def held_back(robot: RobotModel, guard: JointGuard, wanted: Array, near: Nearness | None, far: bool) -> Verdict:
    """Return what holds the velocity ``wanted`` (n,) [rad/s] back at this tick.

    Args:
        robot: the arm.
        guard: its joints, whose viable interval ``wanted`` lies in.
        wanted: the velocity that the arm is given.
        near: the pair of bodies that avoidance keeps apart here, if any.
        far: whether the target is so far that it counts as out of reach.
    """
    if near is not None:
        reason = f"{near.link} is {1e3 * near.distance:.0f} mm from {near.other}"
        return Verdict(Status.UNREACHABLE if far else Status.BLOCKED, reason)
    at_low, at_high = wanted <= guard.lowest, wanted >= guard.highest
    if not (at_low | at_high).any():
        return Verdict(Status.UNREACHABLE, "no joint leads nearer") if far else FOLLOWING
    joint = int(np.argmax(at_low | at_high))
    bound = Bound(int(guard.bounds[joint, int(at_high[joint])]))
    reason = f"{robot.joint_names[joint]}: {bound.name.lower()}"
    return Verdict(Status.UNREACHABLE if far else Status.LIMITED, reason)


def near_singularity(robot: RobotModel, q: Array, error: Array, verdict: Verdict) -> Verdict:
    """Return the verdict on an arm near a singularity: that it lags in the direction it is losing, if it does.

    Args:
        robot: the arm.
        q: its configuration (n,) [rad].
        error: reference minus tool pose (6,), in the tool frame [m, rad].
        verdict: what holds it back besides.
    """
    if verdict.status in (Status.LIMITED, Status.BLOCKED):
        return verdict
    lost = lost_direction(robot, q)
    if towards(lost, error) < 0.5:
        return verdict
    reason = f"motion {lost.name} of the tool is lost (least singular value {lost.singular_value:.3f} m)"
    status = verdict.status if verdict.status is Status.UNREACHABLE else Status.SINGULAR
    return Verdict(status, reason)


class LostDirection(NamedTuple):
    """The direction (6,) of the tool frame that the arm can move least in, and its least singular value [m]."""

    direction: Array
    singular_value: float

    @property
    def name(self) -> str:
        """The axis of the tool that it is mostly along or about."""
        return DIRECTIONS[int(np.argmax(np.abs(self.direction)))]


def lost_direction(robot: RobotModel, q: Array) -> LostDirection:
    """Return the direction of the tool that is lost most at configuration ``q`` (n,): the last left singular vector.

    Angular rows of the Jacobian are scaled by `LENGTH`, so that its singular values have one unit. Below six joints the
    directions that no configuration gives are left out.
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
