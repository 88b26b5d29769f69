"""A scene made ready for any number of conditions: world, grasps, collisions, reach tables."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import optsc
from optsc.control.approach import Approach
from optsc.control.arbitration import Arbitration
from optsc.control.controller import SharedController
from optsc.errors import InvalidValue, UnknownName
from optsc.followers import IdealFollower
from optsc.operators import ClutchSettings
from optsc.people.simulated import R_WS_DEFAULT
from optsc.robot import RobotModel
from optsc.robot.collision import CollisionModel
from optsc.selection import GraspClearance
from optsc.study.conditions import PAPER, Condition, OperatorSpec
from optsc.study.fingerprint import fingerprint, plain
from optsc.study.fresh import FreshSelector, Tables
from optsc.study.libraries import grasps_hash, library_of
from optsc.study.scenes import Scene

if TYPE_CHECKING:
    from optsc.sim.follower import PyBulletFollower

ENGINE = 3
"""Version of what a row means; part of every key, raised whenever rows of equal settings would differ."""
FOLLOWERS = ("ideal", "pybullet")
LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk")


@dataclass(frozen=True)
class EpisodeSettings:
    """What all conditions of a study share.

    Attributes:
        rate: control rate [Hz].
        longest: an episode that has not handed over by then [s] never does.
        follower: ``ideal``, an arm that is where it was told to be, or ``pybullet``, one in a simulated world.
        approach: how the robot moves by itself.
        library: folder of a grasp library (`optsc.GraspLibrary`) whose grasps are chosen from, such as imported or
            seen ones; by default grasps are sampled on the objects. Rows are told apart by the grasps and not by the
            folder, which has to be there for every process.
    """

    rate: float = 250.0
    longest: float = 30.0
    follower: str = "ideal"
    approach: Approach = field(default_factory=Approach)
    library: str | Path | None = None

    def __post_init__(self) -> None:
        if self.follower not in FOLLOWERS:
            raise UnknownName("follower", self.follower, FOLLOWERS)
        for name in ("rate", "longest"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise InvalidValue(name, getattr(self, name), "positive and finite")


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
    return fingerprint(
        [ENGINE, optsc.__version__, scene.hash, grasps, person.describe(), shared, limits, robot.home]
    )


class EpisodeSetup:
    """A scene made ready: the world, its candidates, and which of them the arm can carry out."""

    def __init__(self, scene: Scene, settings: EpisodeSettings) -> None:
        self.scene, self.settings = scene, settings
        self.world = scene.world()
        self.robot = self.world.robot
        self.library = library_of(self.robot, tuple(self.world.objects.values()), settings.library)
        self.candidates = self.library.place(self.world.X_WO)
        obstacles = {name: (model.parts, self.world.X_WO[name]) for name, model in self.world.objects.items()}
        self.clear = GraspClearance(collision_model(self.robot).scene(obstacles))
        self.tables = Tables()
        self.paper = PAPER

    def controller(
        self, condition: Condition, tables: Tables | None = None, arbitration: Arbitration | None = None
    ) -> SharedController:
        """Return a controller for ``condition``, with solved tables of its own unless given some."""
        approach = self.settings.approach
        selector = FreshSelector(self.robot, condition.rule, condition.measure, approach, tables)
        clutch = ClutchSettings(R_WS=R_WS_DEFAULT)
        return SharedController(
            self.robot, selector, arbitration=arbitration, approach=approach, clutch=clutch
        )

    def follower(self, *, gui: bool = False) -> IdealFollower | PyBulletFollower:
        """Return a new follower of the kind that the settings name; it needs closing."""
        if self.settings.follower == "ideal":
            return IdealFollower(self.robot, self.world.X_WO)
        # Whoever needs no physics need not load the engine.
        from optsc.sim.follower import PyBulletFollower

        return PyBulletFollower(self.world, gui=gui)
