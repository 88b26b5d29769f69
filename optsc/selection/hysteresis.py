"""Hysteresis of the ranking: the pose that is ranked for trails behind the hand, and rests while the hand trembles.

Each quantity passes the play operator (Krasnosel'skii and Pokrovskii 1989), the backlash of a loose gear: inside a
dead zone nothing moves, beyond it the output is dragged along. So a hand that trembles less than the zone leaves the
ranking exactly as it is, whatever the rule and its costs; a hand that drifts over a tie passes it once.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Annotated, NamedTuple

import numpy as np

from optsc.checks import Checked, NonNegative
from optsc.geometry import scalar
from optsc.geometry.rotation import Array


class Viewpoint(NamedTuple):
    """What a ranking is made for: unit quaternion (4,), position (3,) [m] of the tool, configuration (n,) [rad]."""

    quaternion: Array
    position: Array
    q: Array


@dataclass(frozen=True)
class Hysteresis(Checked):
    """How far hand and arm move before the ranking takes notice.

    The defaults are tuned here: they cover the stillest stretches of a recorded hand, and are less than what a person
    aims at (`python -m benchmarks.stability`). The price is a choice that is right for a pose at most that far from
    the hand's.

    Attributes:
        position: of the tool [m].
        angle: of the tool [rad].
        joint: of every joint [rad].
    """

    position: Annotated[float, NonNegative] = 0.015
    angle: Annotated[float, NonNegative] = 0.1
    joint: Annotated[float, NonNegative] = 0.05

    def dragged(self, last: Viewpoint | None, new: Viewpoint) -> Viewpoint:
        """Return the viewpoint that ``last`` becomes when hand and arm are at ``new``; ``last`` itself inside."""
        if last is None or len(last.q) != len(new.q):
            return new
        position = _dragged_point(last.position, new.position, self.position)
        quaternion = _dragged_rotation(last.quaternion, new.quaternion, self.angle)
        q = np.minimum(np.maximum(last.q, new.q - self.joint), new.q + self.joint)
        still = position is last.position and quaternion is last.quaternion and np.array_equal(q, last.q)
        return last if still else Viewpoint(quaternion, position, q)


def _dragged_point(last: Array, new: Array, zone: float) -> Array:
    offset = new - last
    x, y, z = offset.tolist()
    distance = sqrt(x * x + y * y + z * z)
    return last if distance <= zone else last + offset * (1.0 - zone / distance)


def _dragged_rotation(last: Array, new: Array, zone: float) -> Array:
    before = tuple(last.tolist())
    x, y, z = scalar.log(scalar.multiply(tuple(new.tolist()), scalar.conjugate(before)))
    angle = sqrt(x * x + y * y + z * z)
    if angle <= zone:
        return last
    share = 1.0 - zone / angle
    dragged = scalar.multiply(scalar.exp((share * x, share * y, share * z)), before)
    return np.array(scalar.normalised(dragged))
