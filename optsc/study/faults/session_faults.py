"""Faults of the loop itself: exceptions and interrupts from the operator, the arm, whoever watches or records."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType, TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optsc.control.modes import Mode
from optsc.followers.protocol import FollowerState
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.operators import OperatorSample, OperatorView
from optsc.records import Tick
from optsc.session import Session
from optsc.study.faults.fault import FROM_THEN_ON, ONCE, Fault, everywhere, stops
from optsc.study.faults.part_faults import fails, interrupted, part
from optsc.study.faults.world import MOVED, World

BEGINS = 40
"""Ticks before the fault."""
LONGEST = 3.0
"""Time that a session would go on for [s]."""
REST = 1e-6
"""Joint speed [rad/s] below which an arm is at rest."""
TOLERANCE = 1e-9
"""What is taken for rounding, in the unit of each limit."""


class _Counted:
    """Parts that answer as they should for a while, and then as the world's hooks say."""

    def __init__(self, world: World, once: bool) -> None:
        self.world, self.once, self.count = world, once, dict[str, int]()

    def call(self, name: str, genuine: Callable[..., Any], *arguments: Any) -> Any:
        """Return what the part of that name answers."""
        self.count[name] = self.count.get(name, 0) + 1
        number = self.count[name]
        if number < BEGINS or (self.once and number > BEGINS):
            return genuine(*arguments)
        return self.world.hooks.call(name, genuine, *arguments)


class _SteadyHand:
    """A hand that moves steadily, and is always coupled."""

    def __init__(self, counted: _Counted, hand: Pose) -> None:
        self._counted, self._hand = counted, hand

    def read(self, view: OperatorView) -> OperatorSample | None:
        """Return the sample of this tick, or what the hook answers."""
        return self._counted.call("operator", self._sample, view)

    def _sample(self, view: OperatorView) -> OperatorSample:
        step = MOVED * self._counted.world.period
        self._hand = Pose(self._hand.quaternion, self._hand.translation + np.array([0.0, 0.6 * step, 0.8 * step]))
        return OperatorSample(view.time, self._hand)


class _Arm:
    """The world's arm as a `Follower`, which keeps every command that it has followed."""

    def __init__(self, counted: _Counted) -> None:
        self._counted, self.arm, self.commands = counted, counted.world.arm, list[tuple[Array, Array]]()

    def state(self) -> FollowerState:
        """Return where the arm is."""
        return self.arm.measured()

    def reset(self, q: ArrayLike) -> FollowerState:
        """Leave it where it is."""
        return self.arm.measured()

    def at(self, state: FollowerState) -> _Arm:
        """Leave it where it is."""
        return self

    def apply(self, q: ArrayLike, v: ArrayLike, opening: float, period: float) -> FollowerState:
        """Follow a command, or what the hook answers."""
        return self._counted.call("follower", self._apply, q, v, opening, period)

    def _apply(self, q: ArrayLike, v: ArrayLike, opening: float, period: float) -> FollowerState:
        self.arm.apply(q, v, opening, period)
        self.commands.append((np.array(q, dtype=float), np.array(v, dtype=float)))
        return self.arm.measured()

    def objects(self) -> Mapping[str, Pose]:
        """Return no objects."""
        return MappingProxyType({})

    def close(self) -> None:
        """Do nothing."""

    def __enter__(self) -> _Arm:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Do nothing."""


def session_problems(world: World, mode: Mode, fault: Fault, seed: tuple[int, ...]) -> list[str]:
    """Return what is wrong with a session in which a fault comes up, in words; empty where nothing is."""
    start = world.restore(mode)
    first = np.column_stack(world.controller.servo.guard.state)
    injection = fault.inject(world, np.random.default_rng(seed))
    world.hooks.set(dict(injection.parts))
    counted = _Counted(world, fault.lasts == ONCE)
    arm, ticks = _Arm(counted), list[Tick]()
    session = Session(
        world.controller,
        operator=_SteadyHand(counted, start.hand),
        follower=arm,
        watch=lambda time, measured: counted.call("watch", lambda *_: None, time, measured),
        watch_period=world.period,
        step=start.step,
    )
    try:
        session.run(world.controller.time + LONGEST, lambda tick: counted.call("sink", ticks.append, tick), None)
    except (Exception, KeyboardInterrupt):  # noqa: BLE001 - that something comes out is what is expected
        pass
    finally:
        world.hooks.set({})
    return list(_of_session(world, first, arm, ticks))


def _of_session(world: World, first: Array, arm: _Arm, ticks: list[Tick]) -> Iterator[str]:
    if len(ticks) < BEGINS - 1:
        yield f"only {len(ticks)} of the {BEGINS - 1} ticks before the fault were recorded"
    if not arm.commands:
        return
    limits, period = world.robot.limits, world.period
    q, v = (np.vstack([first[:, i], *(command[i] for command in arm.commands)]) for i in (0, 1))
    a = np.vstack([first[:, 2], (v[1:] - v[:-1]) / period])
    if np.abs(v[-1]).max() > REST:
        yield f"the arm was left moving at {np.abs(v[-1]).max():.3g} rad/s"
    if np.abs(q[1:] - q[:-1] - 0.5 * period * (v[1:] + v[:-1])).max() > TOLERANCE:
        yield "the commands are not one motion"
    # The accelerations are differences of velocities here, and carry their rounding.
    if (np.abs(a[1:] - a[:-1]) / period > limits.jerk * (1.0 + TOLERANCE) + 1e-7 / period).any():
        yield "jerk of a command is too large"
    if (np.abs(a[1:]) > limits.acceleration * (1.0 + TOLERANCE)).any():
        yield "acceleration of a command is too large"


def faults() -> Iterator[Fault]:
    """Yield them all."""
    expected = everywhere(stops())
    for name, words in (
        ("operator", "the operator's device"),
        ("watch", "whoever watches the scene"),
        ("sink", "whoever records"),
        ("follower", "the arm's driver"),
    ):
        lasting = ONCE if name == "follower" else FROM_THEN_ON
        yield Fault(f"{words} raises in a session", "session", lasting, part(name, hook=fails), expected)
        yield Fault(f"Ctrl-C in a session ({words})", "session", ONCE, part(name, hook=interrupted), expected)
