"""Shared block: the newest row of doubles, written by one process and read by any, without locks (a sequence lock).

The writer counts up once before it writes, which makes the count odd, and once after. A reader that meets an odd
count, or another after it has copied than before, was overtaken and copies again. Nobody ever waits for anybody: a
reader that dies in the middle disturbs nothing, and a writer that dies in the middle is noticed as an odd count.

The count is kept at both ends of the block, and read in the opposite order to that in which it is written. So it also
tells of a torn copy on processors that let another core see two writes in either order, but for a rearrangement within
the row itself (none on x86).
"""

from __future__ import annotations

from contextlib import suppress
from multiprocessing.shared_memory import SharedMemory
from types import TracebackType

import numpy as np

from optsc.errors import Closed, InvalidValue
from optsc.geometry.rotation import Array

_BYTES = 8
_TRIES = 50


class _Mapping(SharedMemory):
    """Shared memory that stays mapped as long as arrays in it are held somewhere."""

    def close(self) -> None:
        with suppress(BufferError):
            super().close()


class SharedSegment:
    """A piece of shared memory that is divided into blocks of doubles in the order in which they are taken.

    The process that makes it removes it on `close`; others attach to it by its name and only let go of it.

    Args:
        size: in doubles, where it is made.
        name: of a segment that is there already.

    Raises:
        InvalidValue: neither or both were given, or no segment has that name.
    """

    def __init__(self, size: int | None = None, name: str | None = None) -> None:
        if (size is None) == (name is None):
            raise InvalidValue("size and name", (size, name), "one of them")
        try:
            self._memory: _Mapping | None = _Mapping(name, create=name is None, size=_BYTES * (size or 0))
        except FileNotFoundError:
            raise InvalidValue("name of the shared memory", name, "that of a segment whose owner is running") from None
        self._owner, self._taken = name is None, 0
        self.name = self._memory.name

    def take(self, size: int) -> Array:
        """Return the next ``size`` doubles; raise `InvalidValue` where there are not so many left."""
        if self._memory is None:
            raise Closed("segment")
        start = self._taken
        if _BYTES * (start + size) > self._memory.size:
            raise InvalidValue("doubles in the segment", size, f"up to {self._memory.size // _BYTES - start}")
        self._taken += size
        return np.ndarray((size,), dtype=float, buffer=self._memory.buf, offset=_BYTES * start)

    def close(self) -> None:
        """Let go of the memory, and remove it where it was made here; closing again does nothing."""
        memory, self._memory = self._memory, None
        if memory is None:
            return
        memory.close()
        if self._owner:
            memory.unlink()

    def __enter__(self) -> SharedSegment:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class SharedBlock:
    """The newest row of doubles between one writer and any number of readers, see the module.

    Args:
        segment: where it lies.
        size: of a row.
    """

    def __init__(self, segment: SharedSegment, size: int) -> None:
        block = segment.take(size + 2)
        self._front, self._row, self._back = block[:1], block[1:-1], block[-1:]
        self.size = size

    @staticmethod
    def doubles(size: int) -> int:
        """Return how many doubles a block with rows of ``size`` takes in its segment."""
        return size + 2

    def write(self, row: Array) -> None:
        """Put a row (size,) in place of the one that is there; by one process only."""
        count = float(self._front[0])
        count += 1.0 if count % 2.0 == 0.0 else 2.0  # odd where another writer died in the middle
        self._front[0] = count
        self._row[:] = row
        self._back[0] = count + 1.0
        self._front[0] = count + 1.0

    @property
    def count(self) -> int:
        """How often a row was written; the same as at the last read means that nothing is new."""
        return int(self._front[0]) // 2

    def read(self, into: Array) -> bool:
        """Copy the newest row into an array (size,) and tell whether that went well.

        False where nothing was ever written, or where the writer was in the middle every time: it is far too fast for
        the reader, or it died there. What is in the array is then of no use.
        """
        for _ in range(_TRIES):
            back = self._back[0]
            into[:] = self._row
            if self._front[0] == back:
                return bool(back)
        return False
