"""Rigid-body poses: one pose and N poses are one type."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry import rotation
from optsc.geometry.rotation import Array


def _frozen(array: Array) -> Array:
    array = np.ascontiguousarray(array, dtype=float)
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose X_AB of frame B in frame A, or a batch of them: names cancel, ``X_AC = X_AB @ X_BC``.

    Attributes:
        quaternion: unit quaternions (..., 4), ordered w, x, y, z.
        translation: positions of B's origin in A (..., 3) [m].

    The plain constructor trusts its arguments; what comes from outside enters through ``from_*``.
    """

    quaternion: Array
    translation: Array

    def __post_init__(self) -> None:
        q, p = self.quaternion, self.translation
        if q.shape[:-1] != p.shape[:-1]:
            batch = np.broadcast_shapes(q.shape[:-1], p.shape[:-1])
            q, p = np.broadcast_to(q, (*batch, 4)), np.broadcast_to(p, (*batch, 3))
        object.__setattr__(self, "quaternion", _frozen(q))
        object.__setattr__(self, "translation", _frozen(p))

    @classmethod
    def identity(cls, shape: tuple[int, ...] = ()) -> Pose:
        """Return identity poses of batch ``shape``."""
        return cls(np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*shape, 4)), np.zeros((*shape, 3)))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> Pose:
        """Return the poses of homogeneous matrices (..., 4, 4); raise `InvalidValue` if they are none."""
        M = np.asarray(matrix, dtype=float)
        if M.shape[-2:] != (4, 4) or not np.all(np.isfinite(M)):
            raise InvalidValue("pose matrix", M.tolist(), "finite, shape (..., 4, 4)")
        if not np.allclose(M[..., 3, :], [0.0, 0.0, 0.0, 1.0], atol=1e-9):
            raise InvalidValue("last row of the pose matrix", M[..., 3, :].tolist(), "0, 0, 0, 1")
        return cls(rotation.from_matrix(M[..., :3, :3]), M[..., :3, 3])

    @classmethod
    def from_quaternion(cls, wxyz: ArrayLike, p: ArrayLike) -> Pose:
        """Return poses from unit quaternions (..., 4) and positions (..., 3) [m]; raise `InvalidValue`."""
        translation = np.asarray(p, dtype=float)
        if translation.shape[-1:] != (3,) or not np.all(np.isfinite(translation)):
            raise InvalidValue("position", translation.tolist(), "finite, shape (..., 3) [m]")
        return cls(rotation.checked(wxyz), translation)

    @classmethod
    def from_rotation_vector(cls, rotation_vector: ArrayLike, p: ArrayLike) -> Pose:
        """Return poses from rotation vectors (..., 3) [rad] and positions (..., 3) [m]."""
        return cls.from_quaternion(rotation.exp(rotation_vector), p)

    @classmethod
    def from_translation(cls, p: ArrayLike) -> Pose:
        """Return unrotated poses at positions (..., 3) [m]."""
        return cls.from_quaternion([1.0, 0.0, 0.0, 0.0], p)

    @classmethod
    def stack(cls, poses: Sequence[Pose]) -> Pose:
        """Return the poses of equal batch shape as one batch with a new first axis."""
        return cls(np.stack([p.quaternion for p in poses]), np.stack([p.translation for p in poses]))

    @classmethod
    def concatenate(cls, poses: Sequence[Pose]) -> Pose:
        """Return the batches of poses joined along their first axis."""
        return cls(np.concatenate([p.quaternion for p in poses]), np.concatenate([p.translation for p in poses]))

    @property
    def shape(self) -> tuple[int, ...]:
        """The batch shape; () for a single pose."""
        return self.translation.shape[:-1]

    def __len__(self) -> int:
        if not self.shape:
            raise TypeError("a single Pose has no length")
        return self.shape[0]

    def __getitem__(self, index: object) -> Pose:
        return Pose(self.quaternion[index], self.translation[index])  # type: ignore[call-overload]

    def __iter__(self) -> Iterator[Pose]:
        return (self[i] for i in range(len(self)))

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(
            rotation.multiply(self.quaternion, other.quaternion),
            self.translation + rotation.rotate(self.quaternion, other.translation),
        )

    def inverse(self) -> Pose:
        """Return X_BA of X_AB."""
        q = rotation.conjugate(self.quaternion)
        return Pose(q, -rotation.rotate(q, self.translation))

    def apply(self, points: ArrayLike) -> Array:
        """Return points (..., 3) given in B, expressed in A; leading axes broadcast with the batch."""
        return self.translation + rotation.rotate(self.quaternion, points)

    def matrix(self) -> Array:
        """Return homogeneous matrices (..., 4, 4)."""
        M = np.zeros((*self.shape, 4, 4))
        M[..., :3, :3] = rotation.to_matrix(self.quaternion)
        M[..., :3, 3] = self.translation
        M[..., 3, 3] = 1.0
        return M

    def rotation_matrix(self) -> Array:
        """Return rotation matrices (..., 3, 3)."""
        return rotation.to_matrix(self.quaternion)

    def interpolate(self, end: Pose, fraction: ArrayLike) -> Pose:
        """Return poses on the straight line and SLERP towards ``end``; ``fraction`` in [0, 1], any shape."""
        s = np.asarray(fraction, dtype=float)
        p = self.translation + s[..., None] * (end.translation - self.translation)
        return Pose(rotation.slerp(self.quaternion, end.quaternion, s), p)

    def almost_equal(self, other: Pose, tolerance: float = 1e-9) -> bool:
        """Tell whether positions [m] and rotations [rad] agree within ``tolerance`` everywhere."""
        return bool(
            np.all(np.abs(self.translation - other.translation) <= tolerance)
            and np.all(rotation.angle(self.quaternion, other.quaternion) <= tolerance)
        )
