"""Cluttered tabletop scenes to evaluate perception: objects that stand and lie close together, an arm above them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pybullet

from optsc.checks import AtLeast, Below, Between, Share, require
from optsc.errors import InvalidValue, SolverFailure
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel
from optsc.sim import bullet_bodies
from optsc.sim.bullet_client import BulletClient, body_pose, place_body
from optsc.sim.objects import OBJECT_NAMES, ObjectModel, object_model
from optsc.sim.settings import PhysicsSettings
from optsc.sim.tabletop import Tabletop
from optsc.sim.workspace import comfortable_band

AREA_RADIUS = 0.16
"""Four objects are put down within this distance of the middle of the arm's workspace [m]."""
DROP = 0.002
"""Objects are let go this far above the table [m]."""
LONGEST_SETTLING = 4.0
"""A scene that still moves after this time is drawn again [s]."""
_HOVER_RADIUS, _HOVER_HEIGHTS = 0.12, (0.10, 0.30)
"""The hand is as near as random configurations come to a point this far from the objects' middle, this high [m]."""
_SCENES, _PLACES, _CONFIGURATIONS = 40, 60, 512
_STILL = (2e-3, 2e-2)  # [m/s], [rad/s]
_CHECK_EVERY, _CALM_CHECKS = 25, 4  # simulation steps


@dataclass(frozen=True, eq=False)
class ClutteredScene:
    """A table with objects at rest and an arm that hovers above them, in contact with nothing.

    Attributes:
        world: the objects where they came to rest.
        q: a configuration of the arm with its hand above the objects (n,) [rad].
        lying: names of the objects that do not stand on their base.
    """

    world: Tabletop
    q: Array
    lying: frozenset[str]


def cluttered_tabletop(
    robot: RobotModel,
    seed: int = 0,
    *,
    objects: Sequence[str | ObjectModel] | None = None,
    lying: float = 0.4,
    gap: float = 0.004,
    spread: float = 1.0,
) -> ClutteredScene:
    """Return three to five objects, upright and lying, that physics has brought to rest close together.

    Args:
        robot: the arm.
        seed: same robot, arguments and seed, same scene.
        objects: names from `OBJECT_NAMES` or user-defined models, each name once; three to five at random by
            default.
        lying: chance of an object to be put down on its side [-].
        gap: least distance between two objects when they are let go [m].
        spread: the area, four objects within `AREA_RADIUS`, is larger by this factor along both sides [-].

    Raises:
        InvalidValue: a name twice, a setting out of range, or more objects than fit.
        UnknownName: there is no object of that name.
        SolverFailure: nothing came to rest in many tries.
    """
    require("lying", lying, Share)
    require("gap", gap, AtLeast(0.0), Below(0.2))
    require("spread", spread, Between(0.3, 3.0))
    rng = np.random.default_rng(seed)
    models = _drawn(objects, rng)
    with BulletClient() as simulation:
        table = _SettlingTable(simulation, models)
        for _ in range(_SCENES):
            if table.put_down(robot, rng, lying, gap, spread) and table.settled():
                break
        else:
            raise SolverFailure(f"{[m.name for m in models]} did not come to rest in {_SCENES} tries")
        poses = table.poses()
    world = Tabletop(robot, {m.name: m for m in models}, poses, int(seed))
    upright = {name for name, X in poses.items() if X.rotation_matrix()[2, 2] > 0.98}
    return ClutteredScene(world, _hovering(world, rng), frozenset(poses) - upright)


def _drawn(objects: Sequence[str | ObjectModel] | None, rng: np.random.Generator) -> list[ObjectModel]:
    if objects is None:
        objects = [str(name) for name in rng.choice(OBJECT_NAMES, size=rng.integers(3, 6), replace=False)]
    models = [object_model(entry) if isinstance(entry, str) else entry for entry in objects]
    names = [model.name for model in models]
    if not names or len(set(names)) < len(names):
        raise InvalidValue("objects", names, "at least one, each name once")
    return models


