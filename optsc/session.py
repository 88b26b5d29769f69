"""The loop: operator, controller and follower, tick by tick; and replay of what was recorded."""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter
from typing import Any, NamedTuple

from numpy.typing import ArrayLike

from optsc.checks import AtLeast, Positive, require
from optsc.control.controller import ControlStep, SharedController
from optsc.control.status import error_text
from optsc.display import Display
from optsc.errors import OptscError
from optsc.followers import RecordedFollower
from optsc.followers.protocol import Follower, FollowerState
from optsc.geometry import Pose
from optsc.grasps import Candidates
from optsc.operators import Operator, OperatorSample, OperatorView
from optsc.real_time import RealTime
from optsc.records import Run, RunInputs, SceneUpdate, SolvedUpdate, Tick
from optsc.selection.reach import ClearRows

Watch = Callable[[float, FollowerState], SceneUpdate | SolvedUpdate | None]
"""``watch(time, measured)``: an observation of the scene at a time [s]; None where nothing has changed."""
Sink = Callable[[Tick], None]
"""Where the ticks of a loop go: a list's ``append``, a file, a page."""


_LOG = logging.getLogger(__name__)


class Interruption(NamedTuple):
    """Before which tick a run was interrupted, and why."""

    tick: int
    reason: str


class RunInterrupted(OptscError):
    """A run that an error of operator, follower, watch or sink has ended; the error is its cause.

    Attributes:
        run: what was recorded, with the ticks in which the arm came to rest.
    """

    def __init__(self, run: Run, error: Exception) -> None:
        self.run = run
        super().__init__(f"the run was interrupted after {len(run)} ticks: {error_text(error)}")


