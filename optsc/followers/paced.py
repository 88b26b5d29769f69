"""Real-time pacing: a simulated arm that goes no faster than the clock on the wall."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from types import TracebackType

from numpy.typing import ArrayLike

from optsc.followers.protocol import Follower, FollowerState
from optsc.geometry import Pose

CATCH_UP_LIMIT = 0.1
"""A simulation that has fallen behind by more than this [s] continues from there: an arm that catches up would race."""


class PacedFollower:
    """A `Follower` that lets a simulated one go no faster than the clock.

    Args:
        follower: the simulated one; it is closed with this one.
        clock: returns the time [s].
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

    def at(self, state: FollowerState) -> PacedFollower:
        """Put the arm where ``state`` says, see `Follower.at`; the clock starts with the next command."""
        self._origin = None
        self.follower.at(state)
        return self

    def apply(self, q: ArrayLike, v: ArrayLike, opening: float, period: float) -> FollowerState:
        """Follow a command, and return when its period is over."""
        if self._origin is None:
            self._origin = self._clock() - self.follower.state().time
        state = self.follower.apply(q, v, opening, period)
        ahead = self._origin + state.time - self._clock()
        if ahead > 0.0:
            self._sleep(ahead)
        elif ahead < -CATCH_UP_LIMIT:
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
