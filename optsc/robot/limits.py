"""Joint limits: position, velocity, acceleration and jerk as one checked value."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.kernels.rows import Rates


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of n joints, SI units.

    Attributes:
        lower, upper: joint positions (n,) [rad]; infinite for a continuous joint.
        velocity, acceleration, jerk: greatest magnitudes (n,) [rad/s, rad/s^2, rad/s^3], positive and finite.
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array

    def __post_init__(self) -> None:
        count = np.shape(self.lower)
        for name in ("lower", "upper", "velocity", "acceleration", "jerk"):
            value = np.array(getattr(self, name), dtype=float)
            if value.ndim != 1 or value.shape != count:
                raise InvalidValue(f"{name} limits", value.shape, f"shape {count}, one value per joint")
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        if not np.all(self.lower < self.upper):
            raise InvalidValue("position limits", (self.lower.tolist(), self.upper.tolist()), "lower < upper")
        for name in ("velocity", "acceleration", "jerk"):
            value = getattr(self, name)
            if not np.all(np.isfinite(value) & (value > 0)):
                raise InvalidValue(f"{name} limits", value.tolist(), "positive and finite")

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

    def tightened(
        self, *, velocity: float = 1.0, acceleration: float = 1.0, jerk: float = 1.0
    ) -> JointLimits:
        """Return limits with the rates multiplied by factors in (0, 1]; raise `InvalidValue`."""
        for name, factor in (("velocity", velocity), ("acceleration", acceleration), ("jerk", jerk)):
            if not 0.0 < factor <= 1.0:
                raise InvalidValue(f"{name} factor", factor, "in (0, 1]")
        return replace(
            self,
            velocity=self.velocity * velocity,
            acceleration=self.acceleration * acceleration,
            jerk=self.jerk * jerk,
        )
