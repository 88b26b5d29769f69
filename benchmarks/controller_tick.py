"""What one tick of the whole shared controller takes, by what happened in it.

A run with all that a tick may have to do: hundreds of candidates with a collision check, a moving hand, the trigger,
another grasp, a veto, fine-tuning, a belief over the objects, and a scene that changes once a second. Times are those
of the loop's thread on the processor, beside those of the wall clock: what else the machine does is only in the latter.
"""

from __future__ import annotations

import gc
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from time import perf_counter_ns, thread_time_ns
from typing import Any, NamedTuple

import numpy as np

from benchmarks.ranking import resized, scene
from optsc.collision import CollisionModel, GraspClearance
from optsc.control.controller import ControlStep, SharedController
from optsc.control.fine_tuning import FineTuning
from optsc.control.modes import Mode
from optsc.followers import IdealFollower
from optsc.geometry import Pose, rotation
from optsc.grasps import Candidates
from optsc.operators import Button, ClutchSettings, OperatorSample
from optsc.records import SceneUpdate
from optsc.robot import RobotModel
from optsc.selection import GraspSelector
from optsc.selection.intent import IntentSettings
from optsc.sim import tabletop

SAMPLE_PERIOD = 0.01
"""The hand is sampled so often [s]."""
UPDATE_PERIOD = 1.0
"""The scene changes so often [s]."""
PERCENTILES = (50.0, 99.0, 99.9, 99.99)
ROUND = 3.0
"""Length of one round of the operator's doings [s]."""
OBJECTS = ("mug", "can", "box")


Summary = dict[str, dict[str, float]]
"""By what happened in a tick: number of ticks, percentiles and the worst [us], and the share over 1 ms."""


class Timed(NamedTuple):
    """One tick: what happened in it, and what it took on the processor and by the clock [ns]."""

    what: str
    processor: int
    clock: int


