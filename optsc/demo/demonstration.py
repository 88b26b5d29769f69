"""The demonstration: every object of a scene, grasped under both strategies of the paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from optsc.cache import cache_directory
from optsc.demo.episode import SETTINGS, DemoEpisode, DemoSetup, run_episode
from optsc.demo.observation import SceneObservation
from optsc.errors import InvalidValue
from optsc.grasps import GraspLibrary
from optsc.people.parameters import Intention
from optsc.records import Tick
from optsc.robot import RobotModel
from optsc.sampling import build_library
from optsc.sim import Tabletop, tabletop
from optsc.sim.follower import PyBulletFollower
from optsc.study.approach import STRATEGIES
from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER
from optsc.study.libraries import LIBRARY_SEED

TAKE_OVER_AFTER = 0.8
"""How long after the trigger the operator of the demonstration steps in, once [s]: in the middle of the approach."""
LABELS = {PAPER.name: "hand and manipulability", MANIPULABILITY_ONLY.name: "manipulability only"}
"""Names of the strategies in output and pictures."""

Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Demo:
    """Everything that happened in the demonstration.

    Attributes:
        setup: what all episodes share.
        episodes: by strategy and object.
        intervened: the object during whose episode the operator steps in; "" for none.
    """

    setup: DemoSetup
    episodes: Mapping[tuple[str, str], DemoEpisode]
    intervened: str

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the objects, sorted."""
        return tuple(sorted(self.setup.world.objects))


def plans(object_names: Sequence[str]) -> dict[str, tuple[Intention, ...]]:
    """Return the operator's plan for each object: straight to it, but for one, where another is wanted first."""
    names = sorted(object_names)
    result: dict[str, tuple[Intention, ...]] = {name: (Intention(name),) for name in names}
    if len(names) > 1:
        result[names[1]] = (Intention(names[0], then_take_over_after=TAKE_OVER_AFTER), Intention(names[1]))
    return result


def load_or_build(world: Tabletop, directory: Path | None, say: Say) -> GraspLibrary:
    """Return grasps of every object, stored below ``directory`` (the user's cache by default) and reused."""
    if world.robot.gripper is None:
        raise InvalidValue("robot.gripper", None, "a gripper")
    reported: dict[str, int] = {}

    def progress(name: str, done: int, total: int) -> None:
        tenth = 10 * done // max(total, 1)
        if tenth != reported.get(name):
            reported[name] = tenth
            say(f"  grasps of the {name}: {done} of {total}")

    return build_library(
        {name: model.mesh for name, model in world.objects.items()},
        world.robot.gripper,
        seed=LIBRARY_SEED,
        directory=directory or cache_directory("grasps"),
        progress=progress,
    )


def run_demo(
    robot: RobotModel,
    *,
    objects: Sequence[str],
    seed: int,
    rate: float = SETTINGS.rate,
    library: Path | None = None,
    gui: bool = False,
    say: Say = print,
    on_tick: Callable[[Tick], None] | None = None,
    perception: bool = False,
) -> Demo:
    """Run the scene of ``seed`` under both strategies and return what happened.

    With ``perception`` the grasps come from a simulated depth camera alone, and nothing that is known of the scene
    reaches the controller.

    Raises:
        UnknownName: no such object.
        InvalidValue: the objects do not fit on the table, or an impossible rate.
    """
    settings = replace(SETTINGS, rate=rate)
    world = tabletop(robot, objects=tuple(objects), seed=seed)
    operator_plans = plans(objects)
    episodes: dict[tuple[str, str], DemoEpisode] = {}
    with ExitStack() as stack:
        if perception:
            observation = stack.enter_context(SceneObservation(world, seed=seed))
            setup = DemoSetup(world, observation.first.library, seed, settings, observation)
            for event in observation.events:
                say(f"  {event.name}: {event.words}")
        else:
            setup = DemoSetup(world, load_or_build(world, library, say), seed, settings)
        follower = stack.enter_context(PyBulletFollower(world, gui=gui))
        for condition in STRATEGIES:
            for name, plan in operator_plans.items():
                episode = run_episode(setup, condition, plan, follower, on_tick)
                episodes[condition.name, name] = episode
                say(f"  {LABELS[condition.name]}: {name} {'lifted' if episode.lifted else 'not lifted'}")
    intervened = next((name for name, plan in operator_plans.items() if len(plan) > 1), "")
    return Demo(setup, episodes, intervened)
