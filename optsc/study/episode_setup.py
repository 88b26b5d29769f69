"""Episode setup: a scene with its grasps, collision check, controller and follower, for any number of conditions."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

import optsc
from optsc.checks import Checked, OneOf, Positive
from optsc.collision import CollisionModel, GraspClearance
from optsc.collision.distances import DistanceModel
from optsc.collision.model import TABLE
from optsc.control.approach import Approach
from optsc.control.arbitration import Arbitration
from optsc.control.controller import SharedController
from optsc.followers import IdealFollower
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps import GraspLibrary
from optsc.metrics import NearestDistance
from optsc.operators import ClutchSettings
from optsc.people.simulated import R_WS_DEFAULT
from optsc.records import SceneUpdate
from optsc.robot import RobotModel
from optsc.selection import GraspSelector
from optsc.sim import OBJECT_NAMES, ObjectModel, Tabletop, object_model
from optsc.study.conditions import PAPER, Condition, OperatorSpec
from optsc.study.fingerprint import fingerprint, plain
from optsc.study.libraries import grasps_hash, library_of
from optsc.study.scenes import Scene
from optsc.study.stateless_selector import StatelessSelector, Tables

if TYPE_CHECKING:
    from optsc.sim.follower import PyBulletFollower

ENGINE = 3
"""Version of what a row means; part of every key, raised whenever rows of equal settings would differ."""
FOLLOWERS = ("ideal", "pybullet")
ELSEWHERE = Pose.from_translation([1e3, 0.0, 0.0])
"""Where the objects of the catalogue are that a scene does not have."""
LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk")


@dataclass(frozen=True)
class EpisodeSettings(Checked):
    """What all conditions of a study share.

    Attributes:
        rate: control rate [Hz].
        longest: time limit [s]; of an approach, up to the hand-over.
        follower: ``ideal``, an arm that is where it was commanded to be, or ``pybullet``, one in a simulated world.
        approach: how the robot moves by itself.
        library: folder of a grasp library (`optsc.GraspLibrary`) whose grasps are chosen from, such as imported or
            observed ones; by default grasps are sampled on the objects. The key of a row depends on the grasps and
            not on the folder, which has to be there for every process.
    """

    rate: Annotated[float, Positive] = 250.0
    longest: Annotated[float, Positive] = 30.0
    follower: Annotated[str, OneOf(FOLLOWERS, "follower")] = "ideal"
    approach: Approach = field(default_factory=Approach)
    library: str | Path | None = None


def true_scene(world: Tabletop, library: GraspLibrary) -> SceneUpdate:
    """Return the grasps of ``library`` where the objects of ``world`` are, and the collision check of the arm."""
    clear = GraspClearance(collision_model(world.robot).scene(world.placed_parts))
    return SceneUpdate(library.place(world.X_WO), clear)


def controller_with(
    selector: GraspSelector, approach: Approach, arbitration: Arbitration | None = None
) -> SharedController:
    """Return a controller that chooses by ``selector``, with the simulated operators' mapping of the hand.

    It decides at once: what a condition chooses follows from the moment of the trigger, and from no time-out.
    """
    return SharedController(
        selector.robot,
        selector,
        arbitration=arbitration,
        approach=approach,
        clutch=ClutchSettings(R_WS=R_WS_DEFAULT),
        real_time=False,
    )


@lru_cache(maxsize=4)
def collision_model(robot: RobotModel) -> CollisionModel:
    """Return the collision geometry of ``robot``, kept."""
    return CollisionModel(robot)


def episode_key(scene: Scene, person: OperatorSpec, settings: EpisodeSettings) -> str:
    """Return a hash of everything but the condition that determines a row.

    Raises what `library_of` does: `UnknownName` for an object without stored grasps, for one.
    """
    robot = scene.robot_model()
    limits = {name: np.nan_to_num(getattr(robot.limits, name)) for name in LIMITS}
    grasps = grasps_hash(robot, tuple(scene.object_models().values()), settings.library)
    # The same grasps from another folder are the same grasps.
    shared = {f.name: plain(getattr(settings, f.name)) for f in fields(settings) if f.name != "library"}
    return fingerprint([ENGINE, optsc.__version__, scene.hash, grasps, person.describe(), shared, limits, robot.home])


class EpisodeSetup:
    """A scene with everything that an episode in it needs.

    Attributes:
        scene, settings: what it was made from.
        world, robot: the tabletop, and the arm before it.
        library, candidates: grasps of the objects, and the same where the objects are.
        clear: which candidates the arm can reach without collision.
        tables: solved reach tables, shared by the controllers that are given them.
        paper: the paper's condition.
    """

    def __init__(self, scene: Scene, settings: EpisodeSettings) -> None:
        self.scene, self.settings = scene, settings
        self.world = scene.world()
        self.robot = self.world.robot
        self.library = library_of(self.robot, tuple(self.world.objects.values()), settings.library)
        self.candidates, self.clear = true_scene(self.world, self.library)
        self.tables = Tables()
        self.paper = PAPER

    def controller(
        self, condition: Condition, tables: Tables | None = None, arbitration: Arbitration | None = None
    ) -> SharedController:
        """Return a controller for ``condition``, with solved tables of its own unless given some."""
        approach = self.settings.approach
        selector = StatelessSelector(self.robot, condition.rule, condition.measure, approach, tables)
        return controller_with(selector, approach, arbitration)

    def follower(self, *, gui: bool = False) -> IdealFollower | PyBulletFollower:
        """Return a new follower of the kind that the settings name; it needs closing."""
        if self.settings.follower == "ideal":
            return IdealFollower(self.robot, self.world.X_WO, self.candidates)
        # Studies without physics do not load the engine.
        from optsc.sim.follower import PyBulletFollower

        return PyBulletFollower(self.world, gui=gui)


def nearest_distance(setup: EpisodeSetup) -> NearestDistance:
    """Return the distance of configurations to table and objects; the hand may touch the goal.

    Links are capsules and objects boxes around their parts, so it is never more than the true one.
    """
    own = tuple(model for model in setup.world.objects.values() if model not in _catalogue())
    model, world = _distance_model(setup.robot, own)
    for name in dict.fromkeys((*OBJECT_NAMES, *setup.world.objects)):
        model.move(name, setup.world.X_WO.get(name, ELSEWHERE))
    model.hand_may_touch(setup.scene.goal)

    def nearest(q: Array) -> Array:
        return np.array([model.distances(row)[0][world].min() for row in q])

    return nearest


def _catalogue() -> tuple[ObjectModel, ...]:
    return tuple(object_model(name) for name in OBJECT_NAMES)


@lru_cache(maxsize=4)
def _distance_model(robot: RobotModel, own: tuple[ObjectModel, ...]) -> tuple[DistanceModel, np.ndarray]:
    """Return distances of ``robot`` to the catalogue's objects and ``own``, kept, and which pairs are not within it."""
    obstacles = {model.name: (model.parts, ELSEWHERE) for model in (*_catalogue(), *own)}
    model = DistanceModel(robot, obstacles)
    return model, np.flatnonzero([pair.other in (*obstacles, TABLE) for pair in model.pairs])
