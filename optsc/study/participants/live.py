"""What a person of flesh and blood needs: an arm at the pace of the clock on the wall, samples on the run's clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from math import isfinite
from types import TracebackType

from numpy.typing import ArrayLike

from optsc.followers import Follower, FollowerState
from optsc.geometry import Pose
from optsc.operators import Operator, OperatorSample, OperatorView

LARGEST_LAG = 0.1
"""A simulation that has fallen behind by more than this [s] goes on from there: an arm that catches up races."""


class PacedFollower:
    """A `Follower` that lets a simulated one go no faster than the clock.

    Args:
        follower: the simulated one; it is closed with this one.
        clock: tells the time [s].
        sleep: waits for a time [s].
    """

    def __init__(
        self,
        follower: Follower,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.follower, self._clock, self._sleep = follower, clock, sleep
        self._origin: float | None = None
        self.lost = 0.0
        """Time by which the run took longer than it should have, for want of speed [s]."""

    def state(self) -> FollowerState:
        """Return where the arm is now."""
        return self.follower.state()

    def reset(self, q: ArrayLike) -> FollowerState:
        """Put the arm at ``q``, see `Follower.reset`; the clock starts with the first command."""
        self._origin, self.lost = None, 0.0
        return self.follower.reset(q)

    def apply(self, q: ArrayLike, v: ArrayLike, opening: float, period: float) -> FollowerState:
        """Follow a command, and return when the clock has come to its end."""
        if self._origin is None:
            self._origin = self._clock() - self.follower.state().time
        state = self.follower.apply(q, v, opening, period)
        ahead = self._origin + state.time - self._clock()
        if ahead > 0.0:
            self._sleep(ahead)
        elif ahead < -LARGEST_LAG:
            self._origin -= ahead
            self.lost -= ahead
        return state

    def objects(self) -> Mapping[str, Pose]:
        """Return the true poses of the objects."""
        return self.follower.objects()

    def close(self) -> None:
        """Close the simulated one."""
        self.follower.close()

    def __enter__(self) -> PacedFollower:
        self.follower.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class LiveHand:
    """An `Operator` whose samples were stamped on the computer's clock, as a device's thread does it.

    A run has a clock of its own that begins at 0; a sample gets the time on it that is as long ago as its stamp is on
    the computer's. Stamps never go back, whatever the two clocks do.

    Args:
        source: hands in the samples, such as `optsc.operators.Mailbox`.
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
