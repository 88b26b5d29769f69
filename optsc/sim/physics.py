"""Physics simulation of a tabletop world in PyBullet: bodies, steps and contacts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.sim import bullet_bodies
from optsc.sim.bullet_arm import BulletArm
from optsc.sim.bullet_client import BulletClient
from optsc.sim.settings import PhysicsSettings
from optsc.sim.tabletop import Tabletop


class Physics(BulletClient):
    """The running simulation of a `Tabletop`; a context manager. Nothing moves but in `step`.

    Args:
        world: the arm, the objects and where they stand; the arm starts at its home configuration.
        gui: whether PyBullet's window is opened; it needs a display.
        settings: time step, gains, friction and so on.

    Raises:
        InvalidValue: a window where there is no display, or a joint that the arm's description lacks.
    """

    def __init__(self, world: Tabletop, *, gui: bool = False, settings: PhysicsSettings | None = None) -> None:
        super().__init__(gui)
        self.world, self.settings, self._gui = world, settings or PhysicsSettings(), gui
        try:
            if gui:
                self._arrange_window()
            self.reset(world.robot.home)
        except BaseException:
            self.close()
            raise

    def _arrange_window(self) -> None:
        pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0, physicsClientId=self.client)
        pybullet.resetDebugVisualizerCamera(1.4, 125.0, -30.0, [0.3, 0.0, 0.1], physicsClientId=self.client)

    def _build(self) -> None:
        client, world, settings = self.client, self.world, self.settings
        pybullet.resetSimulation(physicsClientId=client)
        self.set_physics(settings.time_step, settings.solver_iterations)
        self._table, self._floor = bullet_bodies.add_table(client)
        # Friction of velocities alone lets objects at rest creep and turn, 0.2 mm and 5 mrad in 5 s.
        pybullet.changeDynamics(self._table, -1, frictionAnchor=1, physicsClientId=client)
        self._arm = BulletArm(client, world.robot, settings, visible=self._gui)
        for link in self._arm.bolted:  # the base is bolted to the table and does not push against it
            pybullet.setCollisionFilterPair(
                self._arm.body, self._table, link, -1, enableCollision=0, physicsClientId=client
            )
        self._bodies = {
            name: bullet_bodies.add_object(client, model, world.X_WO[name], visible=self._gui)
            for name, model in world.objects.items()
        }
        # PyBullet reports the principal frame M of the mass.
        frames = [bullet_bodies.inertia(m.mesh, m.mass).X_OM.inverse() for m in world.objects.values()]
        self._X_MO = Pose.stack(frames) if frames else Pose.identity((0,))
        self._names = {self._table: "table", self._floor: "floor", **{b: n for n, b in self._bodies.items()}}

    @property
    def time(self) -> float:
        """Simulated time since the last `reset` [s]."""
        return self._steps * self.settings.time_step

    def reset(self, q: ArrayLike) -> None:
        """Put the arm at ``q`` (n,) [rad] at rest, jaws open, the objects where they stood; time becomes 0.

        Everything is built again, so that what follows is the same, bit for bit, whatever happened before: a
        state that PyBullet restores lacks what its broad phase and its solver store.
        Raises `InvalidValue`.
        """
        robot = self.world.robot
        configuration = robot.checked(q)
        if configuration.ndim != 1:
            raise InvalidValue("q", configuration.tolist(), f"finite, shape ({robot.n},) [rad]")
        pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_RENDERING, 0, physicsClientId=self.client)
        self._build()
        pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_RENDERING, 1, physicsClientId=self.client)
        opening = robot.gripper.max_opening if robot.gripper else 0.0
        self._arm.place(configuration.tolist(), [0.0] * robot.n, opening)
        self._steps = 0

    def place(self, q: Array, v: Array, opening: float, time: float) -> None:
        """Put the arm at ``q`` (n,) [rad] with velocity ``v`` (n,) [rad/s], its pads ``opening`` [m] apart.

        The objects stay where they are; simulated time goes on from ``time`` [s].
        """
        _ = self.client
        self._arm.place(q.tolist(), v.tolist(), opening)
        self._steps = round(time / self.settings.time_step)

    def step(self, q: Sequence[float], v: Sequence[float], opening: float) -> None:
        """Simulate one time step. Values are trusted: plain floats, since PyBullet misreads some arrays.

        Args:
            q: where the arm should be at the beginning of the step (n,) [rad].
            v: its mean velocity during the step (n,) [rad/s].
            opening: what the jaws move towards [m]; if what is between them is wider, they press on it.
        """
        client = self.client
        self._arm.drive(q, v)
        self._arm.move_jaws(opening)
        pybullet.stepSimulation(physicsClientId=client)
        self._steps += 1

    def joints(self) -> tuple[Array, Array]:
        """Return positions (n,) [rad] and velocities (n,) [rad/s] of the arm's joints."""
        _ = self.client
        return self._arm.state()

    def opening(self) -> float:
        """Return the distance between the pads [m]; 0 for an arm without a gripper."""
        _ = self.client
        return self._arm.opening()

    def poses(self) -> dict[str, Pose]:
        """Return X_WO of every object."""
        client = self.client
        frames = [pybullet.getBasePositionAndOrientation(b, physicsClientId=client) for b in self._bodies.values()]
        if not frames:
            return {}
        p, xyzw = np.array([f[0] for f in frames]), np.array([f[1] for f in frames])
        X_WO = Pose(np.roll(xyzw, 1, axis=-1), p) @ self._X_MO
        return {name: X_WO[i] for i, name in enumerate(self._bodies)}

    def contacts(self, name: str) -> frozenset[str]:
        """Return what presses on an object: links of the arm, other objects, ``table`` or ``floor``.

        As of the last step; the arm's root link is called ``base``. Raises `UnknownName`.
        """
        if name not in self._bodies:
            raise UnknownName("object", name, self._bodies)
        points = pybullet.getContactPoints(bodyA=self._bodies[name], physicsClientId=self.client)
        return frozenset(self._name_of(p[2], p[4]) for p in points if p[9] > 0.0)

    def held(self, name: str) -> bool:
        """Tell whether both jaws press on an object; raise `UnknownName`."""
        contacts = self.contacts(name)
        fingers = [self._arm.link_names[index] for index in self._arm.fingers]
        return bool(fingers) and contacts.issuperset(fingers)

    def _name_of(self, body: int, link: int) -> str:
        return self._arm.link_names[link] if body == self._arm.body else self._names[body]
