"""Point clouds as values: points, and where known their normals and whether they were seen at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue, Mismatch
from optsc.geometry import rotation
from optsc.geometry.pose import Pose
from optsc.geometry.rotation import Array


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points of a surface, in a frame that each use names. It may be empty.

    Attributes:
        points: (N, 3), finite [m].
        normals: outward unit normals (N, 3), or None where they are not known.
        seen: (N,) bool, True where a point was measured and False where a template filled it in; None if all
            were measured.

    Raises:
        InvalidValue: shapes that do not belong together, a point that is not finite, a normal of other length.
    """

    points: Array
    normals: Array | None = None
    seen: np.ndarray | None = None

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InvalidValue("cloud points", points.shape, "finite, shape (N, 3) [m]")
        object.__setattr__(self, "points", _frozen(points))
        if self.normals is not None:
            normals = np.array(self.normals, dtype=float)
            if normals.shape != points.shape:
                raise InvalidValue("cloud normals", normals.shape, f"shape {points.shape}")
            lengths = np.linalg.norm(normals, axis=1)
            if not (np.abs(lengths - 1.0) < 1e-6).all():
                worst = float(lengths[np.argmax(np.abs(lengths - 1.0))])
                raise InvalidValue("length of a cloud's normal", worst, "1")
            object.__setattr__(self, "normals", _frozen(normals))
        if self.seen is not None:
            seen = np.array(self.seen)
            if seen.shape != points.shape[:1] or seen.dtype != np.bool_:
                raise InvalidValue(
                    "seen flags of a cloud", f"{seen.dtype}{seen.shape}", f"bool, shape ({len(points)},)"
                )
            object.__setattr__(self, "seen", _frozen(seen))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def seen_mask(self) -> np.ndarray:
        """Whether each point was measured (N,) bool."""
        return np.ones(len(self), dtype=bool) if self.seen is None else self.seen

    @property
    def visible_share(self) -> float:
        """Share of the points that were measured, 0 to 1; 0 for an empty cloud."""
        return float(self.seen_mask.mean()) if len(self) else 0.0

    def select(self, mask_or_index: ArrayLike) -> PointCloud:
        """Return the points of a mask (N,) bool or of indices (M,), in their order.

        Raises:
            InvalidValue: a mask of another length or an index that the cloud does not have.
        """
        choice = np.asarray(mask_or_index)
        if choice.size == 0:
            choice = choice.astype(np.intp if choice.dtype != np.bool_ else np.bool_)
        if choice.ndim != 1 or not (choice.dtype == np.bool_ or np.issubdtype(choice.dtype, np.integer)):
            raise InvalidValue("selection", f"{choice.dtype}{choice.shape}", "bool (N,) or integers (M,)")
        if choice.dtype == np.bool_:
            if len(choice) != len(self):
                raise InvalidValue("length of the mask", len(choice), f"{len(self)}")
        elif choice.size and (choice.min() < -len(self) or choice.max() >= len(self)):
            raise InvalidValue("index of a point", int(choice.max()), f"0 to {len(self) - 1}")
        return PointCloud(
            self.points[choice],
            None if self.normals is None else self.normals[choice],
            None if self.seen is None else self.seen[choice],
        )

    def transformed(self, X: Pose) -> PointCloud:
        """Return the cloud in A, given X_AB where B is its frame.

        Raises:
            InvalidValue: a batch of poses.
        """
        if X.shape != ():
            raise InvalidValue("X", X.shape, "a single pose")
        normals = None if self.normals is None else rotation.rotate(X.quaternion, self.normals)
        return PointCloud(X.apply(self.points), normals, self.seen)

    @classmethod
    def joined(cls, *clouds: PointCloud) -> PointCloud:
        """Return the clouds of one frame as one, in order; without any, an empty cloud.

        Raises:
            Mismatch: some of the clouds have normals and others do not; empty clouds do not count.
        """
        parts = [cloud for cloud in clouds if len(cloud)]
        if not parts:
            return cls(np.zeros((0, 3)))
        given = [cloud.normals for cloud in parts if cloud.normals is not None]
        if given and len(given) < len(parts):
            raise Mismatch("a cloud with normals", "clouds with normals", "a cloud without")
        flagged = any(cloud.seen is not None for cloud in parts)
        return cls(
            np.concatenate([cloud.points for cloud in parts]),
            np.concatenate(given) if given else None,
            np.concatenate([cloud.seen_mask for cloud in parts]) if flagged else None,
        )


def _frozen(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array
