"""The demonstration: every object of a scene, grasped under both strategies, with numbers and the paper's picture."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optsc.cache import cache_directory
from optsc.control.modes import Mode
from optsc.demo.episode import STRATEGIES, Episode, Setting, Strategy, run_episode
from optsc.demo.seen import seen_facts
from optsc.demo.sight import Sight
from optsc.errors import InvalidValue
from optsc.grasps import GraspLibrary
from optsc.metrics import limit_violations
from optsc.people.parameters import Intention
from optsc.records import Tick
from optsc.robot import Gripper, RobotModel
from optsc.sampling import build_library
from optsc.sim import Tabletop, tabletop
from optsc.sim.follower import PyBulletFollower
from optsc.viewers.figure import (
    MANIPULABILITY_ONLY,
    PROPOSED,
    Curve,
    SelectedGrasps,
    approach_figure,
    save_figure,
)
from optsc.viewers.figure_seen import seen_figure

TAKE_OVER_AFTER = 0.8
"""How long after the trigger the operator of the demonstration steps in, once [s]: in the middle of the approach."""
LIBRARY_SEED = 0
"""Libraries are stored and reused, so their seed is not the scene's."""

Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Demo:
    """Everything that the demonstration saw: the scene, an episode per strategy and object, and the camera if any."""

    setting: Setting
    episodes: Mapping[tuple[str, str], Episode]
    intervened: str
    sight: Sight | None = None

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the objects, sorted."""
        return tuple(sorted(self.setting.world.objects))


def plans(object_names: Sequence[str]) -> dict[str, tuple[Intention, ...]]:
    """Return the operator's plan for each object: straight to it, but for one where the mind changes on the way."""
    names = sorted(object_names)
    result: dict[str, tuple[Intention, ...]] = {name: (Intention(name),) for name in names}
    if len(names) > 1:
        result[names[1]] = (Intention(names[0], then_take_over_after=TAKE_OVER_AFTER), Intention(names[1]))
    return result


def _gripper_of(world: Tabletop) -> Gripper:
    if world.robot.gripper is None:
        raise InvalidValue("robot.gripper", None, "a gripper")
    return world.robot.gripper


def load_or_build(world: Tabletop, directory: Path | None, say: Say) -> GraspLibrary:
    """Return grasps of every object, stored below ``directory`` (the user's cache by default) and reused."""
    shown: dict[str, int] = {}

    def progress(name: str, done: int, total: int) -> None:
        tenth = 10 * done // max(total, 1)
        if tenth != shown.get(name):
            shown[name] = tenth
            say(f"  grasps of the {name}: {done} of {total}")

    gripper = _gripper_of(world)
    return build_library(
        {name: model.mesh for name, model in world.objects.items()},
        gripper,
        seed=LIBRARY_SEED,
        directory=directory or cache_directory("grasps"),
        progress=progress,
    )


