"""How near an arm came to what it must not touch."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.metrics.checks import finite, positive

Nearest: TypeAlias = Callable[[Array], Array]
"""What tells of postures (N, n) [rad] how far each is from the nearest thing (N,) [m], such as a method of
`optsc.robot.clearance.ClearanceScene` or a distance model of one's own; negative where bodies overlap."""


class PathClearance(NamedTuple):
    """The narrowest place of a motion.

    Attributes:
        least: least distance at any sample [m]; infinite without samples.
        time: when that was, since the first sample [s]; 0 without samples.
        mean: mean over the samples [m]: how much room there was on the whole.
    """

    least: float
    time: float
    mean: float


def path_clearance(nearest: Nearest, q: ArrayLike, rate: float, every: float = 0.02) -> PathClearance:
    """Return how near the arm came to anything along joint positions ``q`` (N, n) [rad] at ``rate`` [Hz].

    Looked at are samples ``every`` so many seconds, and the last. At the paper's speed the tool goes 2 mm between two
    of them, which bounds what can be missed. Raises `InvalidValue`.
    """
    postures = finite("q", q)
    stride = max(1, round(positive("every", every) * positive("rate", rate)))
    picked = np.array(sorted({*range(0, len(postures), stride), *range(len(postures))[-1:]}), dtype=int)
    if not len(picked):
        return PathClearance(inf, 0.0, inf)
    distance = np.asarray(nearest(postures[picked]), dtype=float)
    if distance.shape != picked.shape:
        raise InvalidValue("shape of the distances", distance.shape, f"{picked.shape}, one for each posture")
    lowest = int(np.argmin(distance))
    return PathClearance(float(distance[lowest]), float(picked[lowest]) / rate, float(np.mean(distance)))
