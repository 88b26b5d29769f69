"""Real time: the clock of a loop that goes no faster than the clock on the wall, on an absolute schedule."""

from __future__ import annotations

import time
from collections.abc import Callable

LATE = 0.002
"""What counts as a late tick [s]."""


class RealTime:
    """Waits for the time of each tick; the ticks are a period apart from the first `wait` on.

    A tick that is late by less than a period does not move the next, so that no cycle is lost. What a loop has fallen
    behind by more than that is dropped and counted: commands that are caught up on come faster than an arm may move.

    Args:
        clock: returns the time [s]; never goes back.
        sleep: waits for a time [s].

    Attributes:
        late: how late the newest tick began [s].
        late_ticks: how many began more than `LATE` after their time.
        lost: by how much the schedule was put off altogether [s].
    """

    def __init__(
        self, clock: Callable[[], float] = time.perf_counter, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._clock, self._sleep = clock, sleep
        self._next: float | None = None
        self.late, self.late_ticks, self.lost = 0.0, 0, 0.0

    def begin_again(self) -> None:
        """Let the schedule begin at the next `wait`: the time until then is not lost."""
        self._next = None

    def wait(self, period: float) -> float:
        """Wait for the next tick's time, ``period`` [s] after the last, and return what the clock shows then [s]."""
        now = self._clock()
        if self._next is None:
            self._next = now
        while (ahead := self._next - now) > 0.0:
            self._sleep(ahead)
            now = self._clock()
        self.late = now - self._next
        self.late_ticks += self.late > LATE
        if self.late > period:
            self.lost += self.late
            self._next = now
        self._next += period
        return now
