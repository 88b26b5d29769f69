"""Smoothing of a hand before the clutch: a One-Euro filter or a plain low-pass, on position and rotation alike.

G. Casiez, N. Roussel, D. Vogel, "1 EUR filter: a simple speed-based low-pass filter for noisy input in interactive
systems", CHI 2012. The cut-off frequency rises with the speed: calm at rest, quick in motion. A plain low-pass is the
same filter with a slope of zero. Rotations are blended by SLERP with a share from the speed of their vector.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, pi
from typing import Annotated, NamedTuple

from optsc.checks import Checked, NonNegative, Positive, require
from optsc.geometry import scalar
from optsc.geometry.scalar import Quaternion, Vector
from optsc.operators.clutch import Hand


@dataclass(frozen=True)
class Smoothing(Checked):
    """How strongly a hand is smoothed.

    Attributes:
        cutoff: cut-off frequency at rest [Hz].
        slope: how much it rises with the speed of the hand [Hz per m/s] ...
        rotation_slope: ... and of its rotation [Hz per rad/s].
        speed_cutoff: cut-off frequency of the speed estimate itself [Hz].
    """

    cutoff: Annotated[float, Positive] = 1.0
    slope: Annotated[float, NonNegative] = 20.0
    rotation_slope: Annotated[float, NonNegative] = 5.0
    speed_cutoff: Annotated[float, Positive] = 1.0

    @classmethod
    def low_pass(cls, time_constant: float) -> Smoothing:
        """Return a first-order low-pass of ``time_constant`` [s], the same at every speed."""
        require("time_constant", time_constant, Positive)
        return cls(cutoff=1.0 / (2.0 * pi * time_constant), slope=0.0, rotation_slope=0.0)


class SmoothedHand(NamedTuple):
    """The smoothed hand, and its smoothed velocities [m/s, rad/s]."""

    hand: Hand
    v: Vector
    w: Vector


def begin(hand: Hand) -> SmoothedHand:
    """Return a filter that starts at ``hand``, at rest: a new one for every engagement, with nothing left over."""
    return SmoothedHand(hand, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def share(cutoff: float, elapsed: float) -> float:
    """Return the share of a step that a first-order low-pass follows in ``elapsed`` [s]."""
    return 1.0 / (1.0 + 1.0 / (2.0 * pi * cutoff * elapsed))


def smoothed(settings: Smoothing, state: SmoothedHand, hand: Hand) -> SmoothedHand:
    """Return the filter after a new sample; one that is no later than the last changes nothing."""
    last = state.hand
    elapsed = hand.stamp - last.stamp
    if elapsed <= 0.0:
        return state
    step = (hand.p[0] - last.p[0], hand.p[1] - last.p[1], hand.p[2] - last.p[2])
    turn = scalar.log(scalar.multiply(hand.q, scalar.conjugate(last.q)))
    s = share(settings.speed_cutoff, elapsed)
    v, w = _blended(state.v, step, s, elapsed), _blended(state.w, turn, s, elapsed)
    along = share(settings.cutoff + settings.slope * hypot(*v), elapsed)
    about = share(settings.cutoff + settings.rotation_slope * hypot(*w), elapsed)
    p = (last.p[0] + along * step[0], last.p[1] + along * step[1], last.p[2] + along * step[2])
    q: Quaternion = scalar.multiply(scalar.exp((about * turn[0], about * turn[1], about * turn[2])), last.q)
    return SmoothedHand(Hand(p, scalar.normalised(q), hand.stamp), v, w)


def _blended(old: Vector, step: Vector, s: float, elapsed: float) -> Vector:
    return (
        old[0] + s * (step[0] / elapsed - old[0]),
        old[1] + s * (step[1] / elapsed - old[1]),
        old[2] + s * (step[2] / elapsed - old[2]),
    )
