"""Scene of a live session: an arm at a table with objects, its grasps, and the controller that a person drives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from optsc.checks import Between, Checked, OneOf, Positive, Where
from optsc.control.approach import Approach
from optsc.control.controller import SharedController
from optsc.control.servo import ServoSettings
from optsc.followers import IdealFollower
from optsc.followers.protocol import Follower
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps import GraspLibrary
from optsc.live.layout import Sizes
from optsc.live.settings_block import LiveSettings
from optsc.operators import ClutchSettings
from optsc.records import SceneUpdate
from optsc.robot import ROBOT_NAMES, RobotModel, load_robot
from optsc.selection import GraspSelector, Hysteresis
from optsc.sim import Tabletop, tabletop
from optsc.study.episode_setup import FOLLOWERS, true_scene
from optsc.study.libraries import library_of

JUMP, QUICK = (0.5, 2.0), (1000.0, 3000.0)
"""A hand that moves further from one sample to the next [m, rad], or speeds up more [m/s^2, rad/s^2], has jumped. The
page judges its trackers itself, frame by frame, and moves no hand faster than 0.8 m/s; on a loaded machine many of its
samples may be overtaken."""


@dataclass(frozen=True)
class SceneChoice(Checked):
    """Which scene: a value that every process of a session makes the same scene of.

    Attributes:
        robot: name of an arm of the catalogue.
        objects: names of what lies on the table.
        seed: of where they lie.
        follower: ``pybullet``, a simulated world in which things can be pushed and lifted, or ``ideal``, an arm that is
            where it was commanded to be and carries what it grasps, but pushes nothing.
        rate: of the control loop [Hz].
        timeout: after so long without a word from the page the arm holds [s].
    """

    robot: Annotated[str, OneOf(ROBOT_NAMES, "robot")] = "panda"
    objects: tuple[str, ...] = ("mug", "can", "box")
    seed: Annotated[int, Where("0 or more", lambda x: x >= 0)] = 0
    follower: Annotated[str, OneOf(FOLLOWERS, "follower")] = "pybullet"
    rate: Annotated[float, Positive] = 500.0
    timeout: Annotated[float, Between(0.05, 5.0)] = 0.1


class LiveScene:
    """The scene of a choice, with what is expensive in it made when it is asked for.

    Raises:
        UnknownName: no such robot or object.
        InvalidValue: the objects do not fit on the table.
    """

    def __init__(self, choice: SceneChoice) -> None:
        self.choice = choice
        self.robot: RobotModel = load_robot(choice.robot)
        self.world: Tabletop = tabletop(self.robot, choice.objects, choice.seed)

    @cached_property
    def library(self) -> GraspLibrary:
        """Grasps of the objects, sampled once and kept in the user's cache."""
        return library_of(self.robot, tuple(self.world.objects.values()))

    @cached_property
    def start(self) -> SceneUpdate:
        """The grasps and the collision check where the objects stand at the start."""
        return true_scene(self.world, self.library)

    @property
    def poses(self) -> Array:
        """Poses of the objects at the start (K, 7): position and unit quaternion."""
        return np.array([[*X.translation, *X.quaternion] for X in self.world.X_WO.values()])

    def seen(self, poses: Array) -> SceneUpdate:
        """Return the grasps and the collision check where the objects are at ``poses`` (K, 7)."""
        X_WO = {name: Pose(row[3:], row[:3]) for name, row in zip(self.names, poses, strict=True)}
        return true_scene(replace(self.world, X_WO=X_WO), self.library)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the objects, in the order of all their numbers."""
        return tuple(self.world.objects)

    @property
    def sizes(self) -> Sizes:
        """What determines the layout of the shared memory."""
        return Sizes(self.robot.n, len(self.names), len(self.start.candidates.object_index), self.choice.rate)

    def controller(self, settings: LiveSettings) -> SharedController:
        """Return the controller: the hand is coupled relative to where it took hold, in the axes of the world."""
        approach = Approach()
        selector = GraspSelector(
            self.robot,
            settings.ranking_rule,
            standoff=approach.standoff,
            hysteresis=Hysteresis(),
            speed=approach.speed,
            angular_speed=approach.angular_speed,
        )
        servo = ServoSettings(timeout=self.choice.timeout)
        clutch = ClutchSettings(
            orientation="relative", scale=settings.scale, fade=0.15, largest_step=JUMP, largest_acceleration=QUICK
        )
        return SharedController(
            self.robot, selector, approach=approach, clutch=clutch, smoothing=settings.smoothing, servo=servo
        )

    def follower(self) -> Follower:
        """Return a new arm; it needs closing."""
        if self.choice.follower == "ideal":
            return IdealFollower(self.robot, self.world.X_WO, self.start.candidates)
        # A session without physics does not load the engine.
        from optsc.sim.follower import PyBulletFollower

        return PyBulletFollower(self.world)
