"""Command and status of a tick: whether the tool is at its target, and what holds it back if not.

The distance that counts is that of the commanded tool to the target that the reference is led to, at the end of the
tick, in the components of the tool's pose that have a weight, beyond their dead bands. The first line that holds:

| status | when |
|---|---|
| `FOLLOWING` | distance <= 1 mm + 20 ms * speed and angle <= 5 mrad + 20 ms * angular speed of the target |
| `BLOCKED` | a row of collision avoidance holds the wished velocity back |
| `LIMITED` | the wished velocity of a joint is at an end of its viable interval |
| `SINGULAR` | manipulability below a tenth of the arm's typical one, and most of the error in the lost direction |
| `UNREACHABLE` | the target rests, and nothing leads nearer |
| `CATCHING_UP` | none of these: the tool is on its way |

With little to gain (see `optsc.kernels.settling`) and the tool beyond `ServoSettings.far` from its target, the three in
the middle are `UNREACHABLE`, too, with the same reason. While following, the reason is empty, or says that a joint
still moves for the preferred configuration although the target rests.
"""

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
FOLLOWING_WITHIN = (1e-3, 5e-3)
"""Distance and angle [m, rad] of a following tool to a target at rest."""
FOLLOWING_DELAY = 0.02
"""How far behind a moving target it may be besides [s] (tuned here)."""
STILL = 0.02
"""Share of a joint's greatest velocity from which on its motion beside a target at rest is told (tuned here)."""
ROUNDING = 1e-6
"""Share of a bound that counts as rounding: what a QP solver leaves."""
DIRECTIONS = ("along x", "along y", "along z", "about x", "about y", "about z")


class Status(Enum):
    """What a tick did; `Command.reason` says why, in words."""

    FOLLOWING = "following"
    CATCHING_UP = "catching up with the target"
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
        error: target minus commanded tool pose (6,), in the tool frame, in the components that have a weight, beyond
            their dead bands [m, rad]; zero where the arm is led to no target.
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
    """What held the motion of a tick back, and why, in words."""

    status: Status
    reason: str

    @classmethod
    def spare(cls, robot: RobotModel, velocity: Array) -> Verdict:
        """Return the verdict on a tool at a target at rest, whose joints still have a velocity (n,) [rad/s]."""
        joint = int(np.argmax(np.abs(velocity) / robot.limits.velocity))
        return cls(Status.FOLLOWING, f"{robot.joint_names[joint]} moves for the preferred configuration")


FOLLOWING = Verdict(Status.FOLLOWING, "")


def within(distance: float, angle: float, speed: float, turning: float) -> bool:
    """Tell whether distance and angle [m, rad] to a target of these speeds [m/s, rad/s] count as following."""
    most_distance, most_angle = FOLLOWING_WITHIN
    return distance <= (most_distance + FOLLOWING_DELAY * speed) * (1.0 + ROUNDING) and angle <= (
        most_angle + FOLLOWING_DELAY * turning
    ) * (1.0 + ROUNDING)


class Miss(NamedTuple):
    """How a tool misses its target.

    Attributes:
        error: (6,) in the tool frame, in the components that count [m, rad].
        sizes: its distance and angle [m, rad].
        far: whether it is beyond `ServoSettings.far`.
        stalled: whether there is little to gain, see `optsc.kernels.settling`.
        singular: whether the manipulability is low.
    """

    error: Array
    sizes: tuple[float, float]
    far: bool
    stalled: bool
    singular: bool


def judge(robot: RobotModel, guard: JointGuard, wished: Array, near: Nearness | None, miss: Miss) -> Verdict:
    """Return why the tool is not at its target; the table of the module says what holds when.

    Args:
        robot: the arm.
        guard: its joints, before they move.
        wished: the velocity (n,) [rad/s] that the quadratic program wished.
        near: the pair of bodies that avoidance keeps apart there, if any.
        miss: how the tool misses its target.
    """
    found = held_back(robot, guard, wished, near, Bound.POSITION if miss.stalled else Bound.JERK)
    if found is None and miss.singular:
        found = near_singularity(robot, guard.q, miss.error)
    if found is not None:
        return found._replace(status=Status.UNREACHABLE) if miss.far and miss.stalled else found
    if miss.stalled:
        return Verdict(Status.UNREACHABLE, f"no joint leads nearer than {_distance(miss.sizes)}")
    return Verdict(Status.CATCHING_UP, f"{_distance(miss.sizes)} behind")


def _distance(sizes: tuple[float, float]) -> str:
    return f"{1e3 * sizes[0]:.1f} mm and {np.degrees(sizes[1]):.1f} degrees"


def held_back(
    robot: RobotModel, guard: JointGuard, wished: Array, near: Nearness | None, least: Bound = Bound.JERK
) -> Verdict | None:
    """Return what holds a wished velocity (n,) back, if anything does: something near, or a limit of a joint.

    Of limits those count from ``least`` on: an arm that has come to rest is held by positions, not by rates.
    """
    if near is not None:
        return Verdict(Status.BLOCKED, f"{near.link} is {1e3 * near.distance:.0f} mm from {near.other}")
    room = ROUNDING * guard.limits.velocity
    at_low = (wished <= guard.lowest + room) & (guard.bounds[:, 0] >= least)
    at_high = (wished >= guard.highest - room) & (guard.bounds[:, 1] >= least)
    if not (at_low | at_high).any():
        return None
    joint = int(np.argmax(at_low | at_high))
    bound = Bound(int(guard.bounds[joint, int(at_high[joint])]))
    return Verdict(Status.LIMITED, f"{robot.joint_names[joint]}: {bound.name.lower()}")


def near_singularity(robot: RobotModel, q: Array, error: Array) -> Verdict | None:
    """Return that an arm near a singularity lags in the direction it is losing, if it does.

    Args:
        robot: the arm.
        q: its configuration (n,) [rad].
        error: target minus tool pose (6,), in the tool frame [m, rad].
    """
    lost = lost_direction(robot, q)
    if towards(lost, error) < 0.5:
        return None
    reason = f"motion {lost.name} of the tool is lost (least singular value {lost.singular_value:.3f} m)"
    return Verdict(Status.SINGULAR, reason)


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
