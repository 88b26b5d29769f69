"""One run of the fault test: into a mode, a fault, and then the operator who begins again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from optsc.control.controller_state import ControlStep
from optsc.control.modes import Mode
from optsc.control.status import error_text
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.operators import Button, OperatorSample
from optsc.study.faults.fault import Fault, Injection
from optsc.study.faults.world import AFTER, MOVED, MOVING_TIME, R_WS, World, smooth

FAULT_TIME = 1.6
"""For how long a run goes on after a fault has begun, before the operator begins again [s]."""
ENGAGES = 0.1
"""When the operator tries to leave hold [s] after the beginning."""
STILL = 0.1
"""For how long the hand is still after it has closed the clutch [s]."""
SETTLED = 0.6
"""A hand at rest for this long [s] has been caught up with."""
OPEN_TIME = 0.4
"""For how long the operator lets go of the clutch before taking over [s] ..."""
PATIENCE = 1.8
"""... and who waits until a clock is believed again [s]."""
SLOWEST = 0.02
"""The longest period of the samples [s]."""
AGAIN_TIME = 1.8
"""How long the operator leads the arm then [s]."""
TREMOR = 1e-4
"""Of a hand that waits for the robot [m]."""


class HalfDoneError(Exception):
    """A call between ticks was refused and has changed something all the same, or was not refused."""


@dataclass(eq=False)
class RunRow:
    """One tick of a run.

    Attributes:
        time: since the fault began [s].
        step: what the controller decided; None where an interrupt was passed on in its place.
        q: where the joints are (n,) [rad].
        X_WT: where the hand leads the tool to, where that is known.
        hand_q: the orientation of the hand in W, which an absolute mapping leads the tool to.
        opening: of the jaws [m].
        resting: for how long the hand has been at rest [s].
        finished: whether the task counts as finished, and whether the object is in the jaws.
        limits: joint limits that are kept at this tick.
    """

    time: float
    step: ControlStep | None
    q: Array
    X_WT: Pose | None
    hand_q: Array
    opening: float
    resting: float
    finished: bool
    holding: bool
    limits: Any


@dataclass(eq=False)
class Record:
    """What a run was.

    Attributes:
        fault, mode: what was done, and in which mode.
        first: position, velocity, acceleration (n, 3) before it.
        limits: joint limits before it.
        rows: its ticks.
        again: index of the first tick of the operator who begins again.
        exception: what came out of `step` or of the follower, in words; None for nothing.
        jump: the largest step of the arm in a period, beyond what it moves at its greatest speed [rad].
        interrupted: whether an interrupt was passed on, and the state after it was the one before.
    """

    fault: Fault
    mode: Mode
    first: Array
    limits: Any
    rows: list[RunRow] = field(default_factory=list)
    again: int = 0
    exception: str | None = None
    jump: float = 0.0
    interrupted: bool | None = None


class _Operator:
    """The script: what the hand does, and to where it leads the tool."""

    def __init__(self, world: World, mode: Mode, rng: np.random.Generator, open_time: float) -> None:
        start = world.starts[mode]
        self.open_time = open_time
        self.world, self.mode, self.hand, self.coupled = world, mode, start.hand, start.coupled
        away = rng.normal(size=3)
        away[2] = abs(away[2])
        self.away = away / np.linalg.norm(away)
        self.resting, self.clutch, self.phase = 0.0, mode is not Mode.HOLD, rng.uniform(0.0, 6.0)
        self.base, self.last = start.hand, 0.0
        self.home = world.robot.forward(world.robot.home)

    def move(self, axis: Array, length: float, since: float, until: float, duration: float) -> bool:
        """Move the hand along ``axis`` in W; return whether it moves."""
        share = smooth(until / duration) - smooth(since / duration)
        if share == 0.0:
            return False
        step = rotation.rotate(rotation.conjugate(np.array(R_WS)), length * share * axis)
        self.hand = Pose(self.hand.quaternion, self.hand.translation + step)
        return True

    def couple(self, still: bool) -> None:
        """Close the clutch; from the tick at which the hand leads the tool, and is still, it is known where to."""
        self.clutch = True
        controller = self.world.controller
        if still and self.coupled is None and controller.mode is Mode.MANUAL:
            tool = self.world.robot.forward(controller.servo.guard.q)
            self.coupled = tool, self.world.in_world(self.hand)

    @property
    def target(self) -> Pose | None:
        """Where the hand leads the tool to."""
        if self.coupled is None or not self.clutch:
            return None
        tool, hand = self.coupled
        return Pose(tool.quaternion, tool.translation + self.world.in_world(self.hand).translation - hand.translation)

    def after(self, time: float) -> OperatorSample:
        """Return the sample at ``time`` [s] after the beginning, during the fault."""
        step, moving = time - self.last, False
        if self.mode is Mode.HOLD:
            if time >= ENGAGES:
                self.couple(time < ENGAGES + STILL)
            since = time - ENGAGES - STILL
            moving = self.move(self.away, 0.5 * MOVED, since - step, since, 0.6)
        elif self.mode is Mode.MANUAL:
            since = time + AFTER[Mode.MANUAL]
            moving = self.move(np.array([0.0, 0.6, 0.8]), MOVED, since - step, since, MOVING_TIME)
        else:
            shake = TREMOR * np.sin(np.array([61.0, 53.0, 47.0]) * time + self.phase)
            self.hand = Pose(self.base.quaternion, self.base.translation + shake)
        self.resting, self.last = (0.0 if moving else self.resting + step), time
        return OperatorSample(0.0, self.hand, self.clutch)

    def begin_again(self) -> None:
        """Let go, and see where the arm can be led to."""
        self.clutch, self.coupled, self.last, self.resting = False, None, 0.0, 0.0
        back = self.home.translation - self.world.robot.forward(self.world.arm.now.state.q).translation
        if np.linalg.norm(back) > MOVED:
            self.away = back / np.linalg.norm(back)

    def again(self, time: float) -> OperatorSample:
        """Return the sample at ``time`` [s] after the fault: let go, take over, lead the arm, and rest."""
        step, self.last = time - self.last, time
        if time < self.open_time:
            # In manual mode and in hold nothing has to be cancelled.
            cancel = self.world.controller.mode.automatic and time > 0.05
            buttons = frozenset({Button.CANCEL}) if cancel else frozenset()
            return OperatorSample(0.0, self.hand, False, buttons=buttons)
        self.couple(time < self.open_time + STILL)
        since = time - self.open_time - STILL
        moving = self.move(self.away, 0.5 * MOVED, since - step, since, 0.6)
        self.resting = 0.0 if moving else self.resting + step
        return OperatorSample(0.0, self.hand, True)


class _Run:
    """A run in progress."""

    def __init__(self, world: World, mode: Mode, fault: Fault, seed: tuple[int, ...]) -> None:
        self.world, self.fault, self.rng = world, fault, np.random.default_rng(seed)
        world.restore(mode)
        self.operator = _Operator(world, mode, self.rng, PATIENCE if fault.patient else OPEN_TIME)
        self.injection: Injection = fault.inject(world, self.rng)
        most = min(5, max(1, round(SLOWEST / world.period)))
        self.every = 1 if fault.quick else int(self.rng.integers(1, most + 1))
        guard = world.controller.servo.guard
        self.record = Record(fault, mode, np.column_stack(guard.state), guard.limits)
        self.clock = world.controller.time
        """The true time [s], which a device's clock and the loop's tell where nothing is wrong."""
        self.begun: float | None = None
        self.over, self.number = False, 0
        self.used = False
        self.begins = ENGAGES if fault.leaving and mode is Mode.HOLD else 0.0

    def active(self, elapsed: float) -> bool:
        """Tell whether the fault is on."""
        return self.begun is not None and not self.over and elapsed <= self.fault.lasts

    def once(self) -> bool:
        """Tell whether a fault of one tick may be done now; it may only once."""
        if self.fault.lasts > 0.0:
            return True
        first, self.used = not self.used, True
        return first

    def tick(self, made: OperatorSample, time: float) -> bool:
        """Do one tick; return whether the run goes on."""
        try:
            return self._tick(made, time)
        except HalfDoneError as error:
            self.record.exception = f"half a call: {error}"
            return False

    def _tick(self, made: OperatorSample, time: float) -> bool:
        world, injection = self.world, self.injection
        if self.begun is None and time >= self.begins:
            self.begun = time
            self._arm_parts()
            if injection.start is not None:
                injection.start(world)
        elapsed = 0.0 if self.begun is None else time - self.begun
        on = self.active(elapsed) if self.fault.lasts > 0.0 else self.begun is not None and not self.over
        if self.begun is not None and not on and not self.over:
            self.end()
        if on and injection.tick is not None and (self.fault.lasts > 0.0 or not self.used):
            injection.tick(world, elapsed)
        sample: Any = self._sample(made, elapsed, on)
        measured: Any = world.arm.measured()
        if on and injection.reading is not None and self.once():
            measured = injection.reading(elapsed, measured)
        now: Any = self.clock if world.timed else None
        if on and injection.now is not None and self.once():
            now = injection.now(elapsed, self.clock)
        return self._step(sample, measured, now, time)

    def _arm_parts(self) -> None:
        parts = dict(self.injection.parts)
        if self.fault.lasts > 0.0:
            self.world.hooks.set(parts)
            return

        def first(hook: Any) -> Any:
            return lambda genuine, arguments: hook(genuine, arguments) if self.once() else genuine(*arguments)

        self.world.hooks.set({name: first(hook) for name, hook in parts.items()})

    def _sample(self, made: OperatorSample, elapsed: float, on: bool) -> Any:
        if self.number % self.every:
            return None
        sample: Any = made._replace(stamp=self.clock)
        if on and self.injection.hand is not None and self.once():
            sample = self.injection.hand(elapsed, sample)
        if sample is None:
            return None
        if on and self.injection.sample is not None and self.once():
            sample = self.injection.sample(elapsed, sample)
        return sample

    def _step(self, sample: Any, measured: Any, now: Any, time: float) -> bool:
        world, record = self.world, self.record
        before = world.controller.snapshot() if self.fault.interrupts else None
        step: ControlStep | None = None
        try:
            step = world.controller.step(sample, measured, now=now)
            world.follow(step)
        except KeyboardInterrupt:
            record.interrupted = world.controller.snapshot() == before
        except Exception as error:  # noqa: BLE001 - what comes out of `step` is what is tested
            whose = "" if step is None else "by the arm, which refuses the command: "
            record.exception = whose + error_text(error)
        operator, controller = self.operator, world.controller
        record.rows.append(
            RunRow(
                time,
                step,
                world.arm.now.state.q,
                operator.target,
                world.in_world(operator.hand).quaternion,
                world.arm.now.state.opening,
                operator.resting,
                controller.finished,
                world.arm.holding,
                controller.servo.guard.limits,
            )
        )
        return record.exception is None

    def end(self) -> None:
        """Let the fault be over."""
        if not self.over:
            self.over = True
            self.world.hooks.set({})
            if self.injection.end is not None:
                self.injection.end(self.world)

    def run(self) -> Record:
        """Return what it was."""
        if self._phase(self.operator.after, 0.0, FAULT_TIME):
            if not self.fault.permanent:
                self.end()
            self.record.again = len(self.record.rows)
            self.operator.begin_again()
            self._phase(self.operator.again, FAULT_TIME, self.operator.open_time + AGAIN_TIME)
        self.record.jump = self.world.arm.now.jump
        return self.record

    def _phase(self, made: Callable[[float], OperatorSample], since: float, duration: float) -> bool:
        """Do the ticks of ``duration`` [s]; return whether the run goes on."""
        time = 0.0
        while time < duration - 0.5 * self.world.period:
            if not self.tick(made(time), since + time):
                return False
            periods = 1.0
            if self.injection.duration is not None and self.begun is not None and not self.over:
                periods = self.injection.duration(since + time - self.begun)
            time += periods * self.world.period
            self.clock += periods * self.world.period
            self.number += 1
        return True


def run(world: World, mode: Mode, fault: Fault, seed: tuple[int, ...]) -> Record:
    """Return what a fault does in a mode: the same for the same seed."""
    one = _Run(world, mode, fault, seed)
    try:
        return one.run()
    finally:
        one.end()
