"""Tracker jumps: steps from one sample to the next that no hand makes.

A step is compared with a steady motion at the hand's last velocity. What a hand can add to that between two samples
follows from its acceleration, what a tracker adds is noise; beyond both the hand has not moved, but jumped: a tracker
that reports the identity when it is lost, axes that turn over, a hand that is found again elsewhere.
"""

from __future__ import annotations

from math import hypot
from typing import NamedTuple

from optsc.geometry import scalar
from optsc.geometry.scalar import Vector
from optsc.operators.clutch import ClutchSettings, Hand

AVERAGED = 0.2
"""Share of the newest interval in the average of the intervals between samples."""
LONGEST_INTERVAL = 0.1
"""Longest interval [s] that counts in that average."""
MEMORY = 0.015
"""Time constant [s] of the velocity: at high rates the difference of two samples is mostly noise."""


class TrackedHand(NamedTuple):
    """A hand and how it moves, in the station frame.

    Attributes:
        hand: at the last sample, as the tracker gave it.
        v, w: its velocities [m/s, rad/s].
        interval: between samples, on average [s]; that of a slow tracker before there are some.
    """

    hand: Hand
    v: Vector = (0.0, 0.0, 0.0)
    w: Vector = (0.0, 0.0, 0.0)
    interval: float = 0.02

    def _step(self, hand: Hand) -> tuple[Vector, Vector, float]:
        """Return displacement, turn and the time that they are judged by.

        Samples that arrive in bunches have moved for longer than their stamps are apart, hence the average.
        """
        last = self.hand
        shift = (hand.p[0] - last.p[0], hand.p[1] - last.p[1], hand.p[2] - last.p[2])
        turn = scalar.log(scalar.multiply(scalar.normalised(hand.q), scalar.conjugate(scalar.normalised(last.q))))
        return shift, turn, max(hand.stamp - last.stamp, self.interval, 0.0)

    def after(self, hand: Hand) -> TrackedHand:
        """Return the motion after a sample that is no jump."""
        shift, turn, elapsed = self._step(hand)
        since = min(max(hand.stamp - self.hand.stamp, 0.0), LONGEST_INTERVAL)
        interval = self.interval + AVERAGED * (since - self.interval)
        if elapsed <= 0.0:
            return self._replace(hand=hand)
        k = 1.0 / (elapsed + MEMORY)
        kept = MEMORY * k
        return TrackedHand(hand, _sum(k, shift, kept, self.v), _sum(k, turn, kept, self.w), interval)

    def jumps(self, settings: ClutchSettings, hand: Hand) -> bool:
        """Tell whether ``hand`` is further from the last sample than a hand moves between two."""
        shift, turn, elapsed = self._step(hand)
        pairs = zip((shift, turn), (self.v, self.w), strict=True)
        for part, (step, velocity) in enumerate(pairs):
            if hypot(*step) > settings.largest_step[part]:
                return True
            most = settings.noise[part] + settings.largest_acceleration[part] * elapsed * elapsed
            x, y, z = (step[k] - elapsed * velocity[k] for k in range(3))
            if hypot(x, y, z) > most:
                return True
        return False


def _sum(k: float, a: Vector, m: float, b: Vector) -> Vector:
    return k * a[0] + m * b[0], k * a[1] + m * b[1], k * a[2] + m * b[2]