class _SettlingTable:
    """A simulated table with objects but without an arm."""

    def __init__(self, simulation: BulletClient, models: Sequence[ObjectModel]) -> None:
        self._client, self._models, settings = simulation.client, models, PhysicsSettings()
        simulation.set_physics(settings.time_step, settings.solver_iterations)
        bullet_bodies.add_table(self._client)
        away = Pose.from_translation([0.0, 0.0, 5.0])
        self._bodies = [bullet_bodies.add_object(self._client, model, away) for model in models]
        for body in self._bodies:  # what rolls would roll for minutes
            pybullet.changeDynamics(
                body,
                -1,
                linearDamping=0.5,
                angularDamping=0.9,
                rollingFriction=2e-4,
                physicsClientId=self._client,
            )
        self._X_OM = [bullet_bodies.inertia(m.mesh, m.mass).X_OM for m in models]

    def put_down(self, robot: RobotModel, rng: np.random.Generator, lying: float, gap: float, spread: float) -> bool:
        """Put the objects at random places, the largest first, and tell whether all found one."""
        band = comfortable_band(robot)
        radius = spread * AREA_RADIUS * np.sqrt(len(self._models) / 4.0)
        for i in range(len(self._models)):
            self._move(i, Pose.from_translation([0.0, 0.0, 5.0 + i]))
        largest_first = np.argsort([-np.linalg.norm(m.mesh.extents) for m in self._models], kind="stable")
        for i in largest_first.tolist():
            R = _attitude(rng, bool(rng.random() < lying))
            height = DROP - float(rotation.rotate(R, self._models[i].mesh.vertices)[:, 2].min())
            for _ in range(_PLACES):
                r, angle = radius * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
                x = 0.5 * (band.inner + band.outer) + r * np.cos(angle)
                self._move(i, Pose(R, np.array([x, r * np.sin(angle), height])))
                if self._free(i, gap):
                    break
            else:
                return False
        return True

    def _move(self, i: int, X_WO: Pose) -> None:
        place_body(self._client, self._bodies[i], X_WO @ self._X_OM[i])
        pybullet.resetBaseVelocity(self._bodies[i], [0.0] * 3, [0.0] * 3, physicsClientId=self._client)

    def _free(self, i: int, gap: float) -> bool:
        others = [body for body in self._bodies if body != self._bodies[i]]
        return not any(
            pybullet.getClosestPoints(self._bodies[i], other, gap, physicsClientId=self._client) for other in others
        )

    def settled(self) -> bool:
        """Simulate until nothing moves; tell whether that happened in time and on the table."""
        calm, steps = 0, round(LONGEST_SETTLING / PhysicsSettings().time_step)
        for step in range(1, steps + 1):
            pybullet.stepSimulation(physicsClientId=self._client)
            if step % _CHECK_EVERY == 0:
                calm = calm + 1 if self._calm() else 0
                if calm >= _CALM_CHECKS:
                    return all(X.translation[2] > -0.02 for X in self.poses().values())
        return False

    def _calm(self) -> bool:
        for body in self._bodies:
            linear, angular = pybullet.getBaseVelocity(body, physicsClientId=self._client)
            if np.linalg.norm(linear) > _STILL[0] or np.linalg.norm(angular) > _STILL[1]:
                return False
        return True

    def poses(self) -> dict[str, Pose]:
        """Return X_WO of the objects."""
        rows = zip(self._models, self._bodies, self._X_OM, strict=True)
        return {model.name: body_pose(self._client, body) @ X_OM.inverse() for model, body, X_OM in rows}


def _attitude(rng: np.random.Generator, lying: bool) -> Array:
    """Return the quaternion of an object on its base or on a random side, turned about the vertical."""
    yaw, side = rng.uniform(-np.pi, np.pi, 2)
    turn = rotation.exp(np.array([0.0, 0.0, yaw]))
    if not lying:
        return turn
    return rotation.multiply(turn, rotation.exp(0.5 * np.pi * np.array([np.cos(side), np.sin(side), 0.0])))


def _hovering(world: Tabletop, rng: np.random.Generator) -> Array:
    """Return a configuration (n,) [rad] with the hand above the objects that touches nothing; else the home one."""
    from optsc.collision import CollisionModel

    robot = world.robot
    scene = CollisionModel(robot).scene(world.placed_parts, margin=0.01)
    middle = np.mean([X.translation for X in world.X_WO.values()], axis=0)
    r, angle = _HOVER_RADIUS * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
    wanted = middle[:2] + r * np.array([np.cos(angle), np.sin(angle)])
    place = np.array([*wanted, rng.uniform(*_HOVER_HEIGHTS)])
    q = robot.limits.clip(robot.home + rng.normal(0.0, 0.5, (_CONFIGURATIONS, robot.n)))
    q = q[np.argsort(np.linalg.norm(robot.forward(q).translation - place, axis=1), kind="stable")]
    clear = np.flatnonzero(scene.clear(q[: _CONFIGURATIONS // 4]).clear)
    return np.array(q[clear[0]] if len(clear) else robot.home)
