"""An episode of the demonstration: an operator and a controller grasp one object of a scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from optsc.control.controller import SharedController
from optsc.control.modes import Mode
from optsc.demo.observation import OBSERVATION_PERIOD, EpisodeObservation, SceneObservation, true_names
from optsc.followers.protocol import Follower
from optsc.geometry import Pose
from optsc.grasps import GraspLibrary
from optsc.metrics import is_lifted, log_dimensionless_jerk, path_length, rotation_path, sparc, switch_jump
from optsc.people.parameters import Intention
from optsc.people.simulated import R_WS_DEFAULT, Simulated
from optsc.records import Run, SceneUpdate, Tick
from optsc.selection import GraspSelector
from optsc.session import run
from optsc.sim import Tabletop
from optsc.study.conditions import Condition, measure
from optsc.study.episode_setup import EpisodeSettings, controller_with, true_scene

SETTINGS = EpisodeSettings(rate=500.0, longest=60.0, follower="pybullet")
"""Defaults of the demonstration."""


@dataclass(frozen=True, eq=False)
class DemoSetup:
    """What all episodes of a demonstration share.

    Attributes:
        world: the arm and its objects.
        library: grasps of the objects, as they are known or as the camera's images gave them.
        seed: of the operator.
        settings: rate, time limit and approach.
        observation: of the scene, which then is known from a camera alone; None where it is known.
    """

    world: Tabletop
    library: GraspLibrary
    seed: int
    settings: EpisodeSettings = SETTINGS
    observation: SceneObservation | None = None

    def scene(self) -> SceneUpdate:
        """Return the grasps and their collision check at the start of every episode."""
        if self.observation is not None:
            return self.observation.update(self.observation.first)
        return true_scene(self.world, self.library)

    def controller(self, condition: Condition) -> SharedController:
        """Return a controller that ranks the grasps of ``condition`` live, as the hand moves."""
        approach, M = self.settings.approach, measure(condition.measure)
        selector = GraspSelector(self.world.robot, condition.rule, M, standoff=approach.standoff)
        return controller_with(selector, approach)


@dataclass(frozen=True, eq=False)
class DemoEpisode:
    """What happened in one episode.

    Attributes:
        object_name: the object that the operator wanted.
        condition: how the grasp was chosen.
        run: all ticks.
        tool: commanded tool poses (T,).
        switch: index of the tick at which the last automatic motion began; None where there was none.
        arrival: index of the tick at which the jaws began to close; None where they did not.
        lifted: whether the object was lifted high and long enough.
        observation: of the scene during the episode, where a camera watched it.
        true_names: of the objects as the camera's images name them, where one did.
    """

    object_name: str
    condition: Condition
    run: Run
    tool: Pose
    switch: int | None
    arrival: int | None
    lifted: bool
    observation: EpisodeObservation | None = None
    true_names: Mapping[str, str] = field(default_factory=dict)

    @property
    def target_name(self) -> str | None:
        """The object that was approached last."""
        target = None if self.switch is None else self.run[self.switch].step.target
        return None if target is None else self.true_names.get(target.object_name, target.object_name)

    def measures(self) -> dict[str, Any]:
        """Return the measures of the automatic motion from the switch to the grasp; None where it did not arrive.

        ``path_length_m``, ``rotation_rad``, ``duration_s``, ``sparc`` [-] and ``ldlj`` [-] of the tool's velocity,
        and the parts of ``switch_jump``.
        """
        row: dict[str, Any] = {"lifted": self.lifted, "target": self.target_name}
        names = ("path_length_m", "rotation_rad", "duration_s", "sparc", "ldlj", "switch_jump")
        if self.switch is None or self.arrival is None:
            return {**row, **dict.fromkeys(names)}
        rate, part = self.run.rate, slice(self.switch, self.arrival)
        p, q = self.tool.translation[part], self.tool.quaternion[part]
        velocity = np.diff(p, axis=0) * rate
        target = self.run[self.switch].step.target
        jump = switch_jump(self.switch, rate, self.tool, self.run.q, None if target is None else target.X_WG)
        values = (
            path_length(p),
            rotation_path(q),
            (self.arrival - self.switch) / rate,
            sparc(np.linalg.norm(velocity, axis=1), rate),
            log_dimensionless_jerk(velocity, rate),
            {name: np.asarray(value).item() for name, value in jump._asdict().items()},
        )
        return {**row, **dict(zip(names, values, strict=True))}


def run_episode(
    setup: DemoSetup,
    condition: Condition,
    plan: Sequence[Intention],
    follower: Follower,
    on_tick: Callable[[Tick], None] | None = None,
) -> DemoEpisode:
    """Let a simulated operator execute ``plan`` and return what happened.

    The last object of the plan is the one that counts. Operators of the same seed move alike under every condition
    until the robot takes over. Where the setup has an observation, the scene is observed during the episode, too.
    """
    scene, observation = setup.scene(), None
    if setup.observation is not None:
        observation = setup.observation.watch(follower)
    ticks = run(
        setup.controller(condition),
        operator=Simulated(seed=setup.seed, plan=tuple(plan), R_WS=R_WS_DEFAULT),
        follower=follower,
        candidates=scene.candidates,
        clear=scene.clear,
        watch=observation,
        watch_period=OBSERVATION_PERIOD,
        rate=setup.settings.rate,
        duration=setup.settings.longest,
        about={"strategy": condition.name, "object": plan[-1].object, "seed": setup.seed},
        on_tick=on_tick,
    )
    episode = _evaluated(setup, condition, plan[-1].object, ticks)
    if setup.observation is None:
        return episode
    return replace(episode, observation=observation, true_names=true_names(setup.observation))


def _evaluated(setup: DemoSetup, condition: Condition, name: str, ticks: Run) -> DemoEpisode:
    tool = setup.world.robot.forward(ticks.q)
    switches = ticks.switches()
    switch = max((i for i in switches if ticks.modes[i] is Mode.APPROACH), default=None)
    closings = [i for i in switches if ticks.modes[i] is Mode.CLOSE and switch is not None and i > switch]
    heights = np.array([tick.objects[name].translation[2] if name in tick.objects else 0.0 for tick in ticks])
    lifted = is_lifted(heights, ticks.rate)
    return DemoEpisode(name, condition, ticks, tool, switch, closings[0] if closings else None, lifted)
