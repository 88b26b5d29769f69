"""An arm that follows every command perfectly: no simulator, no dependency, no surprises."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType, TracebackType
from typing import NamedTuple

from numpy.typing import ArrayLike

from optsc.errors import Closed, InvalidValue
from optsc.followers.between import BetweenPads, GraspedObjects
from optsc.followers.protocol import JAW_SPEED, FollowerState, checked_command, one_configuration
from optsc.geometry import Pose
from optsc.grasps import Candidates
from optsc.robot import RobotModel


class _Gripped(NamedTuple):
    """An object in the jaws: its name, its width [m], and its displacement D in W seen from the tool, X_TW D."""

    name: str
    width: float
    X_TD: Pose


class IdealFollower:
    """A `Follower` whose joints are where they are commanded to be.

    Its jaws close until they touch what is between the pads. From then on that object moves with the tool, until the
    jaws open: it stays where it is let go of, as nothing falls. Nothing else moves an object.

    Args:
        robot: the arm; it starts at its home configuration.
        objects: poses X_WO by name that `objects` reports.
        between: what is between the pads: the grasps of the objects while they stand where they begin, or anything that
            tells it, see `BetweenPads`; None for nothing, so that the jaws close on nothing.
        jaw_speed: rate of the opening [m/s].

    Raises:
        InvalidValue: an impossible speed of the jaws, or a grasp without a width.
    """

    def __init__(
        self,
        robot: RobotModel,
        objects: Mapping[str, Pose] | None = None,
        between: Candidates | BetweenPads | None = None,
        *,
        jaw_speed: float = JAW_SPEED,
    ) -> None:
        if not 0.0 < jaw_speed < float("inf"):
            raise InvalidValue("jaw_speed", jaw_speed, "finite, above 0 m/s")
        self.robot = robot
        self._between = GraspedObjects(between) if isinstance(between, Candidates) else between
        self._start = MappingProxyType(dict(objects or {}))
        self._jaw_speed, self._closed = jaw_speed, False
        self.reset(robot.home)

    def state(self) -> FollowerState:
        """Return where the arm is now; the arrays are copies."""
        self._check_open()
        time, q, v, opening = self._state
        return FollowerState(time, q.copy(), v.copy(), opening)

    def reset(self, q: ArrayLike) -> FollowerState:
        """Put the arm at ``q`` (n,) [rad] at rest with open jaws, and the objects where they began.

        Raises `InvalidValue`.
        """
        self._check_open()
        configuration = one_configuration(self.robot, q)
        opening = self.robot.gripper.max_opening if self.robot.gripper else 0.0
        self._state = FollowerState(0.0, configuration, 0.0 * configuration, opening)
        self._moved: dict[str, Pose] = {}
        self._gripped: _Gripped | None = None
        return self.state()

    def at(self, state: FollowerState) -> IdealFollower:
        """Put the arm where ``state`` says, in motion if it says so, and return the follower; see `Follower.at`.

        What it held stays where it is.
        """
        self._check_open()
        q, v = one_configuration(self.robot, state.q), one_configuration(self.robot, state.v, "v")
        self._state, self._gripped = FollowerState(state.time, q, v, state.opening), None
        return self

    def apply(self, q: ArrayLike, v: ArrayLike, opening: float, period: float) -> FollowerState:
        """Take the command as the new state, see `Follower.apply`; the jaws move at their speed."""
        self._check_open()
        command = checked_command(self.robot, q, v, opening, period)
        before, step = self._state.opening, self._jaw_speed * command.period
        jaws = min(max(command.opening, before - step), before + step)
        jaws = self._touching(command.q, before, jaws)
        self._state = FollowerState(self._state.time + command.period, command.q, command.v, jaws)
        return self.state()

    def _touching(self, q: ArrayLike, before: float, jaws: float) -> float:
        """Return where the jaws get to on their way to an opening ``jaws`` [m], and take along what they hold."""
        gripped = self._gripped
        if gripped is None and self._between is not None and jaws < before:
            X_WT = self.robot.forward(q)
            found = self._between(X_WT, self._moved)
            # What is wider than the jaws is not between them.
            if found is not None and jaws <= found.width <= before:
                displaced = self._moved.get(found.object_name, Pose.identity())
                gripped = _Gripped(found.object_name, found.width, X_WT.inverse() @ displaced)
        elif gripped is not None and jaws > gripped.width:
            gripped = None
        self._gripped = gripped
        if gripped is None:
            return jaws
        self._moved = {**self._moved, gripped.name: self.robot.forward(q) @ gripped.X_TD}
        return max(jaws, gripped.width)

    def objects(self) -> Mapping[str, Pose]:
        """Return the poses X_WO given at construction, but for objects that the arm has moved."""
        self._check_open()
        if not self._moved:
            return self._start
        moved = self._moved
        return {name: moved[name] @ X_WO if name in moved else X_WO for name, X_WO in self._start.items()}

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
