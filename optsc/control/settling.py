"""Settling: an arm that cannot get nearer to a target at rest comes to rest, instead of creeping on or circling.

Beyond reach, the quadratic program goes on to move joints for next to nothing: along directions that hardly change the
tool's distance, ever more slowly. The wished velocity is therefore given in full only while one of these holds; below
half of all of them the arm is brought to rest, and in between the share rises evenly:

* the target moves faster than `AT_REST`;
* the tool comes nearer by at least the share `PRODUCTIVE` of what is asked of it;
* it comes nearer by at least the share `WORTHWHILE` of its distance per second;
* a joint moves faster than the share `SLOW` of its greatest velocity.

The last two grow with the square of the time that the first two have not held, in units of `PATIENCE`; for the first
`GRACE` of it everything is given. The time begins again where the target goes to another place. So an arm that is on
its way is never stopped, one that finds nothing to gain stops within about two seconds, and one that is freed (an
obstacle leaves, the target comes back) goes on at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optsc.geometry.rotation import Array

AT_REST = (0.01, 0.05)
"""Speeds of a target [m/s, rad/s] from which on it counts as moving (tuned here)."""
PRODUCTIVE = 0.5
"""Share of the progress asked for (tuned here)."""
WORTHWHILE = 0.5
"""Progress per second, as share of the error [1/s] (tuned here)."""
SLOW = 0.05
"""Share of the greatest joint velocities (tuned here)."""
PATIENCE = 1.0
"""Time [s] after which both of these have doubled (tuned here)."""
LONGEST = 3.0
"""Time [s] from which on they grow no more (tuned here)."""
GRACE = 0.3
"""Time [s] that an arm is given to find out of a singularity, where nothing seems to be gained (tuned here)."""
ANOTHER_PLACE = (5e-3, 0.02)
"""Distance and angle [m, rad] by which a target is at another place (tuned here): more than the tremor of a hand."""
NEGLIGIBLE = 1e-8
"""Square of a weighted pose error that no motion is worth: 0.1 mm at a weight of one."""


class Descent(NamedTuple):
    """How the tool's error falls, see `optsc.kernels.pose_task`.

    Attributes:
        slope: (n,) what a joint velocity takes off half the square of the weighted error.
        square: of the weighted error.
        asked: what the velocity that is asked of the tool would take off.
    """

    slope: Array
    square: float
    asked: float


class Share(NamedTuple):
    """The share of the wished joint velocity that is given, in [0, 1], and how long there was little to gain [s]."""

    share: float
    waited: float


def moved(anchor: Array, p: Array, q: Array) -> bool:
    """Tell whether a target, position (3,) and quaternion (4,), is at another place than ``anchor`` (7,) is."""
    x, y, z = (anchor[:3] - p).tolist()
    a, b, c, d = (anchor[3:] - (q if anchor[3:] @ q >= 0.0 else -q)).tolist()
    # Twice the chord of unit quaternions is the angle, as far as it is small.
    return (
        x * x + y * y + z * z > ANOTHER_PLACE[0] ** 2 or 4.0 * (a * a + b * b + c * c + d * d) > ANOTHER_PLACE[1] ** 2
    )


def settle(descent: Descent, wish: Array, most: Array, pace: float, waited: float, period: float) -> Share:
    """Return how much of the wished joint velocity is worth it at a tick.

    Args:
        descent: how the error falls.
        wish: joint velocity (n,) [rad/s].
        most: greatest joint velocities (n,) [rad/s].
        pace: speed of the target, in units of `AT_REST`.
        waited: `Share.waited` of the last tick [s].
        period: of a tick [s].
    """
    progress = float(descent.slope @ wish)
    moving = max(pace, progress / (PRODUCTIVE * (descent.asked + NEGLIGIBLE)))
    if moving >= 1.0:
        return Share(1.0, 0.0)
    waited = min(waited + period, LONGEST)
    if waited < GRACE:
        return Share(1.0, waited)
    growth = 1.0 + (waited / PATIENCE) ** 2
    rate = progress / (WORTHWHILE * growth * (descent.square + NEGLIGIBLE))
    speed = float(np.abs(wish / most).max()) / (SLOW * growth)
    return Share(min(max(2.0 * max(moving, rate, speed) - 1.0, 0.0), 1.0), waited)
