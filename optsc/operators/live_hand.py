"""A live hand: samples stamped on the computer's clock, brought to the clock of the run."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import isfinite

from optsc.operators.sample import Operator, OperatorSample, OperatorView


class LiveHand:
    """An `Operator` whose samples were stamped on the computer's clock, as a device's thread does it.

    The clock of a run begins at 0; a sample gets the time on it that is as long ago as its stamp is on
    the computer's. Stamps never go back, whatever the two clocks do.

    Args:
        source: of the samples, such as `optsc.operators.Mailbox`.
        clock: that the samples are stamped on [s].
    """

    def __init__(self, source: Operator, clock: Callable[[], float] = time.perf_counter) -> None:
        self.source, self._clock = source, clock
        self._last = -float("inf")

    def read(self, view: OperatorView) -> OperatorSample | None:
        """Return the newest sample on the run's clock; None when there is none since the last call."""
        sample = self.source.read(view)
        if sample is None:
            return None
        age = self._clock() - sample.stamp
        if not isfinite(age):
            return sample  # to be refused where samples are
        self._last = max(self._last, view.time - max(age, 0.0))
        return sample._replace(stamp=self._last)