def run_demo(
    robot: RobotModel,
    *,
    objects: Sequence[str],
    seed: int,
    rate: float = 500.0,
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
    world = tabletop(robot, objects=tuple(objects), seed=seed)
    wishes = plans(objects)
    episodes: dict[tuple[str, str], Episode] = {}
    with ExitStack() as stack:
        sight = stack.enter_context(Sight(world, seed=seed)) if perception else None
        if sight is None:
            setting = Setting(world, load_or_build(world, library, say), seed, rate)
        else:
            setting = Setting(world, sight.first.library, seed, rate)
            for event in sight.events:
                say(f"  {event.name}: {event.words}")
        follower = stack.enter_context(PyBulletFollower(world, gui=gui))
        for strategy in STRATEGIES:
            for name, plan in wishes.items():
                episode = run_episode(setting, strategy, plan, follower, on_tick, sight)
                episodes[strategy.name, name] = episode
                say(f"  {strategy.label}: {name} {'lifted' if episode.lifted else 'not lifted'}")
    intervened = next((name for name, plan in wishes.items() if len(plan) > 1), "")
    return Demo(setting, episodes, intervened, sight)


def summary(demo: Demo) -> dict[str, Any]:
    """Return what the demonstration measured, for machines: JSON values only."""
    limits, rate = demo.setting.world.robot.limits, demo.setting.rate
    runs = [episode.run for episode in demo.episodes.values()]
    kinds = ("position", "velocity", "acceleration", "jerk")
    violations = dict.fromkeys(kinds, 0)
    for run in runs:
        found = limit_violations(rate, run.q, run.v, run.a, **vars(limits))
        for kind in kinds:
            violations[kind] += getattr(found, kind)
    elapsed = np.concatenate([[tick.elapsed for tick in run] for run in runs]) * 1e6
    commands = hashlib.sha256(b"".join(run.commands.tobytes() for run in runs)).hexdigest()
    seen = _seen(demo)
    return {
        "robot": demo.setting.world.robot.name,
        "seed": demo.setting.seed,
        "rate_hz": rate,
        "manipulability": str(demo.setting.manipulability),
        "objects": {
            name: {
                "candidates": _candidates(demo, name, seen),
                **{strategy.name: demo.episodes[strategy.name, name].measures() for strategy in STRATEGIES},
            }
            for name in demo.object_names
        },
        "limit_violations": violations,
        "interventions": sum(_interventions(episode) for episode in demo.episodes.values()),
        "ticks": sum(len(run) for run in runs),
        "tick_p50_us": float(np.median(elapsed)),
        "tick_p99_us": float(np.percentile(elapsed, 99)),
        "commands_sha256": commands,
        **({} if seen is None else {"perception": seen}),
    }


def _seen(demo: Demo) -> dict[str, Any] | None:
    if demo.sight is None:
        return None
    return seen_facts(demo.sight, [e.looks for e in demo.episodes.values() if e.looks is not None])


def _candidates(demo: Demo, name: str, seen: Mapping[str, Any] | None) -> int:
    """Return how many grasps of an object there were, whatever the camera's images made of it."""
    if seen is not None:
        return sum(found["candidates"] for found in seen["objects"][name])
    return len(demo.setting.library[name]) if name in demo.setting.library else 0


def _interventions(episode: Episode) -> int:
    modes = episode.run.modes
    return sum(modes[i] is Mode.MANUAL and modes[i - 1].automatic for i in episode.run.switches())


def table(demo: Demo) -> str:
    """Return both strategies side by side, for people."""
    rows: list[tuple[str, ...]] = [
        ("object", "strategy", "lifted", "path m", "turn rad", "time s", "SPARC", "LDLJ", "speed step m/s")
    ]
    for name in demo.object_names:
        for strategy in STRATEGIES:
            measures = demo.episodes[strategy.name, name].measures()
            jump = measures["switch_jump"]
            numbers = [
                measures[key] for key in ("path_length_m", "rotation_rad", "duration_s", "sparc", "ldlj")
            ]
            numbers.append(None if jump is None else jump["velocity_step"])
            cells = ["-" if x is None else f"{x:.3f}" for x in numbers]
            rows.append((name, strategy.name, "yes" if measures["lifted"] else "no", *cells))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows
    )


def figure(demo: Demo) -> Any:
    """Return the matplotlib figure: the grasps selected at two poses of the hand, and the ways of the tool."""
    world = demo.setting.world
    gripper = _gripper_of(world)
    shown = demo.intervened or demo.object_names[0]
    paper = demo.episodes[STRATEGIES[0].name, shown]
    starts = [i for i in paper.run.switches() if paper.run.modes[i] is Mode.APPROACH]
    situations = [
        _situation(paper, i, f"Selected grasps, hand pose {k}") for k, i in enumerate(starts[:2], 1)
    ]
    curves = [
        _curve(demo.episodes[strategy.name, shown], strategy, colour)
        for strategy, colour in zip(STRATEGIES, (PROPOSED, MANIPULABILITY_ONLY), strict=True)
    ]
    return approach_figure(
        {name: (model.mesh, world.X_WO[name]) for name, model in world.objects.items()},
        gripper.boxes(gripper.max_opening),
        situations or [_situation(paper, 0, "Start")],
        curves,
    )


def _situation(episode: Episode, index: int, title: str) -> SelectedGrasps:
    ranking = episode.run[index].ranking
    targets = [] if ranking is None else [ranking.target(name) for name in ranking.object_names]
    names = episode.true_names
    grasps = {names.get(t.object_name, t.object_name): t.X_WG for t in targets if t is not None}
    return SelectedGrasps(title, episode.tool[index], grasps)


def _curve(episode: Episode, strategy: Strategy, colour: str) -> Curve:
    end = episode.arrival or len(episode.run)
    automatic = np.array([mode.automatic for mode in episode.run.modes[:end]])
    target = None if episode.switch is None else episode.run[episode.switch].step.target
    return Curve(
        strategy.label,
        episode.tool.translation[:end],
        automatic,
        colour,
        None if target is None else target.X_WG,
    )


def save(demo: Demo, directory: Path) -> dict[str, Any]:
    """Write what was measured, the pictures and every run below ``directory``; return the summary.

    That is ``summary.json``, ``approach.png``, ``seen.png`` where a camera looked, and ``runs``.
    """
    directory.mkdir(parents=True, exist_ok=True)
    facts = summary(demo)
    (directory / "summary.json").write_text(json.dumps(facts, indent=2) + "\n")
    save_figure(figure(demo), directory / "approach.png")
    if demo.sight is not None:
        save_figure(seen_figure(demo.sight.first, demo.sight.view.image), directory / "seen.png")
    runs = directory / "runs"
    runs.mkdir(exist_ok=True)
    for (strategy, name), episode in demo.episodes.items():
        episode.run.save(runs / f"{strategy}_{name}.npz")
    return facts
