"""Ring of rows: every tick from the control process to the recorder, without either waiting for the other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optsc.geometry.rotation import Array
from optsc.live.shared_block import SharedSegment


class Drained(NamedTuple):
    """What was read from a ring: rows (R, size) in their order, and how many before them were overwritten unread."""

    rows: Array
    lost: int


class RowRing:
    """The last ``capacity`` rows of doubles from one writer to one reader.

    The writer never waits: a reader that is slower than a whole turn loses the oldest rows, and is told how many. A
    ring outlives its writer, so the rows of a process that died can still be read; and its reader, so that another one
    goes on where that one last said that all is `kept`.

    Args:
        segment: where it lies.
        size: of a row.
        capacity: how many rows there are.
    """

    def __init__(self, segment: SharedSegment, size: int, capacity: int) -> None:
        block = segment.take(self.doubles(size, capacity))
        self._count, self._kept, self._rows = block[:1], block[1:2], block[2:].reshape(capacity, size)
        self._capacity, self._read = capacity, int(self._kept[0])

    @staticmethod
    def doubles(size: int, capacity: int) -> int:
        """Return how many doubles a ring takes in its segment."""
        return 2 + size * capacity

    @property
    def written(self) -> int:
        """How many rows were written so far."""
        return int(self._count[0])

    def push(self, row: Array) -> None:
        """Append a row (size,)."""
        count = int(self._count[0])
        self._rows[count % self._capacity] = row
        self._count[0] = count + 1

    def drain(self) -> Drained:
        """Return what was written since the last call."""
        end = self.written
        start = max(self._read, end - self._capacity)
        rows = self._rows[np.arange(start, end) % self._capacity]
        # While they were copied the writer may have come round, and be writing one more just now.
        safe = min(max(start, self.written + 1 - self._capacity), end) if end > start else start
        lost, self._read = safe - self._read, end
        return Drained(rows[safe - start :], lost)

    def kept(self) -> None:
        """Say that what was drained is safe: a reader that takes the place of this one begins behind it."""
        self._kept[0] = self._read
