"""Progress on the terminal: one line that changes, or a line now and then where the output is a file."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

EVERY = 10.0
"""Time between two lines where there is no terminal [s]."""


def shown_progress() -> Callable[[Any], None]:
    """Return what shows how far a run of jobs has come, on standard error."""
    last = [-EVERY]

    def show(progress: Any) -> None:
        done = progress.rows >= progress.of
        if sys.stderr.isatty():
            print(f"\r{progress}    ", end="\n" if done else "", file=sys.stderr, flush=True)
        elif done or time.monotonic() - last[0] >= EVERY:
            last[0] = time.monotonic()
            print(progress, file=sys.stderr, flush=True)

    return show
