"""The only loop: operator, controller and follower, tick by tick."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optsc.control.controller import SharedController
from optsc.errors import InvalidValue
from optsc.followers.protocol import Follower, FollowerState
from optsc.geometry import Pose
from optsc.grasps import Candidates
from optsc.operators import Operator, OperatorView
from optsc.records import Run, RunInputs, SceneUpdate, Tick
from optsc.selection import Ranking, Target
from optsc.selection.reach import ClearRows

Watch = Callable[[float, FollowerState], SceneUpdate | None]
"""``watch(time, measured)``: a look at the scene at a time [s]; None where nothing has changed."""


def run(
    controller: SharedController,
    *,
    operator: Operator,
    follower: Follower,
    candidates: Candidates | None = None,
    clear: ClearRows | None = None,
    rate: float = 500.0,
    duration: float = 60.0,
    start: ArrayLike | None = None,
    watch: Watch | None = None,
    watch_period: float = 0.2,
    about: Mapping[str, Any] | None = None,
    on_tick: Callable[[Tick], None] | None = None,
) -> Run:
    """Run until the task is finished or ``duration`` is over, in the follower's time, and return all ticks.

    Args:
        controller: is reset first.
        operator: moves the hand.
        follower: is reset first; simulated ones advance by a period per tick, as quickly as they can.
        candidates: the grasps of the scene, where the task is to grasp.
        clear: which of them the arm can carry out without collision, see `optsc.selection.GraspClearance`.
        rate: control rate [Hz].
        duration: the longest run [s].
        start: posture (n,) [rad] to start from, the robot's home by default.
        watch: looks at the scene during the run, and says when grasps have to be placed anew. It is outside of the
            control clock: simulated time stands still for it.
        watch_period: from one look to the next [s]; the first is one period after the start.
        about: what to keep with the run.
        on_tick: called after every tick, for live views.

    Raises:
        InvalidValue: rate, duration or watch_period are not positive, or the start posture does not fit the robot.
    """
    for name, value in (("rate", rate), ("duration", duration), ("watch_period", watch_period)):
        if not (np.isfinite(value) and value > 0):
            raise InvalidValue(name, value, "positive and finite")
    q = controller.robot.checked(controller.robot.home if start is None else start, "start")
    controller.reset(q, rate)
    measured = follower.reset(q)
    if candidates is not None:
        controller.observe(candidates, clear)
    ticks: list[Tick] = []
    updates: dict[int, SceneUpdate] = {}
    period, next_look = 1.0 / rate, watch_period
    automatic = finished = False
    target: str | None = None
    ranking: Ranking | None = None
    grasps: Mapping[str, Pose] = {}
    # A collection in the middle of a tick costs more than the tick; what the loop makes has no cycles.
    collecting = gc.isenabled()
    gc.disable()
    try:
        while controller.time < duration and not finished:
            objects = follower.objects()
            if watch is not None and controller.time >= next_look - 0.5 * period:
                next_look += watch_period
                update = watch(controller.time, measured)
                if update is not None:
                    updates[len(ticks)] = update
                    controller.observe(*update)
            X_WT = controller.robot.forward(measured.q)
            if controller.ranking is not ranking:
                ranking = controller.ranking
                grasps = controller.shown
            view = OperatorView(controller.time, X_WT, automatic, finished, objects, grasps, target)
            sample = operator.read(view)
            before = perf_counter()
            step = controller.step(sample, measured)
            elapsed = perf_counter() - before
            automatic, finished = step.mode.automatic, controller.finished
            target = _seen_target(step.target, objects) if automatic and step.target is not None else None
            ticks.append(Tick(sample, measured, step, objects, elapsed))
            measured = follower.apply(step.command.q, step.command.v, step.opening, period)
            if on_tick is not None:
                on_tick(ticks[-1])
    finally:
        if collecting:
            gc.enable()
    facts = {"robot": controller.robot.name, "start": q.tolist(), **(about or {})}
    return Run(rate, tuple(ticks), facts, updates)


def _seen_target(target: Target, objects: Mapping[str, Pose]) -> str:
    """Return which of the objects the robot is seen to go for, whatever the controller may call it."""
    if target.object_name in objects or not objects:
        return target.object_name
    p = target.X_WG.translation
    return min(objects, key=lambda name: float(np.linalg.norm(objects[name].translation - p)))


def replay(
    controller: SharedController,
    inputs: RunInputs,
    candidates: Candidates | None = None,
    clear: ClearRows | None = None,
    updates: Mapping[int, SceneUpdate] | None = None,
) -> Run:
    """Feed recorded inputs to a controller and return what it does: the same commands, bit for bit."""
    controller.reset(inputs.about["start"], inputs.about["rate"])
    if candidates is not None:
        controller.observe(candidates, clear)
    ticks = []
    for index, (sample, measured) in enumerate(zip(inputs.samples, inputs.measured, strict=True)):
        if updates and index in updates:
            controller.observe(*updates[index])
        before = perf_counter()
        step = controller.step(sample, measured)
        ticks.append(Tick(sample, measured, step, {}, perf_counter() - before))
    return Run(inputs.about["rate"], tuple(ticks), dict(inputs.about), dict(updates or {}))
