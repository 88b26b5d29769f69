"""Object catalogue: six everyday objects, made from a few numbers each, for a gripper with an 80 mm stroke."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from optsc.errors import UnknownName
from optsc.geometry import TriangleMesh
from optsc.sim.objects.model import ObjectModel
from optsc.sim.objects.solids import circle, cuboid, hull, loft, revolved, tube, union

Parts = list[TriangleMesh]


def _banana() -> Parts:
    """Lie on one side: a bent, tapering tube that touches the table along its whole length."""
    sides, bend, radius_of_bend = 16, np.radians(110.0), 0.085
    s = np.linspace(-1.0, 1.0, 15)
    stem = np.where(s > 0.8, 0.0065, 0.0075)
    radius = stem + (0.0180 - stem) * np.sqrt(np.clip(1.0 - np.abs(s) ** 2.5, 0.0, 1.0))
    angle = 0.5 * bend * s
    outwards = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(s)], axis=-1)
    apothem = radius * np.cos(np.pi / sides)
    centre = radius_of_bend * outwards + apothem[:, None] * [0.0, 0.0, 1.0]
    ring = circle(1.0, sides=sides)
    sections = centre[:, None] + radius[:, None, None] * (
        ring[:, 1, None] * outwards[:, None] + ring[:, 0, None] * np.array([0.0, 0.0, 1.0])
    )
    low, high = sections.min(axis=(0, 1)), sections.max(axis=(0, 1))
    return loft(sections - [*(low + high)[:2] / 2, 0.0])


def _bottle() -> Parts:
    body = [(0.027, 0.0), (0.030, 0.003), (0.030, 0.115), (0.0275, 0.130), (0.0215, 0.145), (0.0130, 0.158)]
    cap = [(0.0150, 0.170), (0.0150, 0.190), (0.0140, 0.192)]
    return [revolved(body), revolved([(0.0130, 0.157), (0.0125, 0.171)]), revolved(cap)]


def _box() -> Parts:
    return [cuboid([-0.026, -0.034, 0.0], [0.026, 0.034, 0.130], chamfer=0.001)]


def _can() -> Parts:
    return [revolved([(0.0270, 0.0), (0.0300, 0.004), (0.0300, 0.096), (0.0270, 0.100)])]


def _drill() -> Parts:
    """Stand on the battery: a barrel along x with a chuck, and a grip that leans back towards it."""

    def along_x(radius: float, x: float) -> np.ndarray:
        return circle(radius)[:, [2, 0, 1]] + [x, 0.0, 0.160]

    def section(x: float, z: float) -> np.ndarray:
        return circle(1.0, sides=16) * [0.021, 0.017, 0.0] + [x, 0.0, z]

    battery = cuboid([-0.050, -0.031, 0.0], [0.050, 0.031, 0.036], chamfer=0.003)
    barrel = hull([along_x(0.021, -0.085), along_x(0.026, -0.079), along_x(0.026, 0.046), along_x(0.022, 0.056)])
    chuck = hull([along_x(0.019, 0.055), along_x(0.019, 0.075), along_x(0.009, 0.095)])
    return [battery, hull([section(-0.004, 0.030), section(-0.020, 0.150)]), barrel, chuck]


def _mug() -> Parts:
    """Hollow, with a handle towards +x that leaves a hole: a half ellipse swept by a rectangle."""
    inner, outer, height = 0.030, 0.034, 0.090
    angle = np.linspace(0.5 * np.pi, -0.5 * np.pi, 13)
    x, z = 0.032 + 0.032 * np.cos(angle), 0.046 + 0.028 * np.sin(angle)
    normal = np.stack([np.cos(angle) / 0.032, np.zeros_like(angle), np.sin(angle) / 0.028], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    across = np.array([[0.004, 0.006], [0.004, -0.006], [-0.004, -0.006], [-0.004, 0.006]])
    centre = np.stack([x, np.zeros_like(x), z], axis=-1)
    sections = centre[:, None] + across[:, :1] * normal[:, None] + across[:, 1:] * np.array([0.0, 1.0, 0.0])
    base = revolved([(outer - 0.002, 0.0), (outer, 0.002), (outer, 0.005)])
    return [base, *tube(inner, outer, 0.005, height), *loft(sections)]


_BUILDERS: dict[str, tuple[Callable[[], Parts], float, float]] = {  # name: pieces, mass [kg], friction [-]
    "banana": (_banana, 0.13, 0.7),
    "bottle": (_bottle, 0.35, 0.7),
    "box": (_box, 0.25, 0.6),
    "can": (_can, 0.30, 0.6),
    "drill": (_drill, 0.40, 0.7),
    "mug": (_mug, 0.25, 0.6),
}

OBJECT_NAMES: tuple[str, ...] = tuple(sorted(_BUILDERS))


@cache
def object_model(name: str) -> ObjectModel:
    """Return the object of that ``name``, one of `OBJECT_NAMES`; raise `UnknownName`."""
    if name not in _BUILDERS:
        raise UnknownName("object", name, OBJECT_NAMES)
    build, mass, friction = _BUILDERS[name]
    parts = build()
    return ObjectModel(name, union(parts), tuple(parts), mass, friction)
