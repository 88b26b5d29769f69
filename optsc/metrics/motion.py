"""The arrays that measures are taken from: one motion, cut out of a run or put together from its parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose
from optsc.geometry.rotation import Array

if TYPE_CHECKING:
    from optsc.records import Run
    from optsc.robot import RobotModel


@dataclass(frozen=True, eq=False)
class Hand:
    """What the operator's hand did: stamps (S,) [s] since the start, positions (S, 3) [m] in the station frame S."""

    stamp: Array
    p: Array

    @classmethod
    def none(cls) -> Hand:
        """Return a hand of which nothing is known."""
        return cls(np.zeros(0), np.zeros((0, 3)))

    def between(self, start: float, end: float) -> Hand:
        """Return the samples from ``start`` up to, but without, ``end`` [s]."""
        kept = (self.stamp >= start) & (self.stamp < end)
        return Hand(self.stamp[kept], self.p[kept])


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
    hand: Hand

    def __post_init__(self) -> None:
        if not len(self.modes) == len(self.q) == len(self.v) == len(self.a) == len(self.X_WT):
            sizes = [len(x) for x in (self.modes, self.q, self.v, self.a, self.X_WT)]
            raise InvalidValue("lengths of modes, q, v, a and X_WT", sizes, "equal")

    def __len__(self) -> int:
        return len(self.modes)

    @classmethod
    def of_run(cls, run: Run, robot: RobotModel) -> Motion:
        """Return the whole of ``run``, which ``robot`` made."""
        samples = [tick.sample for tick in run.ticks if tick.sample is not None]
        hand = Hand(
            np.array([sample.stamp for sample in samples]),
            np.array([sample.X_SH.translation for sample in samples]).reshape(-1, 3),
        )
        modes = [mode.value for mode in run.modes]
        return cls.of_commands(robot, run.rate, modes, (run.q, run.v, run.a), hand)

    @classmethod
    def of_commands(
        cls,
        robot: RobotModel,
        rate: float,
        modes: Sequence[str],
        commands: tuple[Array, Array, Array],
        hand: Hand,
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
