"""A scene as a camera sees it: the first look, from which all episodes start, and the looks during an episode."""

from __future__ import annotations

from time import perf_counter
from types import TracebackType

import numpy as np

from optsc.followers.protocol import Follower, FollowerState
from optsc.geometry import PinholeCamera
from optsc.perception import ObserverSettings, SceneEvent, SceneObserver, SceneState, catalogue_templates
from optsc.records import SceneUpdate
from optsc.robot.collision import CollisionModel
from optsc.selection import GraspClearance
from optsc.sim import Tabletop
from optsc.sim.camera import DEFAULT_CAMERA, DepthCamera

LOOK_PERIOD = 0.5
"""From one look at the scene to the next [s]."""


class Sight:
    """A depth camera before a tabletop and an observer behind it; a context manager.

    Nothing of the world reaches the observer but depth images and the arm's measured posture.

    Args:
        world: what stands there.
        seed: of the sensor's errors and of the observer.
        templates: names of the shapes that are known beforehand; all of the catalogue by default.
        settings: of the observer.
        camera: its intrinsics.

    Attributes:
        first: what is known after the first look, with the arm at home.
        events: what that look brought.
        seconds: what it cost [s], without drawing the image.
        view: the first image, with the truth about it, which only serves to judge.
    """

    def __init__(
        self,
        world: Tabletop,
        *,
        seed: int = 0,
        templates: tuple[str, ...] | None = None,
        settings: ObserverSettings | None = None,
        camera: PinholeCamera = DEFAULT_CAMERA,
    ) -> None:
        self.world, self._seed = world, seed
        self._collision = CollisionModel(world.robot)
        self.observer = SceneObserver(world.robot, catalogue_templates(templates), settings, seed=seed)
        self.camera = DepthCamera(world, camera=camera)
        home = world.robot.home
        self.view = self.camera.look(home, rng=np.random.default_rng([seed, 0]))
        self.first: SceneState
        self.events: tuple[SceneEvent, ...]
        before = perf_counter()
        self.first, self.events = self.observer.observe(SceneState(), self.view.image, home)
        self.seconds = perf_counter() - before

    def update(self, memory: SceneState) -> SceneUpdate:
        """Return what a controller has to be told of ``memory``."""
        return SceneUpdate(memory.place(), GraspClearance(self._collision.scene(memory.obstacles)))

    def watch(self, follower: Follower) -> Looks:
        """Return the looks of one episode, beginning with what the first look left; see `optsc.session.run`."""
        return Looks(self, follower, np.random.default_rng([self._seed, 1]))

    def close(self) -> None:
        """Free the camera; closing again does nothing."""
        self.camera.close()

    def __enter__(self) -> Sight:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Looks:
    """The looks during one episode: called with the time and the arm's state, an `optsc.session.Watch`.

    Attributes:
        memory: what is known now.
        events: what the looks brought, with the time of each [s].
        seconds: what each look cost [s], without drawing the image.
    """

    def __init__(self, sight: Sight, follower: Follower, rng: np.random.Generator) -> None:
        self._sight, self._follower, self._rng = sight, follower, rng
        self.memory = sight.first
        self.events: list[tuple[float, SceneEvent]] = []
        self.seconds: list[float] = []

    def __call__(self, time: float, measured: FollowerState) -> SceneUpdate | None:
        """Look, and return what the controller has to be told; None where nothing has changed."""
        objects = self._follower.objects()  # for the renderer alone
        view = self._sight.camera.look(
            measured.q, measured.opening, objects, rng=self._rng, stamp=measured.time
        )
        before = perf_counter()
        self.memory, events = self._sight.observer.observe(self.memory, view.image, measured.q)
        self.seconds.append(perf_counter() - before)
        self.events += [(time, event) for event in events]
        return self._sight.update(self.memory) if events else None
