"""Many guesses of one template's pose at once, as rotation matrices: what the search works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array


@dataclass(frozen=True, eq=False)
class Guesses:
    """Guesses X_WO of a pose: rotations (B, 3, 3) and positions (B, 3) [m]."""

    R: Array
    t: Array

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, index: object) -> Guesses:
        return Guesses(self.R[index], self.t[index])  # type: ignore[call-overload]

    @classmethod
    def of(cls, poses: Pose) -> Guesses:
        """Return a batch of poses (B,) as guesses."""
        return cls(poses.rotation_matrix(), np.array(poses.translation))

    @classmethod
    def joined(cls, parts: Sequence[Guesses]) -> Guesses:
        """Return the guesses of all ``parts``, in order."""
        return cls(np.concatenate([p.R for p in parts]), np.concatenate([p.t for p in parts]))

    def pose(self, index: int) -> Pose:
        """Return one guess as a pose."""
        return Pose(rotation.from_matrix(orthonormal(self.R[index])), self.t[index])

    def to_object(self, points_W: Array) -> Array:
        """Return points (M, 3) of W in the frame O of every guess (B, M, 3)."""
        return (points_W[None] - self.t[:, None]) @ self.R

    def to_world(self, points_O: Array) -> Array:
        """Return points (M, 3) of O in W for every guess (B, M, 3)."""
        return points_O[None] @ self.R.swapaxes(1, 2) + self.t[:, None]

    def moved(self, turn: Array, shift: Array, pivot: Array) -> Guesses:
        """Return the guesses turned by rotation vectors (B, 3) [rad] about ``pivot`` (3,) and shifted (B, 3) [m]."""
        Q = rotation.to_matrix(rotation.exp(turn))
        return Guesses(Q @ self.R, pivot + np.einsum("bij,bj->bi", Q, self.t - pivot) + shift)


def orthonormal(R: Array) -> Array:
    """Return the nearest rotations (..., 3, 3): products of many rotations drift by rounding."""
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt


def yaws(count: int) -> Array:
    """Return rotations about z (count, 3, 3) by equal parts of a full turn."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return rotation.to_matrix(rotation.exp(angle[:, None] * np.array([0.0, 0.0, 1.0])))