class ScriptedHand:
    """A hand that wanders over the table, and presses everything there is to press, round after round."""

    def __init__(self, robot: RobotModel, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._pose = Pose(robot.forward(robot.home).quaternion, np.zeros(3))
        self._velocity = np.zeros(6)
        self._next = 0.0

    def read(self, time: float, mode: Mode) -> OperatorSample | None:
        """Return the sample that is due at a time [s], None where none is."""
        if time < self._next - 1e-9:
            return None
        self._next += SAMPLE_PERIOD
        rng, dt = self._rng, SAMPLE_PERIOD
        pull = np.concatenate([-0.3 * self._pose.translation, np.zeros(3)])
        noise = np.repeat([0.5, 1.0], 3) * rng.normal(size=6)
        self._velocity += dt * (pull - self._velocity) + np.sqrt(dt) * noise * 0.4
        turn = rotation.exp(self._velocity[3:] * dt)
        p = self._pose.translation + self._velocity[:3] * dt
        self._pose = Pose(rotation.multiply(turn, self._pose.quaternion), p)
        phase = time % ROUND
        buttons, nudge = set(), None

        def between(start: float) -> bool:
            return start <= phase < start + 0.05

        trigger = between(2.6) if mode.automatic else between(0.8) and mode is Mode.MANUAL
        if mode.automatic:
            if between(1.2):
                buttons.add(Button.NEXT)
            if between(1.6):
                buttons.add(Button.VETO)
            if 1.7 < phase < 2.4 and round(time / dt) % 3 == 0:
                nudge = (*(1e-3 * rng.normal(size=3)), *(1e-2 * rng.normal(size=3)))
        elif between(2.2):
            buttons.add(Button.VETO)
        clutch = not (mode is Mode.HOLD and round(time / dt) % 20 < 10)
        return OperatorSample(time, self._pose, clutch, trigger, frozenset(buttons), nudge)


class Scenes:
    """The scene, whose objects are moved a little at every update: one of them at a time."""

    def __init__(self, robot: RobotModel, count: int, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        candidates, _ = scene(robot, list(OBJECTS), seed, None)
        self._candidates = resized(candidates, count, self._rng)
        self._world = tabletop(robot, objects=OBJECTS, seed=seed)
        self._model = CollisionModel(robot)
        self._at = dict(self._world.X_WO)

    def update(self) -> SceneUpdate:
        """Return the scene as it is now."""
        obstacles = {name: (model.parts, self._at[name]) for name, model in self._world.objects.items()}
        return SceneUpdate(self._candidates, GraspClearance(self._model.scene(obstacles)))

    def moved(self) -> SceneUpdate:
        """Move an object, and return the scene as it is then."""
        name = OBJECTS[int(self._rng.integers(len(OBJECTS)))]
        X = Pose.from_rotation_vector([0, 0, 0.1 * self._rng.normal()], [*(0.01 * self._rng.normal(size=2)), 0.0])
        before = self._at[name]
        self._at[name] = Pose(rotation.multiply(X.quaternion, before.quaternion), before.translation + X.translation)
        shift = self._at[name] @ before.inverse()
        c: Candidates = self._candidates
        own = (c.object_index == c.object_names.index(name))[:, None]
        turned = shift @ c.X_WG
        X_WG = Pose(
            np.where(own, turned.quaternion, c.X_WG.quaternion), np.where(own, turned.translation, c.X_WG.translation)
        )
        self._candidates = replace(c, X_WG=X_WG)
        return self.update()


def controller_of(robot: RobotModel) -> SharedController:
    """Return a controller that does all it can: belief, fine-tuning, collisions."""
    return SharedController(
        robot, GraspSelector(robot), fine_tuning=FineTuning(), intent=IntentSettings(), clutch=ClutchSettings()
    )


def ticks(robot: RobotModel, rate: float, seconds: float, count: int, seed: int) -> Iterator[Timed]:
    """Go through a run and yield what each tick took."""
    scenes, hand = Scenes(robot, count, seed), ScriptedHand(robot, seed)
    controller, follower = controller_of(robot), IdealFollower(robot)
    controller.reset(robot.home, rate)
    measured = follower.reset(robot.home)
    controller.observe(*scenes.update())
    next_update = UPDATE_PERIOD
    for _ in range(round(seconds * rate)):
        sample = hand.read(controller.time, controller.mode)
        update = None
        if controller.time >= next_update:
            next_update += UPDATE_PERIOD
            update = scenes.moved()
        before = controller.state
        clock, processor = perf_counter_ns(), thread_time_ns()
        if update is not None:
            controller.observe(*update)
        step = controller.step(sample, measured)
        processor, clock = thread_time_ns() - processor, perf_counter_ns() - clock
        yield Timed(what_happened(controller, before, step, sample, update), processor, clock)
        measured = follower.apply(step.command.q, step.command.v, step.opening, 1.0 / rate)


def what_happened(
    controller: SharedController, before: Any, step: ControlStep, sample: OperatorSample | None, update: Any
) -> str:
    """Return in a word what was special about a tick."""
    after = controller.state
    if update is not None:
        return "a new scene"
    pressed = after.monitor.buttons - before.monitor.buttons
    for button in (Button.NEXT, Button.VETO):
        if button in pressed:
            return f"{button.name.lower()} is pressed"
    if after.monitor.trigger and not before.monitor.trigger:
        return "the trigger is pressed"
    if after.tuning is not None and before.tuning is not None and after.tuning.tuned is not before.tuning.tuned:
        return "the grasp is tuned"
    if after.choice.ranked != before.choice.ranked:
        return "the grasps are ranked"
    if before.choice.deciding is not None:
        return "a decision is made" if after.choice.deciding is None else "a decision is in the making"
    if after.choice.rounds != before.choice.rounds:
        return "grasps are solved again"
    if after.choice.believed != before.choice.believed:
        return "the belief is updated"
    if controller.selector.observing:
        return "a new scene is in the making"
    if step.event is not None:
        return "another event"
    return "nothing else" if sample is None else "a sample of the hand"


def summary_of(timed: list[Timed]) -> Summary:
    """Return percentiles and the worst [us] of all ticks, and of those with the same thing happening."""
    groups: dict[str, list[Timed]] = defaultdict(list)
    for one in timed:
        groups["all ticks"].append(one)
        groups[one.what].append(one)
    found = {}
    for what, some in groups.items():
        times = 1e-3 * np.array([(one.processor, one.clock) for one in some])
        row: dict[str, float] = {"ticks": len(some)}
        for k, name in enumerate(("", "clock ")):
            for p, value in zip(PERCENTILES, np.percentile(times[:, k], PERCENTILES), strict=True):
                row[f"{name}p{p:g}"] = float(value)
            row[f"{name}worst"] = float(times[:, k].max())
        row["over 1 ms"] = float(np.mean(times[:, 0] > 1e3))
        found[what] = row
    return found


def measure(
    robot: RobotModel, rate: float = 500.0, seconds: float = 60.0, count: int = 450, seed: int = 0, repeats: int = 1
) -> Summary:
    """Return `summary_of` a run of ``seconds`` of control time on ``count`` candidates.

    The run is repeated, and of each tick the least time counts: what it does is the same, and the rest the machine did.
    """
    for _ in ticks(robot, rate, 5.0, count, seed + 1):
        pass
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        runs = [list(ticks(robot, rate, seconds, count, seed)) for _ in range(repeats)]
    finally:
        gc.enable()
        gc.unfreeze()
    return summary_of([_least(times) for times in zip(*runs, strict=True)])


def _least(times: tuple[Timed, ...]) -> Timed:
    return Timed(times[0].what, min(one.processor for one in times), min(one.clock for one in times))


def table(summary: Summary) -> tuple[list[str], list[list[str]]]:
    """Return header and rows."""
    names = [f"p{p:g}" for p in PERCENTILES]
    columns = [*names, "worst", "clock p99.9", "clock worst"]
    header = ["whole controller, processor time of the thread [us]", "ticks", *columns, "over 1 ms"]
    rows = [
        [what, f"{row['ticks']:.0f}", *(f"{row[c]:.0f}" for c in columns), f"{100 * row['over 1 ms']:.3f} %"]
        for what, row in sorted(summary.items(), key=lambda item: -item[1]["ticks"])
    ]
    return header, rows
