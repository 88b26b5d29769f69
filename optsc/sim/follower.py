"""PyBullet follower: an arm whose joint drives track, jaws that press, objects that move."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from types import TracebackType

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import Closed, InvalidValue, UnknownName
from optsc.followers.protocol import FollowerState, checked_command, one_configuration
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel
from optsc.sim.physics import Physics
from optsc.sim.settings import PhysicsSettings
from optsc.sim.tabletop import Tabletop


class PyBulletFollower:
    """A `Follower` in a simulated world: it starts on construction, at the home configuration, and needs closing.

    Between two commands the arm is led along the cubic that has both commands' positions and velocities, and
    gets a new target at every simulation step: a drive that holds one for a whole period lags behind it.

    Args:
        world: the arm, the objects and where they stand.
        gui: whether PyBullet's window is opened; it needs a display.
        settings: of the simulation. A control period has to be a whole number of its time steps.

    Raises:
        InvalidValue: see `Physics`.
    """

    def __init__(self, world: Tabletop, gui: bool = False, *, settings: PhysicsSettings | None = None) -> None:
        self.world = world
        self._physics: Physics | None = Physics(world, gui=gui, settings=settings)
        self._last = self._at_rest(world.robot.home)

    @property
    def robot(self) -> RobotModel:
        """The arm."""
        return self.world.robot

    @property
    def physics(self) -> Physics:
        """The simulation, for contacts and pictures; raise `Closed` after `close`."""
        if self._physics is None:
            raise Closed("follower")
        return self._physics

    def state(self) -> FollowerState:
        """Return where the arm is now, as the simulation has it."""
        physics = self.physics
        q, v = physics.joints()
        return FollowerState(physics.time, q, v, physics.opening())

    def reset(self, q: ArrayLike) -> FollowerState:
        """Put the arm at ``q`` (n,) [rad] at rest with open jaws and the objects where they stood.

        The same commands give the same bytes after every reset and in every new follower.
        Raises `InvalidValue`.
        """
        physics, configuration = self.physics, one_configuration(self.robot, q)
        physics.reset(configuration)
        self._last = self._at_rest(configuration)
        return self.state()

    def at(self, state: FollowerState) -> PyBulletFollower:
        """Put the arm where ``state`` says, and return the follower; the objects stay, see `Follower.at`.

        Raises `InvalidValue` for a state of another arm.
        """
        q, v = one_configuration(self.robot, state.q), one_configuration(self.robot, state.v, "v")
        self.physics.place(q, v, state.opening, state.time)
        self._last = q, v
        return self

    def apply(self, q: ArrayLike, v: ArrayLike, opening: float, period: float) -> FollowerState:
        """Simulate one control period, see `Follower.apply`.

        The jaws press on what is between them when the opening is less than its width. Raises `InvalidValue`
        also if the period is not a whole number of simulation steps.
        """
        physics = self.physics
        command = checked_command(self.robot, q, v, opening, period)
        steps = self._steps(command.period)
        knots = np.stack([*self._last, command.q, command.v])
        knots[[1, 3]] *= command.period
        positions = _cubic(steps) @ knots
        speeds = np.diff(positions, axis=0) / physics.settings.time_step
        for position, speed in zip(positions.tolist(), speeds.tolist(), strict=False):
            physics.step(position, speed, command.opening)
        self._last = command.q, command.v
        return self.state()

    def objects(self) -> Mapping[str, Pose]:
        """Return the true poses X_WO of the objects."""
        return self.physics.poses()

    def held(self, name: str) -> bool:
        """Tell whether both jaws press on the object; raise `UnknownName`."""
        return self.physics.held(name)

    def height(self, name: str) -> float:
        """Return how high the object's base is above the table [m]; raise `UnknownName`."""
        poses = self.objects()
        if name not in poses:
            raise UnknownName("object", name, poses)
        return float(poses[name].translation[2])

    def close(self) -> None:
        """End the simulation; closing again does nothing."""
        if self._physics is not None:
            self._physics.close()
            self._physics = None

    def _steps(self, period: float) -> int:
        step = self.physics.settings.time_step
        count = round(period / step)
        if count < 1 or abs(count * step - period) > 1e-6 * period:
            valid = f"a whole number of simulation steps of {step} s, as at 250, 500 and 1000 Hz with 1 ms"
            raise InvalidValue("period", period, valid)
        return count

    @staticmethod
    def _at_rest(q: Array) -> tuple[Array, Array]:
        return q, 0.0 * q

    def __enter__(self) -> PyBulletFollower:
        if self._physics is None:
            raise Closed("follower")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@lru_cache(maxsize=16)
def _cubic(steps: int) -> Array:
    """Return the weights (steps + 1, 4) of q0, T v0, q1, T v1 at equal times: cubic Hermite interpolation."""
    s = np.linspace(0.0, 1.0, steps + 1)
    return np.stack([1 - 3 * s**2 + 2 * s**3, s - 2 * s**2 + s**3, 3 * s**2 - 2 * s**3, s**3 - s**2], axis=-1)
