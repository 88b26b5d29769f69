"""Absolute schedule of a control loop: each tick has its time, and a late one does not move the next."""

from __future__ import annotations

import time
from collections.abc import Callable

from optsc.checks import Positive, require

CATCH_UP_LIMIT = 0.1
"""A loop that has fallen behind by more than this [s] goes on from there: an arm that catches up would race."""
LATE = 0.002
"""What counts as a late tick [s]."""


class Schedule:
    """Times of ticks, a period apart from the first `wait` on.

    Args:
        period: [s].
        clock: returns the time [s].
        sleep: waits for a time [s].

    Attributes:
        late: how late the newest tick began [s].
        late_ticks: how many began more than `LATE` after their time.
        lost: by how much the schedule was put off altogether [s].

    Raises:
        InvalidValue: a period that is not positive.
    """

    def __init__(
        self,
        period: float,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        require("period", period, Positive)
        self.period, self._clock, self._sleep = period, clock, sleep
        self._next: float | None = None
        self.late, self.late_ticks, self.lost = 0.0, 0, 0.0

    def wait(self) -> float:
        """Wait for the next tick's time and return what the clock shows then [s]."""
        now = self._clock()
        if self._next is None:
            self._next = now
        while (ahead := self._next - now) > 0.0:
            self._sleep(ahead)
            now = self._clock()
        self.late = now - self._next
        self.late_ticks += self.late > LATE
        if self.late > CATCH_UP_LIMIT:
            self.lost += self.late
            self._next = now
        self._next += self.period
        return now
