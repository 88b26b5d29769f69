"""Time of the control loop: counted in ticks, or as the loop says; how late ticks come, and how much was lost."""

from __future__ import annotations

from math import exp, isfinite
from typing import NamedTuple

from optsc.operators.clock import number

LATE = 0.02
"""Time lost within about the last second [s] from which on the loop counts as late: one stall of 20 ms, or a loop that
is 2 % too slow. A target that moves at 0.5 m/s is then a centimetre further on."""
FADING = 1.0
"""Time constant [s] with which lost time counts less and less."""
LEAST_STEP = 1e-6
"""A clock that goes on by less than this [s] from tick to tick stands still."""
LONGEST_STALL = 0.5
"""A time that is further ahead than this [s] is believed only where the next ones go on from it."""
CONFIRMED = 2
"""How many times have to go on from each other, as those of a clock do, before one that was set is believed."""


class LoopTime(NamedTuple):
    """When the next tick begins, or the one that is being done.

    A loop that says nothing is taken to be punctual, and its time is counted in ticks. One that says what time it is
    (``now``) is believed: the command still moves by one period a tick, and the target is where the hand is by then.

    Attributes:
        at: the last time that the loop has said, since the reset [s]; zero before.
        tick: the tick at which that was.
        zero: what the loop's clock read at time zero [s]; None before the loop has said a time.
        late: by how much this tick comes later than one period after the one before [s].
        missing: by how much the ticks so far have moved the command less than time has passed [s]; negative for a loop
            that is fast.
        recent: time lost within about the last second [s]; what is made up for in that time is not lost.
        refused: how often the loop has said a time that cannot be: not finite, no later than at the tick before, or far
            ahead.
        claim, claims: the last of them, on the loop's clock [s], and how many have gone on from each other.
    """

    at: float = 0.0
    tick: int = 0
    zero: float | None = None
    late: float = 0.0
    missing: float = 0.0
    recent: float = 0.0
    refused: int = 0
    claim: float = 0.0
    claims: int = 0

    def time(self, ticks: int, period: float) -> float:
        """Return the time since the reset [s] after ``ticks``."""
        return self.at + (ticks - self.tick) * period

    def begun(self, ticks: int, period: float, now: float | None) -> LoopTime:
        """Return it as the tick after ``ticks`` begins and the loop says that it is ``now`` [s], if it says anything.

        The origin of the clock is learnt at the first time that is said. A time that cannot be is refused: one period
        is counted instead. Of a clock that was set, or a loop that stood still for long, the next times go on from
        there, and are then believed. After a single wrong one, and a clock that stood still, they go on from before.
        """
        if now is None:
            return self if self.late == 0.0 else self._replace(late=0.0)
        expected = self.time(ticks, period)
        said = number(now)
        if not isfinite(said):
            return self._replace(late=0.0, refused=self.refused + 1)
        if self.zero is None:
            return self._replace(at=expected, tick=ticks, zero=said - expected)
        at, last = said - self.zero, expected - period if ticks > self.tick else self.at
        if not last + LEAST_STEP <= at <= expected + LONGEST_STALL:
            goes_on = self.claims > 0 and LEAST_STEP <= said - self.claim <= LONGEST_STALL
            claims = self.claims + 1 if goes_on else 1
            if claims < CONFIRMED:
                return self._replace(late=0.0, refused=self.refused + 1, claim=said, claims=claims)
            if at < expected:
                zero = said - expected
                return LoopTime(expected, ticks, zero, 0.0, self.missing, self.recent, self.refused)
        off = at - expected
        recent = self.recent * exp(-(at - last) / FADING) + off
        return LoopTime(at, ticks, self.zero, max(off, 0.0), self.missing + off, max(recent, 0.0), self.refused)

    @property
    def lateness(self) -> str:
        """In what way the loop is late, in words; empty where it is not."""
        return f"the loop is late: {1e3 * self.recent:.0f} ms within about a second" if self.recent >= LATE else ""
