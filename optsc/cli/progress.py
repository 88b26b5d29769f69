"""Progress on the terminal: one line that changes, or a line every few seconds where the output is a file."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

EVERY = 10.0
"""Time between two lines where there is no terminal [s]."""


def shown_progress() -> Callable[[Any], None]:
    """Return what shows how far a run of jobs has come, on standard error."""
    show = _line()
    return lambda progress: show(str(progress), progress.rows >= progress.of)


def counted_progress() -> Callable[[str, int, int], None]:
    """Return what shows how many of an object's grasps are done, and how long the rest will take.

    It is called with the object's name, the steps done and the steps in all; time runs from the object before on, or
    from now. What is left is that of this object alone, at the pace so far.
    """
    show, began = _line(), [time.monotonic()]

    def count(name: str, done: int, total: int) -> None:
        elapsed = time.monotonic() - began[0]
        left = f", {clock(elapsed * (total - done) / done)} left" if 0 < done < total else ""
        if total > 1:  # a single step is a set that was there already
            show(f"{name}: {done} of {total}, {clock(elapsed)} gone{left}", done >= total)
        if done >= total:
            began[0] = time.monotonic()

    return count


def clock(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"


def _line() -> Callable[[str, bool], None]:
    """Return what writes a line over the one before on a terminal, and now and then a new one elsewhere."""
    last, width = [-EVERY], [0]

    def show(text: str, done: bool) -> None:
        if sys.stderr.isatty():
            padded, width[0] = text.ljust(width[0]), len(text)
            print(f"\r{padded}", end="\n" if done else "", file=sys.stderr, flush=True)
        elif done or time.monotonic() - last[0] >= EVERY:
            last[0] = time.monotonic()
            print(text, file=sys.stderr, flush=True)

    return show
