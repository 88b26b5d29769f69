"""Settings of the PyBullet simulation: time step, gains, friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from optsc.checks import Above, AtLeast, AtMost, Checked, Positive
from optsc.followers.protocol import JAW_SPEED

GRAVITY = 9.81
"""[m/s^2], downwards."""

LONGEST_STEP = 1.0 / 480.0
"""Longest simulation step [s]: with longer ones grasps that hold in reality slip."""


@dataclass(frozen=True)
class PhysicsSettings(Checked):
    """Settings of the simulation; the defaults are the measured ones with which grasps hold.

    Attributes:
        time_step: simulation step [s], at most `LONGEST_STEP`. A control period is a whole number of steps.
        solver_iterations: at most so many of the contact solver in a step. With 50 a drill slips out of one
            grasp in three, with 150 out of one in ten.
        position_gain: share of a position error that an arm joint takes back in one step [-].
        jaw_force: greatest force of each jaw [N].
        jaw_speed: greatest rate of the opening [m/s]; each jaw moves at half of it.
        finger_friction: Coulomb coefficient of the pads [-]. PyBullet multiplies two bodies' coefficients, so
            that one leaves the object's own in force.
        pad_torsion: radius [m] at which a pad's friction resists turning about its normal: 2 r / 3 for an
            evenly loaded disc of radius r, and a Panda's pad has the area of a disc of 10 mm. Without it two
            hard pads are an axle, and almost every object turns out of its grasp.
    """

    time_step: Annotated[float, Positive, AtMost(LONGEST_STEP)] = 1e-3
    solver_iterations: Annotated[int, AtLeast(1)] = 150
    position_gain: Annotated[float, Above(0.0), AtMost(1.0)] = 0.3
    jaw_force: Annotated[float, Positive] = 40.0
    jaw_speed: Annotated[float, Positive] = JAW_SPEED
    finger_friction: Annotated[float, Positive] = 1.0
    pad_torsion: Annotated[float, Positive] = 0.005
