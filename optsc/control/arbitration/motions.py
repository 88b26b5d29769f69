"""Wishes of the robot, as twists (6,) in W, and confidence."""

from __future__ import annotations

from math import hypot

import numpy as np

from optsc.control.arbitration.interface import Blend, GraspPose, Moment
from optsc.geometry import scalar
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Vector

SLOWING = 0.3
"""Time constant [s] of coming to rest at a pose: from 0.1 m/s the last 3 cm are slower."""


def offset(moment: Moment, grasp: GraspPose) -> tuple[Vector, Vector]:
    """Return the displacement [m] and the rotation vector [rad], in W, that lead the tool to a grasp."""
    (x, y, z), (gx, gy, gz) = moment.p, grasp.p
    return (gx - x, gy - y, gz - z), scalar.log(scalar.multiply(grasp.q, scalar.conjugate(moment.q)))


def towards(moment: Moment, grasp: GraspPose) -> Array:
    """Return the twist (6,) that leads straight to a grasp: e / `SLOWING`, at the approach's speeds at most.

    The slower of the two parts sets the pace, so that line and rotation end together.
    """
    shift, turn = offset(moment, grasp)
    approach = moment.approach
    pace = max(hypot(*shift) / approach.speed, hypot(*turn) / approach.angular_speed, SLOWING)
    return np.array([*shift, *turn]) / pace


def ramp(value: float, low: float, high: float) -> float:
    """Return 0 up to ``low``, 1 from ``high`` on, and a straight line between; a step where both are equal."""
    if value <= low:
        return 0.0
    return 1.0 if value >= high else (value - low) / (high - low)


def limited(last: float, wanted: float, most: float) -> float:
    """Return ``wanted``, but no further from ``last`` than ``most``."""
    return min(max(wanted, last - most), last + most)


def blended(moment: Moment, wanted: float, rate: float, grasp: GraspPose) -> Blend:
    """Return u = (1 - alpha) u_h + alpha u_r towards a grasp; alpha nears ``wanted`` at most at ``rate`` [1/s]."""
    alpha = limited(moment.last.share, wanted, rate * moment.period)
    return Blend((1.0 - alpha) * np.eye(6), alpha * towards(moment, grasp), alpha)
