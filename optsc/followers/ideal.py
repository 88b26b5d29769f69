"""An arm that follows every command perfectly: no simulator, no dependency, no surprises."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType, TracebackType

from numpy.typing import ArrayLike

from optsc.errors import Closed, InvalidValue
from optsc.followers.protocol import JAW_SPEED, FollowerState, checked_command, one_configuration
from optsc.geometry import Pose
from optsc.robot import RobotModel


class IdealFollower:
    """A `Follower` whose joints are where they are commanded to be. Its objects never move.

    Args:
        robot: the arm; it starts at its home configuration.
        objects: poses X_WO by name that `objects` reports.
        jaw_speed: rate of the opening [m/s].

    Raises:
        InvalidValue: an impossible speed of the jaws.
    """

    def __init__(
        self,
        robot: RobotModel,
        objects: Mapping[str, Pose] | None = None,
        *,
        jaw_speed: float = JAW_SPEED,
    ) -> None:
        if not 0.0 < jaw_speed < float("inf"):
            raise InvalidValue("jaw_speed", jaw_speed, "finite, above 0 m/s")
        self.robot = robot
        self._objects = MappingProxyType(dict(objects or {}))
        self._jaw_speed, self._closed = jaw_speed, False
        self.reset(robot.home)

    def state(self) -> FollowerState:
        """Return where the arm is now; the arrays are copies."""
        self._check_open()
        time, q, v, opening = self._state
        return FollowerState(time, q.copy(), v.copy(), opening)

    def reset(self, q: ArrayLike) -> FollowerState:
        """Put the arm at ``q`` (n,) [rad] at rest with open jaws; raise `InvalidValue`."""
        self._check_open()
        configuration = one_configuration(self.robot, q)
        opening = self.robot.gripper.max_opening if self.robot.gripper else 0.0
        self._state = FollowerState(0.0, configuration, 0.0 * configuration, opening)
        return self.state()

    def at(self, state: FollowerState) -> IdealFollower:
        """Put the arm where ``state`` says, in motion if it says so, and return the follower; see `Follower.at`."""
        self._check_open()
        q, v = one_configuration(self.robot, state.q), one_configuration(self.robot, state.v, "v")
        self._state = FollowerState(state.time, q, v, state.opening)
        return self

    def apply(self, q: ArrayLike, v: ArrayLike, opening: float, period: float) -> FollowerState:
        """Take the command as the new state, see `Follower.apply`; the jaws move at their speed."""
        self._check_open()
        command = checked_command(self.robot, q, v, opening, period)
        step = self._jaw_speed * command.period
        jaws = min(max(command.opening, self._state.opening - step), self._state.opening + step)
        self._state = FollowerState(self._state.time + command.period, command.q, command.v, jaws)
        return self.state()

    def objects(self) -> Mapping[str, Pose]:
        """Return the poses X_WO given at construction."""
        self._check_open()
        return self._objects

    def close(self) -> None:
        """Refuse everything from now on; closing again does nothing."""
        self._closed = True

    def _check_open(self) -> None:
        if self._closed:
            raise Closed("follower")

    def __enter__(self) -> IdealFollower:
        self._check_open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
