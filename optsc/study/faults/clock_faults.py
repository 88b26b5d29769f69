"""Faults of clocks: of the device that stamps the samples, and of the loop that says what time it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from optsc.operators import OperatorSample
from optsc.study.faults.fault import (
    FROM_THEN_ON,
    ONCE,
    Expected,
    Fault,
    Inject,
    Injection,
    everywhere,
    goes_on_everywhere,
    holds,
    is_safe,
    stays_in_hold,
    stops,
)

Stamp = Callable[[float, float], Any]
"""``stamp(elapsed, true)``: what a device says that the time is [s]."""
NOTHING_USABLE = Expected(stays_in_hold(), stops(), holds())
"""Where no sample can be used: hold is not left, the arm comes to rest, and what the robot does by itself ends."""


COUPLED_AGAIN = goes_on_everywhere(3e-3, 0.03)
"""Until a clock so far off is learnt, samples may be late for a moment; after that the hand is coupled again."""


def stamped(make: Callable[[np.random.Generator], Stamp]) -> Inject:
    """Return a fault of the device's clock."""

    def inject(_: Any, rng: np.random.Generator) -> Injection:
        stamp = make(rng)
        return Injection(sample=lambda elapsed, s: s._replace(stamp=stamp(elapsed, s.stamp)))

    return inject


def said(make: Callable[[np.random.Generator], Stamp]) -> Inject:
    """Return a fault of the time that the loop says."""

    def inject(_: Any, rng: np.random.Generator) -> Injection:
        return Injection(now=make(rng))

    return inject


def lasting(make: Callable[[np.random.Generator], Callable[[float], float]]) -> Inject:
    """Return a fault of how long the ticks of a loop truly take, in periods."""

    def inject(_: Any, rng: np.random.Generator) -> Injection:
        return Injection(duration=make(rng))

    return inject


def _ahead(low: float, high: float) -> Inject:
    def make(rng: np.random.Generator) -> Stamp:
        offset = float(rng.uniform(low, high))
        return lambda _, true: true + offset

    return stamped(make)


def _drift(rate: float) -> Inject:
    return stamped(lambda _: lambda elapsed, true: true + rate * elapsed)


def _constant(value: Any) -> Inject:
    return stamped(lambda _: lambda *__: value)


def _swapped(rng: np.random.Generator) -> Stamp:
    """Stamps of which every fourth or so belongs before the one before."""
    return lambda _, true: true - (0.01 if rng.random() < 0.25 else 0.0)


def _standing(_: np.random.Generator) -> Stamp:
    seen: list[float] = []

    def stamp(_: float, true: float) -> float:
        seen.append(true)
        return seen[0]

    return stamp


def _backwards(_: np.random.Generator) -> Stamp:
    return lambda elapsed, true: true - 2.0 * elapsed


def _restarted(_: np.random.Generator) -> Stamp:
    return lambda elapsed, __: elapsed


def _jittered(rng: np.random.Generator) -> Stamp:
    return lambda _, true: true + float(rng.normal(0.0, 0.004))


def _twice(_: Any, __: np.random.Generator) -> Injection:
    """Every other packet is the one before."""
    last: list[OperatorSample] = []

    def sample(_: float, made: OperatorSample) -> OperatorSample:
        if last:
            return last.pop()
        last.append(made)
        return made

    return Injection(sample=sample)


def _late(delay: float) -> Inject:
    """Packets that are ``delay`` [s] on their way; the last one that has arrived is read."""

    def inject(_: Any, __: np.random.Generator) -> Injection:
        underway: list[OperatorSample] = []

        def sample(_: float, made: OperatorSample) -> OperatorSample | None:
            underway.append(made)
            arrived = [one for one in underway if one.stamp <= made.stamp - delay]
            if not arrived:
                return None
            del underway[: len(arrived)]
            return arrived[-1]

        return Injection(sample=sample)

    return inject


