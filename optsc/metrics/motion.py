"""The arrays that measures are taken from, cut out of a run or put together from its parts, and their checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.operators import fault_of
from optsc.operators.clock import ClockMapping

if TYPE_CHECKING:
    from optsc.records import Run
    from optsc.robot import RobotModel

Measures: TypeAlias = dict[str, float]
"""Several measures at once, as flat tables want them: a name with its unit, and a number."""


def finite_rows(field: str, value: ArrayLike, columns: int | None = None) -> Array:
    """Return ``value`` as an array (N, d), or (N, ``columns``); raise `InvalidValue` unless it is finite."""
    array = np.asarray(value, dtype=float)
    if array.ndim != 2 or (columns is not None and array.shape[1] != columns):
        raise InvalidValue(field, array.shape, f"shape (N, {columns or 'd'})")
    good = np.all(np.isfinite(array), axis=1)
    if not np.all(good):
        row = int(np.argmin(good))
        raise InvalidValue(f"{field}, row {row}", array[row].tolist(), "finite")
    return array


def finite_profile(field: str, value: ArrayLike) -> Array:
    """Return ``value`` (N,) or (N, d) as an array (N, d); raise `InvalidValue` unless it is finite."""
    array = np.asarray(value, dtype=float)
    return finite_rows(field, array[:, None] if array.ndim == 1 else array)


@dataclass(frozen=True, eq=False)
class HandMotion:
    """What the operator's hand did: stamps (S,) [s] since the start, positions (S, 3) [m] in the station frame S.

    Stamps count ticks, as motions do: where the loop was late, time stood still.
    """

    stamp: Array
    p: Array

    @classmethod
    def none(cls) -> HandMotion:
        """Return a hand of which nothing is known."""
        return cls(np.zeros(0), np.zeros((0, 3)))

    @classmethod
    def of_run(cls, run: Run) -> HandMotion:
        """Return the usable samples of ``run``, whatever clock they are stamped by."""
        clock, stamps, places = ClockMapping(), list[float](), list[Array]()
        for index, tick in enumerate(run.ticks):
            sample = tick.sample
            if sample is None or fault_of(sample) or sample.lost:
                continue
            clock, at, _ = clock.read(sample.stamp, tick.time, None if tick.now is None else tick.now - tick.time)
            if at is not None:
                stamps.append(at if tick.now is None else index / run.rate - (tick.time - at))
                places.append(sample.X_SH.translation)
        return cls(np.array(stamps), np.array(places).reshape(-1, 3))

    def between(self, start: float, end: float) -> HandMotion:
        """Return the samples from ``start`` up to, but without, ``end`` [s]."""
        kept = (self.stamp >= start) & (self.stamp < end)
        return HandMotion(self.stamp[kept], self.p[kept])


@dataclass(frozen=True, eq=False)
class Motion:
    """Commands of N ticks at ``rate`` [Hz].

    Attributes:
        rate: of the ticks [Hz].
        time: of the first tick [s], on the clock of the hand's stamps.
        modes: control mode of each tick, by name (N,).
        q, v, a: joint positions, velocities, accelerations (N, n) [rad, rad/s, rad/s^2].
        X_WT: commanded tool poses (N,).
        hand: the operator's samples in that time.
    """

    rate: float
    time: float
    modes: tuple[str, ...]
    q: Array
    v: Array
    a: Array
    X_WT: Pose
    hand: HandMotion

    def __post_init__(self) -> None:
        if not len(self.modes) == len(self.q) == len(self.v) == len(self.a) == len(self.X_WT):
            sizes = [len(x) for x in (self.modes, self.q, self.v, self.a, self.X_WT)]
            raise InvalidValue("lengths of modes, q, v, a and X_WT", sizes, "equal")

    def __len__(self) -> int:
        return len(self.modes)

    @classmethod
    def of_run(cls, run: Run, robot: RobotModel) -> Motion:
        """Return the whole of ``run``, which ``robot`` made."""
        modes = [mode.value for mode in run.modes]
        return cls.of_commands(robot, run.rate, modes, (run.q, run.v, run.a), HandMotion.of_run(run))

    @classmethod
    def of_commands(
        cls,
        robot: RobotModel,
        rate: float,
        modes: Sequence[str],
        commands: tuple[Array, Array, Array],
        hand: HandMotion,
    ) -> Motion:
        """Return the motion of joint commands (q, v, a), each (N, n), from time 0 on."""
        q, v, a = commands
        return cls(rate, 0.0, tuple(modes), q, v, a, robot.forward(q), hand)

    def part(self, start: int, end: int) -> Motion:
        """Return ticks ``start`` up to, but without, ``end``."""
        keep = slice(start, end)
        begin = self.time + start / self.rate
        hand = self.hand.between(begin, self.time + end / self.rate)
        X_WT = Pose(self.X_WT.quaternion[keep], self.X_WT.translation[keep])
        return replace(
            self,
            time=begin,
            modes=self.modes[keep],
            q=self.q[keep],
            v=self.v[keep],
            a=self.a[keep],
            X_WT=X_WT,
            hand=hand,
        )
