"""Joint limits: position, velocity, acceleration and jerk as one checked value."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optsc.checks import Above, ArrayOf, AtMost, Checked, Positive, require
from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.kernels.chain import Rates


@dataclass(frozen=True, eq=False)
class JointLimits(Checked):
    """Limits of n joints, SI units.

    Attributes:
        lower, upper: joint positions (n,) [rad]; infinite for a continuous joint.
        velocity, acceleration, jerk: greatest magnitudes (n,) [rad/s, rad/s^2, rad/s^3], positive and finite.
    """

    lower: Annotated[Array, ArrayOf("n")]
    upper: Annotated[Array, ArrayOf("n")]
    velocity: Annotated[Array, ArrayOf("n"), Positive]
    acceleration: Annotated[Array, ArrayOf("n"), Positive]
    jerk: Annotated[Array, ArrayOf("n"), Positive]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.all(self.lower < self.upper):
            raise InvalidValue("position limits", (self.lower.tolist(), self.upper.tolist()), "lower < upper")

    def __len__(self) -> int:
        return len(self.lower)

    @property
    def positions(self) -> tuple[Array, Array]:
        """Lower and upper positions, each (n,)."""
        return self.lower, self.upper

    @property
    def rates(self) -> Rates:
        """Greatest velocities and accelerations, each (n,), as the kernels of collision avoidance take them."""
        return Rates(self.velocity, self.acceleration)

    @property
    def bounded(self) -> NDArray[np.bool_]:
        """Which joints (n,) have two position limits; the others turn endlessly."""
        return np.isfinite(self.lower) & np.isfinite(self.upper)

    @property
    def sampling(self) -> tuple[Array, Array]:
        """Lower and upper positions (n,) to draw configurations from: a continuous joint counts as one turn."""
        return np.where(self.bounded, self.lower, -np.pi), np.where(self.bounded, self.upper, np.pi)

    def clip(self, q: ArrayLike) -> Array:
        """Return ``q`` (..., n) moved to the nearest position inside the limits."""
        return np.clip(np.asarray(q, dtype=float), self.lower, self.upper)

    def tightened(self, *, velocity: float = 1.0, acceleration: float = 1.0, jerk: float = 1.0) -> JointLimits:
        """Return limits with the rates multiplied by factors in (0, 1]; raise `InvalidValue`."""
        for name, factor in (("velocity", velocity), ("acceleration", acceleration), ("jerk", jerk)):
            require(f"{name} factor", factor, Above(0.0), AtMost(1.0))
        return replace(
            self,
            velocity=self.velocity * velocity,
            acceleration=self.acceleration * acceleration,
            jerk=self.jerk * jerk,
        )
