"""The loop: operator, controller and follower, tick by tick; and replay of what was recorded."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import AtLeast, Positive, require
from optsc.control.arbitration import Goal
from optsc.control.controller import ControlStep, SharedController
from optsc.followers import RecordedFollower
from optsc.followers.protocol import Follower, FollowerState
from optsc.geometry import Pose
from optsc.grasps import Candidates
from optsc.operators import Operator, OperatorSample, OperatorView
from optsc.records import Run, RunInputs, SceneUpdate, SolvedUpdate, Tick
from optsc.selection import Ranking, Target
from optsc.selection.reach import ClearRows

Watch = Callable[[float, FollowerState], SceneUpdate | SolvedUpdate | None]
"""``watch(time, measured)``: an observation of the scene at a time [s]; None where nothing has changed."""
Sink = Callable[[Tick], None]
"""Where the ticks of a loop go: a list's ``append``, a file, a page."""


class Display:
    """What the operator is shown; grasps are placed again only when they have been ranked again."""

    def __init__(self, controller: SharedController) -> None:
        self._controller = controller
        self._placed: tuple[Ranking | None, tuple[Goal, ...]] = (None, ())
        self._grasps: Mapping[str, Pose] = {}

    def grasps(self) -> Mapping[str, Pose]:
        """Return the grasp to mark for each object, tool poses in W."""
        choice, (ranking, goals) = self._controller.state.choice, self._placed
        if choice.ranking is not ranking or choice.goals is not goals:
            self._placed, self._grasps = (choice.ranking, choice.goals), self._controller.shown
        return self._grasps

    def view(self, step: ControlStep | None, measured: FollowerState, objects: Mapping[str, Pose]) -> OperatorView:
        """Return what there is to see after ``step``, the last one; None before the first."""
        controller = self._controller
        automatic = step is not None and step.mode.automatic
        goes_for = step.target if step is not None and automatic else None
        target = None if goes_for is None else _seen_target(goes_for, objects)
        X_WT = controller.robot.forward(measured.q)
        view = OperatorView(controller.time, X_WT, automatic, controller.finished, objects, self.grasps(), target)
        if step is None:
            return view
        held = None if step.held is None else step.held.object_name
        # What was a tick ago is what can be seen, but for the mode, which is the present one.
        return view._replace(
            mode=controller.mode.value, status=step.command.status.value, reason=step.reason, held=held
        )


def _seen_target(target: Target, objects: Mapping[str, Pose]) -> str:
    """Return which of the objects the robot is seen to go for, whatever the controller may call it."""
    if target.object_name in objects or not objects:
        return target.object_name
    p = target.X_WG.translation
    return min(objects, key=lambda name: float(np.linalg.norm(objects[name].translation - p)))


class Session:
    """The loop of operator, controller and follower, which can be driven tick by tick and go on from anywhere.

    It goes on from where controller and follower are; `start` resets both first. A tick is `read`, what the operator
    does, and `advance`, what controller and follower make of it.

    Args:
        controller: decides.
        operator: moves the hand.
        follower: executes; simulated ones advance by a period per tick, as quickly as they can.
        watch: observes the scene during the run, and says when grasps have to be placed again. It is outside of the
            control clock: simulated time stands still for it.
        watch_period: from one observation to the next [s]; the first is one period from now.
        display: what the operator is shown; by default the grasps as the controller ranks them.
        step: the controller's last decision, of a session that goes on where another was; it is shown to the operator.

    Attributes:
        measured: the follower's state before the next tick.
        step: the controller's last decision; None before the first tick.
        ticks: how many there were.
        updates: what the controller was told of the scene, by the index of the tick before which it was.

    Raises:
        InvalidValue: a watch period that is not positive.
    """

    def __init__(
        self,
        controller: SharedController,
        *,
        operator: Operator,
        follower: Follower,
        watch: Watch | None = None,
        watch_period: float = 0.2,
        display: Display | None = None,
        step: ControlStep | None = None,
    ) -> None:
        require("watch_period", watch_period, Positive)
        self.controller, self.operator, self.follower = controller, operator, follower
        self._watch, self._watch_period = watch, watch_period
        self._next_watch = controller.time + watch_period
        self._display = display or Display(controller)
        self._objects: Mapping[str, Pose] = {}
        self.measured = follower.state()
        self.step = step
        self.ticks = 0
        self.updates: dict[int, SceneUpdate | SolvedUpdate] = {}

    @classmethod
    def start(
        cls,
        controller: SharedController,
        *,
        operator: Operator,
        follower: Follower,
        candidates: Candidates | None = None,
        clear: ClearRows | None = None,
        rate: float = 500.0,
        start: ArrayLike | None = None,
        **options: Any,
    ) -> Session:
        """Return a loop from the beginning: controller and follower are reset, see `run` for the arguments."""
        require("rate", rate, Positive)
        q = controller.robot.checked(controller.robot.home if start is None else start, "start")
        controller.reset(q, rate)
        follower.reset(q)
        if candidates is not None:
            controller.observe(candidates, clear)
        return cls(controller, operator=operator, follower=follower, **options)

    def read(self) -> OperatorSample | None:
        """Observe the scene where that is due, and return what the operator does at this tick."""
        controller, time = self.controller, self.controller.time
        self._objects = self.follower.objects()
        if self._watch is not None and time >= self._next_watch - 0.5 * controller.servo.period:
            self._next_watch += self._watch_period
            update = self._watch(time, self.measured)
            if update is not None:
                self.updates[self.ticks] = update
                controller.observe(*update)
        return self.operator.read(self._display.view(self.step, self.measured, self._objects))

    def advance(self, sample: OperatorSample | None) -> Tick:
        """Let the controller decide with a sample and the follower execute it; return the tick."""
        before = perf_counter()
        step = self.controller.step(sample, self.measured)
        tick = Tick(sample, self.measured, step, self._objects, perf_counter() - before)
        self.step = step
        self.ticks += 1
        period = self.controller.servo.period
        self.measured = self.follower.apply(step.command.q, step.command.v, step.opening, period)
        return tick

    def tick(self) -> Tick:
        """Do one tick and return it."""
        return self.advance(self.read())

    def run(self, until: float, sink: Sink, tasks: int | None = 1) -> None:
        """Do ticks up to the time ``until`` [s] of the controller, into a sink, or until ``tasks`` are finished.

        A task is finished when an object has been carried long enough, or put down again; None for any number of them.
        """
        with _no_garbage_collection():
            while self.controller.time < until and (tasks is None or self.controller.state.tasks < tasks):
                sink(self.tick())


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Keep the garbage collector out: it costs more than a tick, and what the loop makes has no cycles."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


