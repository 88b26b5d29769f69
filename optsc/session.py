"""The only loop: operator, controller and follower, tick by tick."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optsc.control.controller import ControlStep, SharedController
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
    display = _Display(controller)
    with _uncollected():
        while controller.time < duration and not controller.finished:
            objects = follower.objects()
            if watch is not None and controller.time >= next_look - 0.5 * period:
                next_look += watch_period
                update = watch(controller.time, measured)
                if update is not None:
                    updates[len(ticks)] = update
                    controller.observe(*update)
            sample = operator.read(display.view(measured, objects))
            before = perf_counter()
            step = controller.step(sample, measured)
            elapsed = perf_counter() - before
            display.step = step
            ticks.append(Tick(sample, measured, step, objects, elapsed))
            measured = follower.apply(step.command.q, step.command.v, step.opening, period)
            if on_tick is not None:
                on_tick(ticks[-1])
    facts = {"robot": controller.robot.name, "start": q.tolist(), **(about or {})}
    return Run(rate, tuple(ticks), facts, updates)


@contextmanager
def _uncollected() -> Iterator[None]:
    """Keep the garbage collector out: it costs more than a tick, and what the loop makes has no cycles."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


class _Display:
    """What the operator is shown; grasps are placed anew only when they have been ranked anew.

    Attributes:
        step: the controller's last one.
    """

    def __init__(self, controller: SharedController) -> None:
        self._controller = controller
        self.step: ControlStep | None = None
        self._ranking: Ranking | None = None
        self._grasps: Mapping[str, Pose] = {}

    def view(self, measured: FollowerState, objects: Mapping[str, Pose]) -> OperatorView:
        """Return what there is to see now."""
        controller, step = self._controller, self.step
        if controller.ranking is not self._ranking:
            self._ranking, self._grasps = controller.ranking, controller.shown
        automatic = step is not None and step.mode.automatic
        goes_for = step.target if step is not None and automatic else None
        target = None if goes_for is None else _seen_target(goes_for, objects)
        X_WT = controller.robot.forward(measured.q)
        return OperatorView(
            controller.time, X_WT, automatic, controller.finished, objects, self._grasps, target
        )


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
