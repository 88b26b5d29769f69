"""Where the pads would meet the object, and how well they would lie on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.robot.gripper import Gripper
from optsc.sampling.proposals import cone_cosine
from optsc.sampling.surface import Surface

DENT = 0.001
"""Depth [m] to which a rubber pad gives way: what lies within it of the outermost point carries load."""


class PadContacts(NamedTuple):
    """What the two pads find between them at each of K poses; zeros where there is nothing."""

    width: Array
    """Distance between the outermost points (K,) [m]: where the jaws stop."""
    offset: Array
    """Middle between the outermost points along the closing axis (K,) [m]."""
    coverage: Array
    """Share of the pad's area that carries load, of the pad with less (K,)."""
    eccentricity: Array
    """Distance of the load's middle from the pad's middle, in half pad sizes, of the worse pad (K,)."""
    alignment: Array
    """Cosine between the closing axis and the mean normal under a pad, of the worse pad (K,)."""
    points: Array
    """Middle of the load under each pad in the tool frame (K, 2, 3) [m]: at -y, at +y."""
    inward: Array
    """Mean normal under each pad in the object's frame, into the object (K, 2, 3); unit, or zero."""


def pad_contacts(
    points_T: np.ndarray,
    surface: Surface,
    X_OG: Pose,
    gripper: Gripper,
    friction: float,
    dent: float = DENT,
) -> PadContacts:
    """Return the contacts when the jaws close at each of K poses.

    Args:
        points_T: the surface's points in the tool frames, (3, K, N), from `in_tool_frame`.
        surface: the points' normals and areas.
        X_OG: (K,) tool poses.
        gripper: its pads are taken as rectangles about the tool's z-x plane.
        friction: Coulomb coefficient; a point whose normal leaves the friction cone carries no load.
        dent: depth [m] within which points carry load.
    """
    count = len(X_OG)
    half = 0.5 * np.array([gripper.pad_size[0], gripper.max_opening, gripper.pad_size[1]], dtype=np.float32)
    between = np.abs(points_T[0]) < half[0]
    between &= np.abs(points_T[2]) < half[2]
    between &= np.abs(points_T[1]) < half[1]
    pose, point = np.nonzero(between)
    x, y, z = points_T[:, pose, point]
    highest, lowest = np.full(count, -half[1]), np.full(count, half[1])
    np.maximum.at(highest, pose, y)
    np.minimum.at(lowest, pose, y)
    closing_axis = X_OG.rotation_matrix()[:, :, 1]
    cosine = np.einsum("pi,pi->p", surface.normals[point], closing_axis[pose])
    area = surface.areas[point] / (gripper.pad_size[0] * gripper.pad_size[1])
    sides, points, inward = [], [], []
    for sign, edge, near in (
        (-1.0, lowest, y < lowest[pose] + dent),
        (1.0, highest, y > highest[pose] - dent),
    ):
        load = np.where(near & (sign * cosine > cone_cosine(friction)), area, 0.0)
        total = np.bincount(pose, load, count)
        x_mean, z_mean = (np.bincount(pose, load * v, count) / np.maximum(total, 1e-12) for v in (x, z))
        normal = np.stack([np.bincount(pose, load * n, count) for n in surface.normals[point].T], axis=-1)
        length = np.maximum(np.linalg.norm(normal, axis=-1), 1e-12)
        aligned = sign * np.einsum("ki,ki->k", normal, closing_axis) / length
        points.append(np.stack([x_mean, edge, z_mean], axis=-1))
        inward.append(-normal / length[:, None])
        sides.append((total, np.maximum(abs(x_mean) / half[0], abs(z_mean) / half[2]), aligned))
    (a, a_off, a_cos), (b, b_off, b_cos) = sides
    return PadContacts(
        width=np.maximum(0.0, highest - lowest),  # below zero where nothing was found
        offset=0.5 * (highest + lowest),
        coverage=np.minimum(1.0, np.minimum(a, b)),
        eccentricity=np.maximum(a_off, b_off),
        alignment=np.minimum(a_cos, b_cos),
        points=np.stack(points, axis=1),
        inward=np.stack(inward, axis=1),
    )
