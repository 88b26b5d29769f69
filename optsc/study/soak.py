"""Soak test of the servo: hostile input over random arms, rates and starts, every command checked against the limits.

Each episode draws its arm, rate, settings, start and streams of targets from a random generator seeded by
the seed of the test and the number of the episode, so that each can be repeated alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from optsc.control.servo import Command, Servo, ServoSettings
from optsc.errors import InvalidValue, OptscError, UnknownName
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.metrics import limit_violations
from optsc.robot import ROBOT_NAMES, RobotModel, load_robot

EPISODE_TICKS = (200, 2000)
"""Fewest and most ticks of an episode."""
STREAM_TICKS = (20, 300)
"""Fewest and most ticks for which one kind of input lasts."""
RATES = (100.0, 1000.0)
"""Least and greatest control rate [Hz]."""
OUTSIDE = 0.3
"""How far beyond a position limit a start may be [rad]."""
FAULTS = (OptscError, ArithmeticError, LookupError, TypeError, ValueError, AttributeError, RuntimeError)
"""What counts as an exception of the servo; anything else ends the soak."""
KINDS = ("position", "velocity", "acceleration", "jerk", "continuity", "finite")
"""What is checked: the four limits, position as the trapezoidal sum of velocity, and finite numbers."""
TOLERANCE = 1e-9
"""What is taken for rounding, in the unit of each limit."""
NOWHERE = 1e300
"""A position limit [rad] for where there is none."""

Input = tuple[Pose | None, float | None]
Stream = Callable[[np.random.Generator, Servo, Pose], Iterator[Input]]


class SoakEpisode(NamedTuple):
    """What one episode was and did.

    Attributes:
        number: which one of the soak it was.
        about: arm, rate, settings, start and the streams, in words and numbers.
        ticks: how many were run.
        violations: per entry of `KINDS`, at how many ticks it was broken.
        exception: type and message, or None.
        statuses: how many ticks ended in each.
    """

    number: int
    about: dict[str, Any]
    ticks: int
    violations: dict[str, int]
    exception: str | None
    statuses: Counter[str]

    @property
    def failed(self) -> bool:
        """Whether it broke a limit or raised."""
        return self.exception is not None or any(self.violations.values())


@dataclass(eq=False)
class Soak:
    """What a soak has found so far."""

    seed: int
    ticks: int = 0
    episodes: int = 0
    violations: Counter[str] = field(default_factory=Counter)
    statuses: Counter[str] = field(default_factory=Counter)
    exceptions: int = 0
    failures: list[SoakEpisode] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """Whether nothing was broken and nothing was raised."""
        return self.exceptions == 0 and not any(self.violations.values())

    def add(self, episode: SoakEpisode) -> None:
        """Count one episode."""
        self.ticks += episode.ticks
        self.episodes += 1
        self.violations.update(episode.violations)
        self.statuses.update(episode.statuses)
        self.exceptions += episode.exception is not None
        if episode.failed:
            self.failures.append(episode)

    def summary(self) -> dict[str, Any]:
        """Return the counts, and how to repeat every failure, as plain values for a JSON file."""
        return {
            "seed": self.seed,
            "ticks": self.ticks,
            "episodes": self.episodes,
            "violations": {kind: self.violations[kind] for kind in KINDS},
            "exceptions": self.exceptions,
            "statuses": dict(self.statuses.most_common()),
            "passed": self.passed,
            "failures": [
                {"episode": e.number, **e.about, "violations": e.violations, "exception": e.exception}
                for e in self.failures
            ],
        }


def _moving(rng: np.random.Generator, servo: Servo, X: Pose) -> Iterator[Input]:
    """A smooth motion about where the tool is, sampled at 50 or 90 Hz."""
    size, speed, every = rng.uniform(0.0, 0.3, 3), rng.uniform(0.2, 8.0, 3), 1.0 / rng.choice([50.0, 90.0])
    due, start = servo.time, servo.time
    while True:
        if servo.time < due:
            yield None, None
            continue
        due += every
        wave = np.sin(speed * (servo.time - start))
        yield (
            Pose(rotation.multiply(rotation.exp(wave * size), X.quaternion), X.translation + size * wave),
            None,
        )


def _jumps(rng: np.random.Generator, servo: Servo, X: Pose) -> Iterator[Input]:
    while True:
        yield Pose(rotation.random(rng), X.translation + rng.normal(size=3)), None


def _not_a_number(rng: np.random.Generator, servo: Servo, X: Pose) -> Iterator[Input]:
    while True:
        bad = rng.choice([np.nan, np.inf, -np.inf])
        q, p = X.quaternion.copy(), X.translation.copy()
        (q if rng.random() < 0.5 else p)[rng.integers(3)] = bad
        yield (Pose(q, p), None) if rng.random() < 0.7 else (X, bad)


def _frozen(rng: np.random.Generator, servo: Servo, X: Pose) -> Iterator[Input]:
    stamp, X = servo.time, Pose(X.quaternion, X.translation + 0.1 * rng.normal(size=3))
    while True:
        yield X, stamp


def _backwards(rng: np.random.Generator, servo: Servo, X: Pose) -> Iterator[Input]:
    stamp = servo.time
    while True:
        stamp -= rng.uniform(-0.01, 0.03)
        yield Pose(X.quaternion, X.translation + 0.05 * rng.normal(size=3)), stamp


def _future(rng: np.random.Generator, servo: Servo, X: Pose) -> Iterator[Input]:
    while True:
        yield (
            Pose(X.quaternion, X.translation + 0.05 * rng.normal(size=3)),
            servo.time + rng.exponential(10.0),
        )


def _far(rng: np.random.Generator, servo: Servo, X: Pose) -> Iterator[Input]:
    away = rng.normal(size=3) * 10.0 ** rng.uniform(0.0, 6.0)
    while True:
        yield Pose(X.quaternion, X.translation + away), None


def _no_pose(rng: np.random.Generator, servo: Servo, X: Pose) -> Iterator[Input]:
    """Quaternions that are none, positions whose sum is harmless, and batches."""
    zero, tiny = np.zeros(4), np.full(4, 1e-200)
    while True:
        q = (zero, tiny, 1e150 * X.quaternion, rng.normal(size=4), X.quaternion)[rng.integers(5)]
        huge = 10.0 ** rng.uniform(9.0, 300.0)
        p = (X.translation, np.array([huge, -huge, 0.0]))[rng.integers(2)]
        yield (Pose(q, p) if rng.random() < 0.9 else Pose(np.tile(q, (2, 1)), np.tile(p, (2, 1)))), None


def _pressing(rng: np.random.Generator, servo: Servo, X: Pose) -> Iterator[Input]:
    """Poses that need a joint beyond its limit, approached at full speed and with a tremor."""
    robot = servo.robot
    lower, upper = robot.limits.sampling
    q = np.clip(robot.random_configuration(rng) + rng.normal(size=robot.n), lower - OUTSIDE, upper + OUTSIDE)
    goal = robot.forward(q)
    while True:
        yield Pose(goal.quaternion, goal.translation + 1e-3 * rng.normal(size=3)), None


def _silent(rng: np.random.Generator, servo: Servo, X: Pose) -> Iterator[Input]:
    while True:
        yield None, None


def _rarely(rng: np.random.Generator, servo: Servo, X: Pose) -> Iterator[Input]:
    while True:
        new = rng.random() < 0.03
        yield (Pose(X.quaternion, X.translation + 0.1 * rng.normal(size=3)) if new else None), None


STREAMS: dict[str, Stream] = {
    "moving": _moving,
    "jumps": _jumps,
    "not a number": _not_a_number,
    "frozen": _frozen,
    "clock backwards": _backwards,
    "clock ahead": _future,
    "far away": _far,
    "no pose": _no_pose,
    "beyond a joint limit": _pressing,
    "silent": _silent,
    "rarely": _rarely,
}
"""Kinds of input by name."""


class _Start(NamedTuple):
    """Configuration and velocity (n,) that an episode starts from, and whether that is inside the limits, at rest."""

    q: Array
    v: Array
    inside: bool


def _start(rng: np.random.Generator, robot: RobotModel) -> _Start:
    q, v, kind = robot.random_configuration(rng), np.zeros(robot.n), rng.random()
    lower, upper = robot.limits.sampling
    if kind < 0.2:
        q = q + rng.uniform(-1.0, 1.0, robot.n) * np.where(rng.random(robot.n) < 0.3, 0.5 * (upper - lower), 0)
        q = np.clip(q, lower - OUTSIDE, upper + OUTSIDE)
    elif kind < 0.4:
        # A moving start may be unable to stop in time, so its position limits are not checked.
        v = rng.uniform(-1.0, 1.0, robot.n) * robot.limits.velocity
    elif kind < 0.5:
        q = np.where(rng.random(robot.n) < 0.5, robot.limits.clip(np.sign(q) * 1e3), q)
        q = np.where(robot.limits.bounded, q, 0.0)
    inside = bool(np.all(robot.limits.clip(q) == q)) and not v.any()
    return _Start(q, v, inside)


def _settings(rng: np.random.Generator) -> ServoSettings:
    if rng.random() < 0.5:
        return ServoSettings()
    return ServoSettings(
        bandwidth=float(rng.uniform(5.0, 150.0)),
        lag=float(rng.uniform(0.0, 0.1)),
        timeout=float(rng.uniform(0.01, 1.0)),
    )


def _disturb(rng: np.random.Generator, servo: Servo) -> Command | None:
    """Now and then stop or drop the track, as a controller does that changes its mode."""
    what = rng.random()
    if what < 0.002:
        servo.forget()
    return servo.stop() if what > 0.998 else None


def _ticks(
    rng: np.random.Generator, servo: Servo, count: int, streams: Sequence[str], used: list[str]
) -> Iterator[Command]:
    while count > 0:
        name = str(rng.choice(list(streams)))
        used.append(name)
        length = min(count, int(rng.integers(*STREAM_TICKS)))
        stream = STREAMS[name](rng, servo, servo.X_WT)
        for _ in range(length):
            yield _disturb(rng, servo) or servo.step(*next(stream))
        count -= length


def _violations(servo: Servo, start: _Start, commands: Sequence[Command]) -> dict[str, int]:
    limits, period = servo.robot.limits, servo.period
    found = dict.fromkeys(KINDS, 0)
    q, v, a = (np.array([s, *(getattr(c, x) for c in commands)]) for x, s in _columns(start))
    found["finite"] = int(np.count_nonzero(~np.isfinite(np.hstack([q, v, a])).all(axis=1)))
    if found["finite"]:
        return found
    bounded = limits.bounded & start.inside
    used = limit_violations(
        servo.rate,
        q,
        v,
        a,
        lower=np.where(bounded, limits.lower, -NOWHERE),
        upper=np.where(bounded, limits.upper, NOWHERE),
        velocity=limits.velocity,
        acceleration=limits.acceleration,
        jerk=limits.jerk,
        tolerance=TOLERANCE,
    )
    gap = q[1:] - q[:-1] - 0.5 * period * (v[1:] + v[:-1])
    found["continuity"] = int(np.count_nonzero(np.any(np.abs(gap) > TOLERANCE, axis=1)))
    return {**found, **{kind: getattr(used, kind) for kind in KINDS[:4]}}


def _columns(start: _Start) -> tuple[tuple[str, Array], ...]:
    return ("q", start.q), ("v", start.v), ("a", np.zeros_like(start.q))


def run_episode(
    seed: int, number: int, robots: Sequence[str] = ROBOT_NAMES, streams: Sequence[str] = tuple(STREAMS)
) -> SoakEpisode:
    """Return what episode ``number`` of the soak ``seed`` does: a pure function of the arguments.

    Raises `UnknownName` for a robot or a stream that there is not.
    """
    for name in streams:
        if name not in STREAMS:
            raise UnknownName("stream", name, STREAMS)
    rng = np.random.default_rng([seed, number])
    robot = load_robot(str(rng.choice(list(robots))))
    rate = float(np.exp(rng.uniform(*np.log(RATES))))
    settings, start = _settings(rng), _start(rng, robot)
    count = int(rng.integers(*EPISODE_TICKS))
    servo = Servo(robot, rate, settings)
    servo.reset(start.q, start.v)
    commands: list[Command] = []
    used: list[str] = []
    exception = None
    try:
        commands.extend(_ticks(rng, servo, count, streams, used))
    except FAULTS as error:
        exception = f"{type(error).__name__}: {error}"
    about = {
        "robot": robot.name,
        "rate": rate,
        "settings": repr(settings),
        "started": "inside" if start.inside else "moving" if start.v.any() else "outside",
        "streams": used,
    }
    found = _violations(servo, start, commands)
    return SoakEpisode(number, about, len(commands), found, exception, Counter(c.status.name for c in commands))


def soak(
    ticks: int,
    *,
    seed: int = 0,
    robots: Sequence[str] = ROBOT_NAMES,
    streams: Sequence[str] = tuple(STREAMS),
    progress: Callable[[Soak], None] | None = None,
) -> Soak:
    """Return what at least ``ticks`` ticks of hostile input over ``robots`` found.

    Positions are checked where the episode started inside the limits and at rest; velocities, accelerations and
    jerks always.

    Args:
        ticks: how many to run at least; whole episodes are run.
        seed: of all episodes.
        robots: names to draw arms from.
        streams: names of `STREAMS` to draw input from.
        progress: called after every episode.

    Raises `InvalidValue` unless ``ticks`` is positive, ``seed`` not negative and there are robots and streams, and
    `UnknownName` for one that there is not.
    """
    if ticks <= 0:
        raise InvalidValue("ticks", ticks, "1 or more")
    if seed < 0:
        raise InvalidValue("seed", seed, "0 or more")
    for field_name, names in (("robots", robots), ("streams", streams)):
        if not names:
            raise InvalidValue(field_name, names, "at least one name")
    result = Soak(seed)
    while result.ticks < ticks:
        result.add(run_episode(seed, result.episodes, robots, streams))
        if progress is not None:
            progress(result)
    return result
