"""Numbers of the simulation that may be changed, and why they are what they are."""

from __future__ import annotations

from dataclasses import dataclass, fields

from optsc.errors import InvalidValue, require_positive
from optsc.followers.protocol import JAW_SPEED

GRAVITY = 9.81
"""[m/s^2], downwards."""

LONGEST_STEP = 1.0 / 480.0
"""Longest simulation step [s]: with longer ones grasps that hold in reality slip."""


@dataclass(frozen=True)
class PhysicsSettings:
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

    time_step: float = 1e-3
    solver_iterations: int = 150
    position_gain: float = 0.3
    jaw_force: float = 40.0
    jaw_speed: float = JAW_SPEED
    finger_friction: float = 1.0
    pad_torsion: float = 0.005

    def __post_init__(self) -> None:
        require_positive("PhysicsSettings", {field.name: getattr(self, field.name) for field in fields(self)})
        if self.time_step > LONGEST_STEP:
            raise InvalidValue("PhysicsSettings.time_step", self.time_step, f"at most {LONGEST_STEP:.6f} s")
        if self.position_gain > 1.0:
            raise InvalidValue("PhysicsSettings.position_gain", self.position_gain, "in (0, 1]")
