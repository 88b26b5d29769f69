"""When an object counts as lifted."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

LIFT_HEIGHT = 0.10
"""An object counts as lifted when it was at least this much above its place [m] ..."""
LIFT_TIME = 1.0
"""... for at least this long [s]."""


def is_lifted(heights: ArrayLike, rate: float) -> bool:
    """Tell whether an object with these ``heights`` (N,) [m] at ``rate`` [Hz] was lifted high and long enough."""
    z = np.asarray(heights, dtype=float)
    up = np.concatenate([[0], (z - z[:1] >= LIFT_HEIGHT).astype(int), [0]])
    edges = np.flatnonzero(np.diff(up))
    return bool((edges[1::2] - edges[::2]).max(initial=0) / rate >= LIFT_TIME)
