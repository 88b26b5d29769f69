"""Poses in which a shape looks the same: of these, the one is meant that needs the least motion."""

from __future__ import annotations

from functools import lru_cache
from itertools import permutations, product

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.perception.templates import Template

SAME = 0.002
"""A turned surface is the same if no more than one point in twenty is farther than this from it [m]."""


@lru_cache(maxsize=64)
def symmetries(template: Template) -> Pose:
    """Return the poses X_OS (K,) among the quarter and half turns about O's axes that map the shape onto itself.

    The turns are about the middle of the shape's box; the first of them is none.
    """
    points = template.points
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    found = []
    for R in _turns():
        X = Pose(rotation.from_matrix(R), centre - R @ centre)
        distance, _ = template.field.lookup(X.apply(points))
        if np.mean(np.abs(distance) > SAME) <= 0.05:
            found.append(X)
    return Pose.stack(found)


def nearest_equivalent(template: Template, X_WO: Pose, X_before: Pose) -> Pose:
    """Return, of the poses that look like X_WO, the one turned least from X_before.

    Without it a can that is put down elsewhere might be said to stand on its head.
    """
    best = [_spun(X_WO @ X, X_before) if template.round else X_WO @ X for X in symmetries(template)]
    return min(best, key=lambda X: float(rotation.angle(X.quaternion, X_before.quaternion)))


def _spun(X_WO: Pose, X_before: Pose) -> Pose:
    """Return X_WO turned about its own z so that it is turned least from X_before.

    With A = R_before' R the trace of A R_z(a) is cos a (A00 + A11) + sin a (A01 - A10) + A22, greatest at a below.
    """
    A = X_before.rotation_matrix().T @ X_WO.rotation_matrix()
    a = float(np.arctan2(A[0, 1] - A[1, 0], A[0, 0] + A[1, 1]))
    return X_WO @ Pose.from_rotation_vector([0.0, 0.0, a], np.zeros(3))


def _turns() -> list[Array]:
    """Return the 24 turns (3, 3) that map a cube onto itself, none at all first."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            R = np.zeros((3, 3))
            R[range(3), order] = signs
            if np.linalg.det(R) > 0.0:
                found.append(R)
    return found