class RunCancelled(KeyboardInterrupt):
    """A run that was ended with Ctrl-C; also a `KeyboardInterrupt`.

    Attributes:
        run: what was recorded, with the ticks in which the arm came to rest.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        super().__init__(f"the run was cancelled after {len(run)} ticks")


class Session:
    """The loop of operator, controller and follower, which can be driven tick by tick and go on from anywhere.

    It goes on from where controller and follower are; `start` resets both first. A tick is `read`, what the operator
    does, and `advance`, what controller and follower make of it. Where the loop has a clock, a tick waits for its time.

    Args:
        controller: decides.
        operator: moves the hand.
        follower: executes; simulated ones advance by a period per tick, as quickly as they can.
        watch: observes the scene during the run, and says when grasps have to be placed again. It is outside of the
            control clock: simulated time stands still for it.
        watch_period: from one observation to the next [s]; the first is one period from now.
        display: what the operator is shown; by default the grasps as the controller ranks them.
        step: the controller's last decision, of a session that goes on where another was; it is shown to the operator.
        clock: waits for the time of each tick and tells it to the controller; None for as quickly as it goes.

    Attributes:
        measured: the follower's state before the next tick.
        step: the controller's last decision; None before the first tick.
        ticks: how many there were.
        updates: what the controller was told of the scene, by the index of the tick before which it was.
        stopping: the ticks in which the arm came to rest after an error, see `run`.
        interrupted: before which tick that was, and why; None where it was not.

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
        clock: RealTime | None = None,
    ) -> None:
        require("watch_period", watch_period, Positive)
        self.controller, self.operator, self.follower = controller, operator, follower
        self._watch, self._watch_period = watch, watch_period
        self._next_watch = controller.time + watch_period
        self._display = display or Display(controller)
        self._objects: Mapping[str, Pose] = {}
        self.measured = follower.state()
        self.step, self.clock = step, clock
        self.ticks = 0
        self.updates: dict[int, SceneUpdate | SolvedUpdate] = {}
        self.stopping: list[Tick] = []
        self._newest: Tick | None = None
        self._handed: Tick | None = None
        self.interrupted: Interruption | None = None

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

    def read(self, now: float | None = None) -> OperatorSample | None:
        """Observe the scene where that is due, and return what the operator does at this tick.

        ``now`` is what time it is [s], where the loop says it, see `SharedController.step`.
        """
        controller, time = self.controller, self.controller.time_at(now)
        self._objects = self.follower.objects()
        if self._watch is not None and time >= self._next_watch - 0.5 * controller.servo.period:
            self._next_watch += self._watch_period
            update = self._watch(time, self.measured)
            if update is not None:
                self.updates[self.ticks] = update
                controller.observe(*update)
        return self.operator.read(self._display.view(self.step, self.measured, self._objects, time))

    def advance(self, sample: OperatorSample | None, now: float | None = None) -> Tick:
        """Let the controller decide with a sample and the follower execute it; return the tick.

        What a follower raises, goes on; the tick is then taken back, as nobody has followed its command.
        """
        controller, before, start = self.controller, self.controller.snapshot(), perf_counter()
        step = controller.step(sample, self.measured, now)
        tick = Tick(sample, self.measured, step, self._objects, perf_counter() - start, now)
        command, period = step.command, controller.servo.period
        try:
            self.measured = self.follower.apply(command.q, command.v, step.opening, period)
        except BaseException:
            controller.restore(before)
            raise
        self.step, self._newest = step, tick
        self.ticks += 1
        return tick

    def tick(self, now: float | None = None) -> Tick:
        """Do one tick and return it, at the time that the clock says, if there is one, or at ``now`` [s]."""
        if self.clock is not None:
            now = self.clock.wait(self.controller.servo.period)
        return self.advance(self.read(now), now)

    def come_to_rest(self, reason: str, longest: float = 3.0) -> list[Tick]:
        """Hold for a reason and let the arm come to rest within its limits; return the ticks.

        Neither operator nor scene are asked. It ends when the arm rests, after ``longest`` [s], or with the error of a
        follower that no longer takes commands.
        """
        self.controller.hold(reason)
        period, ticks = self.controller.servo.period, []
        for _ in range(round(longest / period)):
            now = None if self.clock is None else self.clock.wait(period)
            ticks.append(self.advance(None, now))
            if not ticks[-1].step.command.v.any():
                break
        return ticks

    def run(self, until: float, sink: Sink, tasks: int | None = 1) -> None:
        """Do ticks up to the time ``until`` [s] of the controller, into a sink, or until ``tasks`` are finished.

        A task is finished when an object has been carried long enough, or put down again; None for any number of them.

        Where operator, follower, watch or sink raise, or somebody presses Ctrl-C, the arm is brought to rest before the
        error goes on, see `come_to_rest`; the ticks in which it does are in `stopping`.
        """
        try:
            self._run(until, sink, tasks)
        except BaseException as error:
            self._stop_for(error)
            raise

    def _stop_for(self, error: BaseException) -> None:
        reason = f"the run was interrupted: {type(error).__name__}"
        self.interrupted = Interruption(self.ticks, reason)
        # The arm may have followed a tick that the sink has never seen.
        self.stopping = [] if self._newest is None or self._newest is self._handed else [self._newest]
        try:
            self.stopping += self.come_to_rest(reason)
        except Exception as failure:  # noqa: BLE001 - the follower takes no commands any more: there is no arm to stop
            _LOG.error("the arm could not be brought to rest: %s", error_text(failure))

    def _run(self, until: float, sink: Sink, tasks: int | None) -> None:
        with _no_garbage_collection():
            while self.controller.time < until and (tasks is None or self.controller.state.tasks < tasks):
                tick = self._handed = self.tick()
                sink(tick)


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
    clock: RealTime | None = None,
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
        clock: lets the run go at the pace of the clock, and tells the controller how late ticks are; None for as
            quickly as it goes.

    Raises:
        InvalidValue: rate, duration or watch_period are not positive, or the start does not fit the robot.
        RunInterrupted: operator, follower, watch or ``on_tick`` raised; the arm has come to rest, and the error holds
            what was recorded.
        RunCancelled: the same for Ctrl-C.
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
        clock=clock,
    )
    q = controller.servo.guard.q.tolist()
    ticks: list[Tick] = []

    def sink(tick: Tick) -> None:
        if keep:
            ticks.append(tick)
        if on_tick is not None:
            on_tick(tick)

    facts = {"robot": controller.robot.name, "start": q, **(about or {})}

    def recorded() -> Run:
        kept = (*ticks, *session.stopping) if keep else ()
        if session.interrupted is not None:
            facts["interrupted"] = session.interrupted._asdict()
        return Run(rate, kept, facts, session.updates)

    try:
        session.run(duration, sink, tasks)
    except KeyboardInterrupt:
        raise RunCancelled(recorded()) from None
    except Exception as error:
        raise RunInterrupted(recorded(), error) from error
    return recorded()


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
    ticks, now = [], inputs.now or (None,) * count
    interrupted = about.get("interrupted")
    for index in range(count):
        if updates and index in updates:
            controller.observe(*updates[index])
        if interrupted and index == interrupted["tick"]:
            controller.hold(interrupted["reason"])
        ticks.append(session.tick(now[index]))
    return Run(about["rate"], tuple(ticks), dict(about), dict(updates or {}))


class _Samples:
    """An operator that hands in recorded samples, one a tick."""

    def __init__(self, samples: tuple[OperatorSample | None, ...]) -> None:
        self._samples = iter(samples)

    def read(self, view: OperatorView) -> OperatorSample | None:
        return next(self._samples, None)
