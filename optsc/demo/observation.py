"""Scene observation: a simulated depth camera and an observer, before and during the episodes of a demonstration."""

from __future__ import annotations

from collections.abc import Iterable
from time import perf_counter
from types import TracebackType
from typing import Any

import numpy as np

from optsc.collision import GraspClearance
from optsc.followers.protocol import Follower, FollowerState
from optsc.geometry import PinholeCamera
from optsc.perception import (
    KnownObject,
    ObserverSettings,
    SceneEvent,
    SceneObserver,
    SceneState,
    add_s,
    catalogue_templates,
)
from optsc.records import SceneUpdate
from optsc.sim import Tabletop
from optsc.sim.camera import DEFAULT_CAMERA, DepthCamera
from optsc.study.episode_setup import collision_model

OBSERVATION_PERIOD = 0.5
"""From one observation of the scene to the next [s]."""


class SceneObservation:
    """What a depth camera before a tabletop gives an observer; a context manager.

    Nothing of the world reaches the observer but depth images and the arm's measured configuration.

    Args:
        world: the true scene.
        seed: of the sensor's errors and of the observer.
        templates: names of the shapes that are known beforehand; all of the catalogue by default.
        settings: of the observer.
        camera: its intrinsics.

    Attributes:
        first: the scene state after the first observation, with the arm at home; all episodes start from it.
        events: of the first observation.
        seconds: what it cost [s], without rendering the image.
        view: the first image, with the ground truth, which only serves to evaluate.
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
        self.observer = SceneObserver(world.robot, catalogue_templates(templates), settings, seed=seed)
        self.camera = DepthCamera(world, camera=camera)
        home = world.robot.home
        self.view = self.camera.capture(home, rng=np.random.default_rng([seed, 0]))
        self.first: SceneState
        self.events: tuple[SceneEvent, ...]
        before = perf_counter()
        self.first, self.events = self.observer.observe(SceneState(), self.view.image, home)
        self.seconds = perf_counter() - before

    def update(self, state: SceneState) -> SceneUpdate:
        """Return ``state`` as a controller needs it: grasps, and collisions with what was observed."""
        obstacles = collision_model(self.world.robot).scene(state.obstacles)
        return SceneUpdate(state.place(), GraspClearance(obstacles))

    def watch(self, follower: Follower) -> EpisodeObservation:
        """Return the observation of one episode, from the first scene state on; see `optsc.session.run`."""
        return EpisodeObservation(self, follower, np.random.default_rng([self._seed, 1]))

    def close(self) -> None:
        """Free the camera; closing again does nothing."""
        self.camera.close()

    def __enter__(self) -> SceneObservation:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class EpisodeObservation:
    """The observations during one episode: called with the time and the arm's state, an `optsc.session.Watch`.

    Attributes:
        state: the scene state now.
        events: all so far, with the time of each [s].
        seconds: what each observation cost [s], without rendering the image.
    """

    def __init__(self, scene: SceneObservation, follower: Follower, rng: np.random.Generator) -> None:
        self._scene, self._follower, self._rng = scene, follower, rng
        self.state = scene.first
        self.events: list[tuple[float, SceneEvent]] = []
        self.seconds: list[float] = []

    def __call__(self, time: float, measured: FollowerState) -> SceneUpdate | None:
        """Observe, and return the change of the scene for the controller; None where there is none."""
        objects = self._follower.objects()  # for the renderer alone
        view = self._scene.camera.capture(measured.q, measured.opening, objects, rng=self._rng, stamp=measured.time)
        before = perf_counter()
        self.state, events = self._scene.observer.observe(self.state, view.image, measured.q)
        self.seconds.append(perf_counter() - before)
        self.events += [(time, event) for event in events]
        return self._scene.update(self.state) if events else None


def true_names(scene: SceneObservation) -> dict[str, str]:
    """Return the true name of each object of the first observation: the one that most of its pixels show."""
    view, names = scene.view, {}
    for name, known in scene.first.objects.items():
        shares = {one: float(view.pixels_of(one)[known.pixels].mean()) for one in scene.world.objects}
        best = max(shares, key=lambda one: shares[one])
        if shares[best] > 0.5:
            names[name] = best
    return names


def perception_summary(scene: SceneObservation, episodes: Iterable[EpisodeObservation]) -> dict[str, Any]:
    """Return perception against the ground truth: each object, times, and events; JSON values only.

    ``add_s_m`` is the error of the pose [m], see `optsc.perception.add_s`; None where the shape was not recognised.
    """
    episodes = list(episodes)
    seconds = [second for one in episodes for second in one.seconds]
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in scene.world.objects}
    truth = true_names(scene)
    for name, known in scene.first.objects.items():
        if name in truth:
            found[truth[name]].append(_accuracy(scene, known, truth[name]))
    return {
        "objects": found,
        "not_objects": sorted(set(scene.first.objects) - truth.keys()),
        "first_look_s": scene.seconds,
        "looks": len(seconds),
        "look_p50_s": float(np.median(seconds)) if seconds else None,
        "look_longest_s": max(seconds, default=None),
        "events": [
            {
                "episode": index,
                "time_s": time,
                "news": event.kind.name,
                "name": event.name,
                "words": event.words,
            }
            for index, one in enumerate(episodes)
            for time, event in one.events
        ],
    }


def _accuracy(scene: SceneObservation, known: KnownObject, truth: str) -> dict[str, Any]:
    grasps = scene.first.library.get(known.name)
    error = None
    if known.template == truth:
        points = scene.observer.templates[truth].points
        error = add_s(points, scene.world.X_WO[truth], known.X_WO)
    return {
        "name": known.name,
        "template": known.template,
        "add_s_m": error,
        "explanations": len(known.explanations),
        "visible_fraction": None if grasps is None else grasps.visible_fraction,
        "candidates": 0 if grasps is None else len(grasps),
    }
