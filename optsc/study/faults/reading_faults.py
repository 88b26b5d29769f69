"""Faults of what is measured: readings that are none, that glitch, freeze, drift or lag; jaws that hold nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from optsc.control.modes import Mode
from optsc.followers.protocol import FollowerState
from optsc.study.faults.fault import (
    FROM_THEN_ON,
    ONCE,
    Expected,
    Fault,
    Inject,
    Injection,
    everywhere,
    goes_on,
    goes_on_everywhere,
    holds,
    holds_led,
    is_safe,
    stays_in_hold,
)
from optsc.study.faults.sample_faults import INF, NAN, Raises
from optsc.study.faults.world import World

Reading = Callable[[FollowerState], Any]
STOPS = Expected(stays_in_hold(), holds(), holds())
"""An arm whose place is unknown does not move."""


def read(change: Reading) -> Inject:
    """Return a fault of readings."""
    return lambda _, __: Injection(reading=lambda ___, state: change(state))


def _first(value: float) -> Reading:
    def change(state: FollowerState) -> FollowerState:
        state.q[0] = value
        return state

    return change


NO_READINGS: dict[str, Reading] = {
    "nothing": lambda _: None,
    "a word": lambda _: "here",
    "an object that raises": lambda _: Raises(),
    "fields that are nothing": lambda _: FollowerState(None, None, None, None),  # type: ignore[arg-type]
    "fields that are words": lambda _: FollowerState("t", "q", "v", "o"),  # type: ignore[arg-type]
    "a joint too many": lambda s: s._replace(q=np.append(s.q, 0.0), v=np.append(s.v, 0.0)),
    "a joint too few": lambda s: s._replace(q=s.q[:-1], v=s.v[:-1]),
    "a matrix": lambda s: s._replace(q=s.q[None], v=s.v[None]),
    "a list": lambda s: s._replace(q=s.q.tolist()[:-1]),
    "one joint not a number": _first(NAN),
    "one joint infinite": _first(INF),
    "one joint at 1e300": _first(1e300),
    "all not a number": lambda s: FollowerState(NAN, NAN * s.q, NAN * s.v, NAN),
    "positions that raise": lambda s: FollowerState(s.time, Raises(), s.v, s.opening),  # type: ignore[arg-type]
}
"""What is no reading."""
LASTING = tuple(NO_READINGS)


def _off(low: float, high: float) -> Inject:
    """Readings that are off by some angle in all joints."""

    def inject(world: World, rng: np.random.Generator) -> Injection:
        offset = rng.choice([-1.0, 1.0], world.robot.n) * rng.uniform(low, high, world.robot.n)
        return Injection(reading=lambda _, state: state._replace(q=state.q + offset))

    return inject


def _frozen(_: World, __: np.random.Generator) -> Injection:
    seen: list[FollowerState] = []

    def reading(_: float, state: FollowerState) -> FollowerState:
        seen.append(state)
        return seen[0]

    return Injection(reading=reading)


def _drifting(world: World, rng: np.random.Generator) -> Injection:
    rate = rng.normal(size=world.robot.n)
    rate *= 0.7 / np.abs(rate).max()
    return Injection(reading=lambda elapsed, state: state._replace(q=state.q + rate * elapsed))


def _lagging(delay: float) -> Inject:
    def inject(world: World, _: np.random.Generator) -> Injection:
        seen: list[FollowerState] = []

        def reading(_: float, state: FollowerState) -> FollowerState:
            seen.append(state)
            return seen[max(0, len(seen) - 1 - round(delay / world.period))]

        return Injection(reading=reading)

    return inject


def _glitches(world: World, rng: np.random.Generator) -> Injection:
    """One reading in ten is anywhere."""

    def reading(_: float, state: FollowerState) -> FollowerState:
        if rng.random() < 0.1:
            state.q[int(rng.integers(world.robot.n))] += rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-0.5, 2.0)
        return state

    return Injection(reading=reading)


def _noisy(size: float) -> Inject:
    def inject(_: World, rng: np.random.Generator) -> Injection:
        return Injection(reading=lambda _, state: state._replace(q=state.q + rng.normal(0.0, size, len(state.q))))

    return inject


def pushed(low: float, high: float) -> Inject:
    """A braked arm is pushed; the brakes are let go of when the controller leaves hold."""

    def inject(world: World, rng: np.random.Generator) -> Injection:
        offset = rng.normal(size=world.robot.n)
        offset *= rng.uniform(low, high) / np.abs(offset).max()
        lower, upper = world.robot.limits.positions
        aim = np.clip(world.arm.now.state.q + offset, lower + 0.02, upper - 0.02)
        held: list[bool] = []

        def start(world: World) -> None:
            world.arm.change(braked=True)
            world.arm.move(aim - world.arm.now.state.q)

        def tick(world: World, _: float) -> None:
            if world.controller.mode is Mode.HOLD:
                held.append(True)
            elif held:
                world.arm.change(braked=False)

        return Injection(start=start, tick=tick, end=lambda world: world.arm.change(braked=False))

    return inject


def _braked(_: World, __: np.random.Generator) -> Injection:
    """The arm stands, wherever it is commanded."""
    return Injection(
        start=lambda world: world.arm.change(braked=True),
        end=lambda world: world.arm.change(braked=False, let_go=True),
    )


def _jaws(**fields: Any) -> Inject:
    """The jaws or what is in them change for good."""
    return lambda _, __: Injection(start=lambda world: world.arm.change(**fields))


def _opening(value: Any) -> Inject:
    return read(lambda state: state._replace(opening=value))


OPENINGS: dict[str, Any] = {
    "not a number": NAN,
    "infinite": INF,
    "nothing": None,
    "negative": -0.5,
    "a word": "open",
    "1e300": 1e300,
    "an array": np.zeros(2),
    "complex": 1j,
}
"""What is no opening."""
EMPTY = Expected(is_safe(), is_safe(), is_safe(), {Mode.CLOSE: is_safe(Mode.LIFT, Mode.CARRY)})
"""Nothing is lifted that is not held, and `finished` is never said, which is checked anyway."""
NOT_ARRIVED = Expected(is_safe(), is_safe(), is_safe(), {Mode.ADVANCE: is_safe(Mode.CLOSE)})
"""The jaws are not closed where the arm is not known to be."""


def faults() -> Iterator[Fault]:
    """Yield them all."""
    for name, change in NO_READINGS.items():
        yield Fault(f"one reading is none ({name})", "reading", ONCE, read(change), everywhere(is_safe()), leaving=True)
    for name in LASTING:
        inject = read(NO_READINGS[name])
        yield Fault(f"no reading is one ({name})", "reading", FROM_THEN_ON, inject, STOPS)
    for low, high in ((0.3, 0.5), (1.0, 3.0), (50.0, 99.0)):
        what = f"one reading off by {low:g} to {high:g} rad"
        yield Fault(what, "reading", ONCE, _off(low, high), everywhere(is_safe()), leaving=True)
    off = Expected(is_safe(), holds_led(), holds_led())
    yield Fault("readings jump by 0.4 to 1 rad", "reading", FROM_THEN_ON, _off(0.4, 1.0), off, far=True)
    yield Fault("readings freeze", "reading", FROM_THEN_ON, _frozen, NOT_ARRIVED)
    yield Fault("readings drift", "reading", FROM_THEN_ON, _drifting, off, far=True)
    yield Fault("readings 20 ms late", "reading", FROM_THEN_ON, _lagging(0.02), goes_on_everywhere())
    yield Fault("readings 0.3 s late", "reading", FROM_THEN_ON, _lagging(0.3), everywhere(is_safe()))
    yield Fault("one reading in ten is anywhere", "reading", FROM_THEN_ON, _glitches, everywhere(is_safe()))
    yield Fault("readings with 1 mrad of noise", "reading", FROM_THEN_ON, _noisy(1e-3), goes_on_everywhere())
    yield Fault("the clock of the readings stands", "reading", FROM_THEN_ON, _stopped_clock, goes_on_everywhere())
    in_hold = (Mode.HOLD,)
    for low, high in ((0.03, 0.07), (0.12, 0.18), (0.25, 0.29), (0.4, 0.6), (0.9, 1.1)):
        what = f"a held arm is pushed by {low:g} to {high:g} rad"
        yield Fault(
            what,
            "reading",
            FROM_THEN_ON,
            pushed(low, high),
            everywhere(is_safe()),
            modes=in_hold,
            far=True,
            permanent=True,
            recouples=True,
        )
    moving = tuple(mode for mode in Mode if mode is not Mode.HOLD)
    yield Fault(
        "the arm is stopped and pushed",
        "reading",
        FROM_THEN_ON,
        pushed(0.4, 0.6),
        everywhere(holds_led()),
        modes=moving,
        far=True,
        permanent=True,
    )
    yield Fault("the arm stands", "reading", FROM_THEN_ON, _braked, NOT_ARRIVED, modes=moving, far=True)
    yield from _of_jaws()


def _stopped_clock(_: World, __: np.random.Generator) -> Injection:
    return Injection(reading=lambda _, state: state._replace(time=0.0))


def _of_jaws() -> Iterator[Fault]:
    for name, value in OPENINGS.items():
        yield Fault(f"one opening is none ({name})", "jaws", ONCE, _opening(value), everywhere(is_safe()))
        yield Fault(f"no opening is one ({name})", "jaws", FROM_THEN_ON, _opening(value), EMPTY)
    yield Fault("nothing between the jaws", "jaws", FROM_THEN_ON, _jaws(width=0.0), EMPTY)
    wide = Expected(goes_on(), goes_on(), is_safe(), {Mode.CLOSE: is_safe(Mode.LIFT, Mode.CARRY)})
    yield Fault("something too wide between the jaws", "jaws", FROM_THEN_ON, _jaws(width=0.06), wide)
    yield Fault("the jaws do not close", "jaws", FROM_THEN_ON, _jaws(jaws_stuck=True), wide)
    yield Fault("the opening is not measured any more", "jaws", FROM_THEN_ON, _frozen_opening, everywhere(is_safe()))


def _frozen_opening(_: World, __: np.random.Generator) -> Injection:
    seen: list[float] = []

    def reading(_: float, state: FollowerState) -> FollowerState:
        seen.append(state.opening)
        return state._replace(opening=seen[0])

    return Injection(reading=reading)