def run(
    controller: SharedController,
    *,
    operator: Operator,
    follower: Follower,
    candidates: Candidates | None = None,
    clear: ClearRows | None = None,
    rate: float = 500.0,
    duration: float = 60.0,
    tasks: int | None = 1,
    start: ArrayLike | None = None,
    watch: Watch | None = None,
    watch_period: float = 0.2,
    about: Mapping[str, Any] | None = None,
    on_tick: Sink | None = None,
    keep: bool = True,
) -> Run:
    """Run until the tasks are finished or ``duration`` is over, in the follower's time, and return all ticks.

    Args:
        controller: is reset first.
        operator: moves the hand.
        follower: is reset first; simulated ones advance by a period per tick, as quickly as they can.
        candidates: the grasps of the scene, where the task is to grasp.
        clear: which of them the arm can execute without collision, see `optsc.collision.GraspClearance`.
        rate: control rate [Hz].
        duration: the longest run [s].
        tasks: how many objects are to be carried, or put down again, before the run ends; None for any number.
        start: configuration (n,) [rad] to start from, the robot's home by default.
        watch, watch_period: observe the scene during the run, see `Session`.
        about: what to keep with the run.
        on_tick: called after every tick, for live views and recorders.
        keep: whether the returned run holds the ticks. Ten megabytes a second add up: in a long run let ``on_tick``
            take what is needed.

    Raises:
        InvalidValue: rate, duration or watch_period are not positive, or the start does not fit the robot.
    """
    require("duration", duration, Positive)
    if tasks is not None:
        require("tasks", tasks, AtLeast(1))
    session = Session.start(
        controller,
        operator=operator,
        follower=follower,
        candidates=candidates,
        clear=clear,
        rate=rate,
        start=start,
        watch=watch,
        watch_period=watch_period,
    )
    q = controller.servo.guard.q.tolist()
    ticks: list[Tick] = []

    def sink(tick: Tick) -> None:
        if keep:
            ticks.append(tick)
        if on_tick is not None:
            on_tick(tick)

    session.run(duration, sink, tasks)
    facts = {"robot": controller.robot.name, "start": q, **(about or {})}
    return Run(rate, tuple(ticks), facts, session.updates)


def replay(
    controller: SharedController,
    inputs: RunInputs,
    candidates: Candidates | None = None,
    clear: ClearRows | None = None,
    updates: Mapping[int, SceneUpdate | SolvedUpdate] | None = None,
) -> Run:
    """Feed recorded inputs to a controller and return what it does: the same commands, bit for bit."""
    about, count = inputs.about, len(inputs.samples)
    session = Session.start(
        controller,
        operator=_Samples(inputs.samples),
        follower=RecordedFollower(inputs.measured),
        candidates=candidates,
        clear=clear,
        rate=about["rate"],
        start=about["start"],
    )
    ticks = []
    for index in range(count):
        if updates and index in updates:
            controller.observe(*updates[index])
        ticks.append(session.tick())
    return Run(about["rate"], tuple(ticks), dict(about), dict(updates or {}))


class _Samples:
    """An operator that hands in recorded samples, one a tick."""

    def __init__(self, samples: tuple[OperatorSample | None, ...]) -> None:
        self._samples = iter(samples)

    def read(self, view: OperatorView) -> OperatorSample | None:
        return next(self._samples, None)
