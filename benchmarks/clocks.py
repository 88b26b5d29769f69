"""Clocks that disagree: how far the tool is from a moving hand with every kind of stamp, loop and network.

    python -m benchmarks.clocks [--seconds 20]

The hand moves +-100 mm at 2 rad/s, sampled at 100 Hz; the loop runs at 500 Hz on a simulated clock. The error is the
distance between the tool at the end of a tick and the hand at that moment, after the first second: a tool that is led
28 ms behind, as is the default, is off by 5.6 mm at most.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from optsc.control.servo import Servo
from optsc.control.status import Status
from optsc.geometry import Pose
from optsc.robot import load_robot

PERIOD, SAMPLE = 0.002, 0.01
AMPLITUDE, OMEGA = 0.1, 2.0

Ticks = Callable[[np.random.Generator, float], Iterator[float]]
Stamps = Callable[[np.random.Generator, np.ndarray], np.ndarray]


class Packet(NamedTuple):
    """A sample under way: when it arrives, when the hand was there (both true times [s]), and its stamp."""

    arrival: float
    true: float
    stamp: float


class Row(NamedTuple):
    """One kind of clock: the loop's ticks, the samples, and whether the loop says what time it is."""

    name: str
    ticks: Ticks
    packets: Callable[[np.random.Generator, float], list[Packet]]
    now: Callable[[float], float] | None = None


def slow(factor: float) -> Ticks:
    """Return a loop whose period is ``factor`` times what it should be."""
    return lambda rng, end: iter(np.arange(0.0, end, PERIOD * factor))


def missing(share: float) -> Ticks:
    """Return a loop that misses a share of its ticks."""
    return lambda rng, end: iter([t for t in np.arange(0.0, end, PERIOD) if rng.random() >= share])


def jittery(rng: np.random.Generator, end: float) -> Iterator[float]:
    """Return a loop whose ticks are late by up to 1.9 ms, exponentially distributed."""
    grid = np.arange(0.0, end, PERIOD)
    return iter(np.maximum.accumulate(grid + np.minimum(rng.exponential(0.0005, len(grid)), 0.0019)))


def samples(
    stamp: Stamps = lambda rng, t: t, delay: Callable[[np.random.Generator, np.ndarray], np.ndarray] | float = 0.0005
) -> Callable[[np.random.Generator, float], list[Packet]]:
    """Return packets sampled at 100 Hz, stamped by ``stamp`` of the true time, and under way for ``delay`` [s]."""

    def packets(rng: np.random.Generator, end: float) -> list[Packet]:
        true = np.arange(0.0, end, SAMPLE)
        way = delay(rng, true) if callable(delay) else np.full(len(true), delay)
        rows = zip((true + way).tolist(), true.tolist(), stamp(rng, true).tolist(), strict=True)
        return sorted((Packet(*row) for row in rows), key=lambda packet: packet.arrival)

    return packets


def twice(packets: list[Packet]) -> list[Packet]:
    """Return every packet and its duplicate 4 ms later."""
    return sorted([*packets, *(p._replace(arrival=p.arrival + 0.004) for p in packets)], key=lambda p: p.arrival)


def outliers(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Return stamps of which one in fifty is wrong: by a minute, by 80 ms, by a number that is no time."""
    wrong = rng.random(len(t)) < 0.02
    return np.where(wrong, rng.choice([1e300, 60.0, -60.0, 0.08, np.nan], len(t)) + t, t)


def restart(offset: float, at: float = 3.0) -> Stamps:
    """Return stamps of a device whose clock jumps by ``offset`` [s] at a time."""
    return lambda rng, t: np.where(t < at, t, t + offset)


def swapped(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Return delays with which every tenth packet is 10 ms late, after the one behind it."""
    return np.where(np.arange(len(t)) % 10 == 5, 0.0115, 0.0005)


def rows() -> list[Row]:
    """Return all rows."""
    punctual, wall = slow(1.0), samples()
    table = [Row("all in order", punctual, wall)]
    for percent in (0.1, 1, 10, 30):
        table.append(Row(f"loop slower by {percent} %", slow(1.0 + percent / 100), wall))
    table.append(Row("loop faster by 5 %", slow(1.0 / 1.05), wall))
    table += [Row(f"{percent} % of ticks missed", missing(percent / 100), wall) for percent in (1, 5, 20)]
    table.append(Row("jittery loop", jittery, wall))
    for name, offset in (("1 s ahead", 1.0), ("10 s ahead", 10.0), ("10 s behind", -10.0), ("unix epoch", 1.7e9)):
        table.append(Row(f"stamps {name}", punctual, samples(lambda rng, t, offset=offset: t + offset)))
    for drift in (1e-4, -1e-4, 1e-2, -1e-2):
        table.append(
            Row(f"stamps drift {drift:+g}", punctual, samples(lambda rng, t, drift=drift: t * (1 + drift) + 3))
        )
    table += [
        Row("device restarts at 0", punctual, samples(restart(-5.0))),
        Row("device restarts 50 s ahead", punctual, samples(restart(50.0))),
        Row("outliers", punctual, samples(outliers)),
        Row("out of order by 10 ms", punctual, samples(delay=swapped)),
        Row("duplicates", punctual, lambda rng, end: twice(samples()(rng, end))),
        Row(
            "network jitter 5 ms",
            punctual,
            samples(lambda rng, t: t + 7, lambda rng, t: rng.exponential(0.005, len(t))),
        ),
    ]
    said = [row._replace(name=f"{row.name}, with now", now=lambda t: t + 100.0) for row in table]
    return table + said


class Outcome(NamedTuple):
    """Largest error [mm], share of ticks with status FOLLOWING or LATE, largest share of a joint's jerk limit (rms)."""

    error: float
    following: float
    late: float
    jerk: float


def play(row: Row, seconds: float, seed: int = 0) -> Outcome:
    """Run a servo against the row."""
    rng = np.random.default_rng(seed)
    servo = Servo(load_robot("panda"))
    home = servo.X_WT
    packets, next_packet = row.packets(rng, seconds), 0
    errors, statuses, accelerations = [], [], []
    for t in row.ticks(rng, seconds):
        arrived = []
        while next_packet < len(packets) and packets[next_packet].arrival <= t:
            arrived.append(packets[next_packet])
            next_packet += 1
        options = {} if row.now is None else {"now": row.now(t)}
        if arrived:
            packet = arrived[-1]
            step = [0.0, AMPLITUDE * np.sin(OMEGA * packet.true), 0.0]
            command = servo.step(Pose(home.quaternion, home.translation + step), stamp=packet.stamp, **options)
        else:
            command = servo.step(**options)
        if t > 1.0:
            hand = home.translation + [0.0, AMPLITUDE * np.sin(OMEGA * (t + PERIOD)), 0.0]
            errors.append(float(np.linalg.norm(servo.X_WT.translation - hand)))
            statuses.append(command.status.name)
            accelerations.append(command.a)
    jerk = np.diff(accelerations, axis=0) / PERIOD / servo.robot.limits.jerk
    count = len(statuses)
    return Outcome(
        1e3 * max(errors),
        statuses.count(Status.FOLLOWING.name) / count,
        statuses.count("LATE") / count,
        float(np.sqrt((jerk**2).mean(axis=0)).max()),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args().seconds
    print(f"{'':42s} error mm  following  late  rms jerk of limit")
    for row in rows():
        error, following, late, jerk = play(row, seconds)
        print(f"{row.name:42s} {error:8.1f} {100 * following:8.1f} % {100 * late:4.0f} % {100 * jerk:8.1f} %")


if __name__ == "__main__":
    main()
