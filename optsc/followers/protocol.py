"""What the library asks of an arm, simulated or real: take a command per period, and say where it is."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel

JAW_SPEED = 0.1
"""Greatest rate of the opening [m/s] where nothing else is said."""
OPENING_TOLERANCE = 1e-6
"""How far a commanded opening may lie outside the jaws' range [m] before it is refused."""


class FollowerState(NamedTuple):
    """Where the arm is.

    Attributes:
        time: since the last reset [s].
        q: joint positions (n,) [rad].
        v: joint velocities (n,) [rad/s].
        opening: distance between the pads [m]; 0 for an arm without a gripper.
    """

    time: float
    q: Array
    v: Array
    opening: float


class Follower(Protocol):
    """An arm that follows joint commands; a context manager that closes itself."""

    def state(self) -> FollowerState:
        """Return where the arm is now."""
        ...

    def reset(self, q: ArrayLike) -> FollowerState:
        """Put the arm at ``q`` (n,) [rad] at rest, jaws open, the scene as at the start; time becomes 0."""
        ...

    def at(self, state: FollowerState) -> Follower:
        """Put the arm where ``state`` says, in motion or not, and return the follower itself.

        Objects stay where they are, and time goes on from that of the state. For runs that begin in the middle; an arm
        that cannot be put anywhere raises `InvalidValue`.
        """
        ...

    def apply(self, q: ArrayLike, v: ArrayLike, opening: float, period: float) -> FollowerState:
        """Follow one command for one control period and return where the arm is at its end.

        Args:
            q: joint positions at the end of the period (n,) [rad].
            v: joint velocities at the end of the period (n,) [rad/s].
            opening: where the jaws should go [m].
            period: [s].

        Raises:
            InvalidValue: a wrong shape, a value that is not finite or an impossible opening or period; the
                follower is then as it was.
        """
        ...

    def objects(self) -> Mapping[str, Pose]:
        """Return the true poses X_WO of the objects, by name; empty where there are none."""
        ...

    def close(self) -> None:
        """Let go of everything; closing again does nothing, anything else raises `Closed`."""
        ...

    def __enter__(self) -> Follower: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class CheckedCommand(NamedTuple):
    """A command that is one for the arm, see `Follower.apply`."""

    q: Array
    v: Array
    opening: float
    period: float


def checked_command(robot: RobotModel, q: ArrayLike, v: ArrayLike, opening: float, period: float) -> CheckedCommand:
    """Return a command from outside as floats; raise `InvalidValue` if it is none for ``robot``.

    Without a gripper any finite opening will do, and becomes 0.
    """
    if not 0.0 < period < np.inf:
        raise InvalidValue("period", period, "finite, above 0 s")
    return CheckedCommand(
        one_configuration(robot, q, "q"),
        one_configuration(robot, v, "v"),
        _opening(robot, opening),
        float(period),
    )


def _opening(robot: RobotModel, opening: float) -> float:
    if robot.gripper is None:
        if not np.isfinite(opening):
            raise InvalidValue("opening", opening, "finite")
        return 0.0
    widest = robot.gripper.max_opening
    if not -OPENING_TOLERANCE <= opening <= widest + OPENING_TOLERANCE:
        raise InvalidValue("opening", opening, f"0 to {widest} m")
    return float(min(max(opening, 0.0), widest))


def one_configuration(robot: RobotModel, q: ArrayLike, field: str = "q") -> Array:
    """Return one row of joint values (n,) from outside, copied; raise `InvalidValue`."""
    values = np.array(q, dtype=float)
    if values.shape != (robot.n,) or not np.all(np.isfinite(values)):
        raise InvalidValue(field, values.tolist(), f"finite, shape ({robot.n},)")
    return values
