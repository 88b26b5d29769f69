"""One episode: an operator and a controller grasp one object of a scene, and what that looked like in numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from optsc.control.approach import Approach
from optsc.control.controller import SharedController
from optsc.control.modes import Mode
from optsc.demo.seen import true_names
from optsc.demo.sight import LOOK_PERIOD, Looks, Sight
from optsc.followers.protocol import Follower
from optsc.geometry import Pose
from optsc.grasps import GraspLibrary
from optsc.metrics import log_dimensionless_jerk, path_length, rotation_path, sparc, switch_jump
from optsc.operators import ClutchSettings
from optsc.people.parameters import Intention
from optsc.people.simulated import R_WS_DEFAULT, Simulated
from optsc.records import Run, SceneUpdate, Tick
from optsc.robot.collision import CollisionModel
from optsc.robot.manipulability import Manipulability
from optsc.selection import Cascade, GraspClearance, GraspSelector, Rule
from optsc.session import run
from optsc.sim import Tabletop
from optsc.study.lifting import is_lifted

LONGEST = 60.0
"""An episode that is not finished by then [s] has failed."""


@dataclass(frozen=True)
class Strategy:
    """How the target grasp is chosen: a name for tables, a label for people, and the rule."""

    name: str
    label: str
    rule: Rule


PAPER = Strategy("paper", "hand and manipulability", Cascade.paper())
MANIPULABILITY_ONLY = Strategy("manipulability", "manipulability only", Cascade.manipulability_only())
STRATEGIES = (PAPER, MANIPULABILITY_ONLY)


@dataclass(frozen=True, eq=False)
class Setting:
    """What all episodes of a scene share.

    Attributes:
        world: the arm and its objects.
        library: grasps of the objects.
        seed: of the operator.
        rate: control rate [Hz].
        approach: how the robot moves by itself.
        manipulability: the measure M.
    """

    world: Tabletop
    library: GraspLibrary
    seed: int
    rate: float = 500.0
    approach: Approach = field(default_factory=Approach)
    manipulability: Manipulability = field(default_factory=Manipulability)


@dataclass(frozen=True, eq=False)
class Episode:
    """What became of one episode.

    Attributes:
        object_name: the object that the operator wanted.
        strategy: how the grasp was chosen.
        run: all ticks.
        tool: commanded tool poses (T,).
        switch: index of the tick at which the last automatic motion began; None where there was none.
        arrival: index of the tick at which the jaws began to close; None where they did not.
        lifted: whether the object was lifted high and long enough.
        looks: at the scene on the way, where a camera watched it.
        true_names: of the objects as the camera's images name them, where one did.
    """

    object_name: str
    strategy: Strategy
    run: Run
    tool: Pose
    switch: int | None
    arrival: int | None
    lifted: bool
    looks: Looks | None = None
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
            {name: _plain(value) for name, value in jump._asdict().items()},
        )
        return {**row, **dict(zip(names, values, strict=True))}


def _plain(value: Any) -> Any:
    return bool(value) if isinstance(value, (bool, np.bool_)) else float(value)


def build_controller(setting: Setting, strategy: Strategy) -> SharedController:
    """Return the controller of an episode: the paper's mapping of the hand, and the strategy's rule."""
    robot = setting.world.robot
    selector = GraspSelector(robot, strategy.rule, setting.manipulability, standoff=setting.approach.standoff)
    return SharedController(
        robot, selector, approach=setting.approach, clutch=ClutchSettings(R_WS=R_WS_DEFAULT)
    )


def clearance(world: Tabletop) -> GraspClearance:
    """Return the collision check of the grasps in ``world``: arm against itself, table and objects."""
    obstacles = {name: (model.parts, world.X_WO[name]) for name, model in world.objects.items()}
    return GraspClearance(CollisionModel(world.robot).scene(obstacles))


def run_episode(
    setting: Setting,
    strategy: Strategy,
    plan: Sequence[Intention],
    follower: Follower,
    on_tick: Callable[[Tick], None] | None = None,
    sight: Sight | None = None,
) -> Episode:
    """Let a simulated operator carry out ``plan`` and return what became of it.

    The last object of the plan is the one that counts. Operators of the same seed move alike under every strategy
    until the robot takes over. With ``sight`` the grasps are those that the camera's images gave, and the scene is
    watched on the way; without it they are those of the setting's library, where the objects truly are.
    """
    world = setting.world
    scene = (
        SceneUpdate(setting.library.place(world.X_WO), clearance(world))
        if sight is None
        else sight.update(sight.first)
    )
    controller = build_controller(setting, strategy)
    looks = None if sight is None else sight.watch(follower)
    ticks = run(
        controller,
        operator=Simulated(seed=setting.seed, plan=tuple(plan), R_WS=R_WS_DEFAULT),
        follower=follower,
        candidates=scene.candidates,
        clear=scene.clear,
        watch=looks,
        watch_period=LOOK_PERIOD,
        rate=setting.rate,
        duration=LONGEST,
        about={"strategy": strategy.name, "object": plan[-1].object, "seed": setting.seed},
        on_tick=on_tick,
    )
    episode = _judged(setting, strategy, plan[-1].object, ticks)
    return episode if sight is None else replace(episode, looks=looks, true_names=true_names(sight))


def _judged(setting: Setting, strategy: Strategy, name: str, ticks: Run) -> Episode:
    tool = setting.world.robot.forward(ticks.q)
    starts = [i for i in ticks.switches() if ticks.modes[i] is Mode.APPROACH]
    switch = starts[-1] if starts else None
    arrivals = [
        i for i in ticks.switches() if ticks.modes[i] is Mode.CLOSE and switch is not None and i > switch
    ]
    heights = np.array([tick.objects[name].translation[2] if name in tick.objects else 0.0 for tick in ticks])
    lifted = is_lifted(heights, ticks.rate)
    return Episode(name, strategy, ticks, tool, switch, arrivals[0] if arrivals else None, lifted)
