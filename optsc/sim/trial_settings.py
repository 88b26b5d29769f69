"""How a grasp is tried, and what counts as holding."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import NamedTuple

import numpy as np

from optsc.errors import require_positive
from optsc.geometry.rotation import Array


@dataclass(frozen=True)
class TrialSettings:
    """How a trial is done and what counts as holding; all numbers are finite and above 0.

    Attributes:
        time_step: simulation step [s].
        solver_iterations: of the contact solver; with 50 an object slips that holds with 150 and at 1 kHz.
        standoff: length of the straight approach [m].
        speed: of approach and lift [m/s].
        jaw_force: greatest force of each jaw [N].
        jaw_speed: of each jaw while it closes [m/s].
        pad_friction: Coulomb coefficient of the pads [-]; one leaves the object's own in force.
        pad_torsion: radius [m] at which a pad's friction resists turning about its normal; for an evenly
            loaded disc of radius r it is 2 r / 3, and a Panda's pad has the area of a disc of 10 mm.
        lift: [m].
        shake: way from one end to the other [m], along x, y and z in turn.
        shake_frequency: [Hz].
        max_slip: of the object in the hand [m].
        max_slip_angle: of the object in the hand [rad].
        bump: motion of the object before the jaws close that is called a bump [m].
    """

    time_step: float = 1.0 / 240.0
    solver_iterations: int = 150
    standoff: float = 0.10
    speed: float = 0.25
    jaw_force: float = 40.0
    jaw_speed: float = 0.05
    pad_friction: float = 1.0
    pad_torsion: float = 0.005
    lift: float = 0.12
    shake: float = 0.06
    shake_frequency: float = 2.0
    max_slip: float = 0.02
    max_slip_angle: float = 0.2
    bump: float = 0.005

    def __post_init__(self) -> None:
        require_positive("TrialSettings", {field.name: getattr(self, field.name) for field in fields(self)})

    def facts(self) -> dict[str, float]:
        """Return the numbers by name."""
        return asdict(self)


class TrialOutcome(NamedTuple):
    """What happened to each of N grasps."""

    lifted: np.ndarray
    """(N,) bool: at the end in contact with both pads, up, and not slipped by more than allowed."""
    moved_before_closing: Array
    """Way of the object's origin during the approach (N,) [m]: a lot means that the hand bumped it."""
    moved_by_closing: Array
    """Way of the object's origin while the jaws closed (N,) [m]."""
    slip: Array
    """Way of the object's centre of mass in the hand between closing and the end (N,) [m]; NaN where lost."""
    slip_angle: Array
    """Turn of the object in the hand between closing and the end (N,) [rad]; NaN where lost."""

    def reasons(self, settings: TrialSettings) -> tuple[str, ...]:
        """Return for each grasp ``held``, ``bumped`` (and lost), ``lost``, or ``slipped``."""
        lost, bumped = np.isnan(self.slip), self.moved_before_closing > settings.bump
        words = np.where(lost, "lost", "slipped")
        words = np.where(bumped, "bumped", words)
        return tuple(np.where(self.lifted, "held", words).tolist())
