"""A recorded arm, played back in place of one: it is where it was then, whatever it is commanded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import TracebackType

from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.followers.protocol import FollowerState
from optsc.geometry import Pose


class RecordedFollower:
    """A `Follower` that reports recorded states, one a period; after the last it stays there.

    Raises `InvalidValue` without a state.
    """

    def __init__(self, states: Sequence[FollowerState]) -> None:
        if not states:
            raise InvalidValue("recorded states", (), "at least one")
        self._states, self._index = tuple(states), 0

    def state(self) -> FollowerState:
        """Return the recorded state of this period."""
        return self._states[min(self._index, len(self._states) - 1)]

    def reset(self, q: ArrayLike) -> FollowerState:
        """Go back to the first state, whatever ``q`` is."""
        self._index = 0
        return self.state()

    def at(self, state: FollowerState) -> RecordedFollower:
        """Raise `InvalidValue`: what was recorded cannot be put elsewhere."""
        raise InvalidValue("state of a recorded follower", state.time, "one that was recorded")

    def apply(self, q: ArrayLike, v: ArrayLike, opening: float, period: float) -> FollowerState:
        """Go on to the next state, whatever the command is."""
        self._index += 1
        return self.state()

    def objects(self) -> Mapping[str, Pose]:
        """Return no objects: they are not recorded."""
        return {}

    def close(self) -> None:
        """Do nothing."""

    def __enter__(self) -> RecordedFollower:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