DEVICE: tuple[tuple[str, float, Inject, Expected, bool], ...] = (
    ("device clock 1 % fast", FROM_THEN_ON, _drift(0.01), goes_on_everywhere(), True),
    ("device clock 1 % slow", FROM_THEN_ON, _drift(-0.01), goes_on_everywhere(), True),
    ("device clock 10 % fast", FROM_THEN_ON, _drift(0.1), COUPLED_AGAIN, True),
    ("device clock 10 % slow", FROM_THEN_ON, _drift(-0.1), COUPLED_AGAIN, True),
    ("device clock steps ahead by 1 s", FROM_THEN_ON, _ahead(0.9, 1.1), goes_on_everywhere(), True),
    ("device clock steps ahead by 10 s", FROM_THEN_ON, _ahead(9.0, 11.0), goes_on_everywhere(), True),
    ("device clock steps back by 30 ms", FROM_THEN_ON, _ahead(-0.04, -0.02), goes_on_everywhere(), True),
    # A clock that has gone back looks like late packets until it is clear that it has begun again.
    ("device clock steps back by 5 s", FROM_THEN_ON, _ahead(-6.0, -4.0), everywhere(is_safe()), True),
    ("device clock restarts", FROM_THEN_ON, stamped(_restarted), everywhere(is_safe()), True),
    ("unix epoch", FROM_THEN_ON, _ahead(1.7e9, 1.8e9), goes_on_everywhere(), True),
    ("stamps in milliseconds", FROM_THEN_ON, stamped(lambda _: lambda __, t: 1e3 * t), everywhere(is_safe()), False),
    ("one stamp 60 s ahead", ONCE, _ahead(50.0, 70.0), goes_on_everywhere(), False),
    ("one stamp of 1e300", ONCE, _constant(1e300), goes_on_everywhere(), False),
    ("one stamp of -1e300", ONCE, _constant(-1e300), goes_on_everywhere(), False),
    ("one stamp that is no number", ONCE, _constant(float("nan")), goes_on_everywhere(), False),
    ("one infinite stamp", ONCE, _constant(float("inf")), goes_on_everywhere(), False),
    ("one stamp a rounding error older", ONCE, _ahead(-1e-9, -1e-12), goes_on_everywhere(), False),
    ("one packet 50 ms late", ONCE, _ahead(-0.06, -0.04), goes_on_everywhere(), False),
    ("stamps that are no numbers", FROM_THEN_ON, _constant(float("nan")), NOTHING_USABLE, False),
    ("stamps of 1e300", FROM_THEN_ON, _constant(1e300), NOTHING_USABLE, False),
    ("stamps that stand still", FROM_THEN_ON, stamped(_standing), everywhere(is_safe()), False),
    ("stamps that run backwards", FROM_THEN_ON, stamped(_backwards), everywhere(is_safe()), False),
    ("packets swapped by 10 ms", FROM_THEN_ON, stamped(_swapped), goes_on_everywhere(moving=0.03), False),
    ("stamps with 4 ms of jitter", FROM_THEN_ON, stamped(_jittered), goes_on_everywhere(2e-3, 0.03), False),
    ("packets that come twice", FROM_THEN_ON, _twice, goes_on_everywhere(moving=0.03), False),
    ("packets 30 ms late", FROM_THEN_ON, _late(0.03), goes_on_everywhere(moving=0.03), False),
)


def _missed(share: float) -> Inject:
    return lasting(lambda rng: lambda _: 1.0 + float(rng.geometric(1.0 - share) - 1))


def _stalled(seconds: float) -> Inject:
    """The loop stands still once, a while after the fault has begun."""

    def inject(world: Any, _: np.random.Generator) -> Injection:
        done: list[bool] = []

        def duration(elapsed: float) -> float:
            if elapsed < 0.2 or done:
                return 1.0
            done.append(True)
            return seconds / world.period

        return Injection(duration=duration)

    return inject


LOOP: tuple[tuple[str, float, Inject, Expected], ...] = (
    ("loop 1 % slow", FROM_THEN_ON, lasting(lambda _: lambda __: 1.01), goes_on_everywhere()),
    ("loop 10 % slow", FROM_THEN_ON, lasting(lambda _: lambda __: 1.1), goes_on_everywhere(moving=0.03)),
    ("loop 5 % fast", FROM_THEN_ON, lasting(lambda _: lambda __: 0.95), goes_on_everywhere(moving=0.03)),
    ("1 % of ticks missed", FROM_THEN_ON, _missed(0.01), goes_on_everywhere(moving=0.03)),
    ("5 % of ticks missed", FROM_THEN_ON, _missed(0.05), goes_on_everywhere(moving=0.03)),
    ("20 % of ticks missed", FROM_THEN_ON, _missed(0.2), goes_on_everywhere(moving=0.03)),
    (
        "ticks of uneven length",
        FROM_THEN_ON,
        lasting(lambda rng: lambda _: float(rng.uniform(0.5, 1.5))),
        goes_on_everywhere(moving=0.03),
    ),
    ("loop stalls for 50 ms", FROM_THEN_ON, _stalled(0.05), goes_on_everywhere(moving=0.03)),
    ("loop stalls for 0.6 s", FROM_THEN_ON, _stalled(0.6), everywhere(is_safe())),
    ("loop says no number once", ONCE, said(lambda _: lambda *__: float("nan")), goes_on_everywhere()),
    ("loop says 1e300 once", ONCE, said(lambda _: lambda *__: 1e300), goes_on_everywhere(moving=0.03)),
    ("loop says a time 1 s ago once", ONCE, said(lambda _: lambda __, t: t - 1.0), goes_on_everywhere(moving=0.03)),
    ("loop says a time in 1 s once", ONCE, said(lambda _: lambda __, t: t + 1.0), everywhere(is_safe())),
    ("loop says a word once", ONCE, said(lambda _: lambda *__: "noon"), goes_on_everywhere()),
    ("loop says a list once", ONCE, said(lambda _: lambda *__: [1.0, 2.0]), goes_on_everywhere()),
    ("loop says no number", FROM_THEN_ON, said(lambda _: lambda *__: float("nan")), everywhere(is_safe())),
    ("time stands still", FROM_THEN_ON, said(_standing), everywhere(is_safe())),
    ("time runs backwards", FROM_THEN_ON, said(_backwards), everywhere(is_safe())),
)


def faults() -> Iterator[Fault]:
    """Yield them all."""
    for name, lasts, inject, expected, permanent in DEVICE:
        stops_first = _may_stop(expected)
        yield Fault(name, "clock", lasts, inject, expected, permanent, recouples=stops_first, patient=stops_first)
    for name, lasts, inject, expected in LOOP:
        permanent = lasts > 0.0 and "slow" in name
        yield Fault(
            name, "loop", lasts, inject, expected, permanent, timed=True, recouples=_may_stop(expected), patient=True
        )


def _may_stop(expected: Expected) -> bool:
    """Tell whether the arm may stop meanwhile, after which the hand is coupled again where it is."""
    return expected.manual.name != "goes on" or expected is COUPLED_AGAIN
