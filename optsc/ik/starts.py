"""Postures to start a search from: those of a random table that already hold the tool near the pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optsc.geometry.rotation import Array

TABLE = 512
"""Postures in a table of starts."""
FIRST_TABLE_SEED = (2307, 16523)
"""Unlike any single number, so that the tables that a caller's generator draws do not repeat the first one."""
BLOCK, HALF = 16, TABLE // 2
"""Poses, and for a single pose postures, that are compared at once: products so small that no BLAS library shares them
among threads, whose meeting takes longer than the product."""
TURN_LENGTH = 0.4
"""In choosing starts, a turn of the tool by one radian weighs as much as this distance [m] of it."""
JOINT_LENGTH = 0.1
"""In choosing starts, a joint one radian off the seed weighs as much as this distance [m] of the tool."""

_I, _J = np.triu_indices(4)
_WEIGHTS = np.sqrt(2.0) * TURN_LENGTH * np.where(_I == _J, 1.0, np.sqrt(2.0))


def features(quaternion: Array, p: Array, q: Array) -> Array:
    """Return vectors (N, 13 + n) [m] whose distance is small where tools and postures are near.

    Rotations enter as c cᵀ of their quaternions c, which has no sign; two are √2 sin(angle / 2) apart. It is
    symmetric, so one triangle will do, in which what stands for two entries is weighted by √2.
    """
    square = quaternion[:, _I] * quaternion[:, _J] * _WEIGHTS
    return np.concatenate([square, p, np.broadcast_to(q * JOINT_LENGTH, (len(p), q.shape[1]))], axis=1)


@dataclass(frozen=True, eq=False)
class StartTable:
    """Postures to start from, and what tells how near they are to a pose and a seed.

    Attributes:
        q: the postures (M, n).
        features: their `features` (M, 13 + n).
        half_square: half the square of the features' lengths (M,).
    """

    q: Array
    features: Array
    half_square: Array

    def nearest(self, wanted: Array, count: int) -> NDArray[np.intp]:
        """Return the indices (N, count) of the nearest postures, nearest first."""
        blocks = [self._nearest(wanted[i : i + BLOCK], count) for i in range(0, max(1, len(wanted)), BLOCK)]
        return np.concatenate(blocks)

    def _nearest(self, wanted: Array, count: int) -> NDArray[np.intp]:
        distance = self.half_square - wanted @ self.features.T
        row = np.arange(len(wanted))[:, None]
        first = np.argpartition(distance, count, axis=1)[:, :count]
        return first[row, np.argsort(distance[row, first], axis=1, kind="stable")]

    def nearest_to_one(self, quaternion: Array, p: Array, q: Array, count: int) -> Array:
        """Return the postures (count, n) nearest to one pose (4,), (3,) and seed (n,), without the cost of many."""
        wanted = np.concatenate((quaternion[_I] * quaternion[_J] * _WEIGHTS, p, q * JOINT_LENGTH))
        distance = self.half_square.copy()
        distance[:HALF] -= self.features[:HALF].dot(wanted)
        distance[HALF:] -= self.features[HALF:].dot(wanted)
        first = distance.argpartition(count)[:count]
        return self.q[first[distance[first].argsort(kind="stable")]]
