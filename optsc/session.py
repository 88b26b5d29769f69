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
from optsc.followers.protocol import Follower
from optsc.grasps import Candidates
from optsc.operators import Operator, OperatorView
from optsc.records import Run, RunInputs, Tick
from optsc.selection.reach import ClearRows


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
        about: what to keep with the run.
        on_tick: called after every tick, for live views.

    Raises:
        InvalidValue: rate or duration are not positive, or the start posture does not fit the robot.
    """
    for name, value in (("rate", rate), ("duration", duration)):
        if not (np.isfinite(value) and value > 0):
            raise InvalidValue(name, value, "positive and finite")
    q = controller.robot.checked(controller.robot.home if start is None else start, "start")
    controller.reset(q, rate)
    measured = follower.reset(q)
    if candidates is not None:
        controller.observe(candidates, clear)
    ticks: list[Tick] = []
    period = 1.0 / rate
    automatic = finished = False
    # A collection in the middle of a tick costs more than the tick; what the loop makes has no cycles.
    collecting = gc.isenabled()
    gc.disable()
    try:
        while controller.time < duration and not finished:
            objects = follower.objects()
            X_WT = controller.robot.forward(measured.q)
            sample = operator.read(OperatorView(controller.time, X_WT, automatic, finished, objects))
            before = perf_counter()
            step = controller.step(sample, measured)
            elapsed = perf_counter() - before
            automatic, finished = step.mode.automatic, controller.finished
            ticks.append(Tick(sample, measured, step, objects, elapsed))
            measured = follower.apply(step.command.q, step.command.v, step.opening, period)
            if on_tick is not None:
                on_tick(ticks[-1])
    finally:
        if collecting:
            gc.enable()
    return Run(rate, tuple(ticks), {"robot": controller.robot.name, "start": q.tolist(), **(about or {})})


def replay(
    controller: SharedController,
    inputs: RunInputs,
    candidates: Candidates | None = None,
    clear: ClearRows | None = None,
) -> Run:
    """Feed recorded inputs to a controller and return what it does: the same commands, bit for bit."""
    controller.reset(inputs.about["start"], inputs.about["rate"])
    if candidates is not None:
        controller.observe(candidates, clear)
    ticks = []
    for sample, measured in zip(inputs.samples, inputs.measured, strict=True):
        before = perf_counter()
        step = controller.step(sample, measured)
        ticks.append(Tick(sample, measured, step, {}, perf_counter() - before))
    return Run(inputs.about["rate"], tuple(ticks), dict(inputs.about))
