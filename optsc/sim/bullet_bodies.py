"""PyBullet bodies of the table and the objects: shapes, mass properties, friction."""

from __future__ import annotations

import tempfile
import zlib
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pybullet

from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.geometry.rotation import Array
from optsc.sim.bullet_client import bullet_pose
from optsc.sim.objects import ObjectModel

MARGIN = 1e-3
"""PyBullet rounds every convex mesh outwards by this much [m], which cannot be changed."""

TABLE_HALF_EXTENTS = (0.75, 0.9, 0.02)
"""Half the size of the table's top [m]."""
TABLE_CENTRE_X = 0.35
"""The arm's base stands near the table's rear edge: the middle of the top is this far in front of it [m]."""
FLOOR_HEIGHT = -0.75
"""Height of the floor below the top of the table [m]."""

_OBJECT_COLOURS = {
    "banana": (0.96, 0.82, 0.24),
    "bottle": (0.20, 0.56, 0.42),
    "box": (0.84, 0.47, 0.25),
    "can": (0.75, 0.20, 0.22),
    "drill": (0.91, 0.65, 0.13),
    "mug": (0.22, 0.42, 0.69),
}
_OTHER_COLOURS = ((0.48, 0.32, 0.64), (0.30, 0.60, 0.66), (0.62, 0.50, 0.36), (0.80, 0.45, 0.60))


class Inertia(NamedTuple):
    """Mass properties of a solid: its principal frame M in the object's frame O, moments about M's axes."""

    X_OM: Pose
    moments: Array  # (3,) [kg m^2]


def inertia(mesh: TriangleMesh, mass: float) -> Inertia:
    """Return the mass properties of a watertight ``mesh`` filled evenly with ``mass`` [kg].

    Sums over the tetrahedra between the origin and each face: D. Eberly, "Polyhedral mass properties", 2002.
    """
    corners = mesh.vertices[mesh.faces]
    volumes = np.linalg.det(corners) / 6.0
    total = corners.sum(axis=1)
    centre = volumes @ total / (4.0 * volumes.sum())
    outer = np.einsum("fki,fkj->fij", corners, corners) + np.einsum("fi,fj->fij", total, total)
    second = np.einsum("f,fij->ij", volumes, outer) / 20.0 / volumes.sum() - np.outer(centre, centre)
    moments, axes = np.linalg.eigh(mass * (np.trace(second) * np.eye(3) - second))
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return Inertia(Pose(rotation.from_matrix(axes), centre), moments)


def shrunk(part: TriangleMesh, margin: float = MARGIN) -> TriangleMesh:
    """Return a convex ``part`` with every face moved inwards by ``margin`` [m], or as it is if too thin.

    PyBullet rounds it outwards by as much, to its size again: objects then neither float above the table nor
    are wider in the hand than their surface.
    """
    from scipy.optimize import linprog
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    planes = ConvexHull(part.vertices).equations  # outward normal n and offset d of each facet: n x + d <= 0
    planes = np.unique(np.round(planes, 9), axis=0)
    planes[:, 3] += margin
    # The middle of the largest ball inside: maximise r subject to n x + r + d <= 0.
    inside = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.insert(planes[:, :3], 3, 1.0, axis=1),
        b_ub=-planes[:, 3],
        bounds=[(None, None)] * 3 + [(0.0, None)],
    )
    if not inside.success or inside.x[3] < 1e-5:
        return part
    vertices = HalfspaceIntersection(planes, inside.x[:3]).intersections
    hull = ConvexHull(vertices)
    return TriangleMesh(vertices, hull.simplices)


def wavefront(parts: Iterable[TriangleMesh]) -> str:
    """Return an OBJ file with one group per part; PyBullet reads each group as one convex hull."""
    lines, first = [], 1
    for index, part in enumerate(parts):
        lines.append(f"o part{index}")
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in part.vertices.tolist()]
        lines += [f"f {a + first} {b + first} {c + first}" for a, b, c in part.faces.tolist()]
        first += len(part.vertices)
    return "\n".join(lines) + "\n"


def colour(name: str) -> tuple[float, float, float]:
    """Return the colour of an object in pictures: the same for a name everywhere."""
    return _OBJECT_COLOURS.get(name, _OTHER_COLOURS[zlib.crc32(name.encode()) % len(_OTHER_COLOURS)])


@lru_cache(maxsize=32)
def _collision_text(model: ObjectModel) -> str:
    return wavefront(shrunk(part) for part in model.parts)


def add_object(client: int, model: ObjectModel, X_WO: Pose, *, visible: bool = False) -> int:
    """Put an object into the simulation ``client`` and return its body.

    It is touched as its convex pieces and, if ``visible``, seen as its exact surface. PyBullet reports
    the pose of the principal frame M of its mass, see `inertia`, not of O.
    """
    mass_frame = inertia(model.mesh, model.mass)
    # PyBullet would keep every mesh under its file name, and these files are never read again.
    pybullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=client)
    with tempfile.TemporaryDirectory() as folder:  # the surface is read when the body is made, not before
        body = _multibody(client, model, X_WO, mass_frame.X_OM, Path(folder), visible)
    pybullet.setPhysicsEngineParameter(enableFileCaching=1, physicsClientId=client)
    pybullet.changeDynamics(
        body,
        -1,
        localInertiaDiagonal=mass_frame.moments.tolist(),
        lateralFriction=model.friction,
        linearDamping=0.0,
        angularDamping=0.0,
        physicsClientId=client,
    )
    return body


def _multibody(client: int, model: ObjectModel, X_WO: Pose, X_OM: Pose, folder: Path, visible: bool) -> int:
    touched, seen = folder / "parts.obj", folder / "mesh.obj"
    touched.write_text(_collision_text(model))
    collision = pybullet.createCollisionShape(pybullet.GEOM_MESH, fileName=str(touched), physicsClientId=client)
    visual = -1
    if visible:
        seen.write_text(wavefront([model.mesh]))
        visual = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            fileName=str(seen),
            rgbaColor=[*colour(model.name), 1.0],
            specularColor=[0.1, 0.1, 0.1],
            physicsClientId=client,
        )
    position, orientation = bullet_pose(X_WO)
    centre, principal = bullet_pose(X_OM)
    return pybullet.createMultiBody(
        baseMass=model.mass,
        baseCollisionShapeIndex=collision,
        baseVisualShapeIndex=visual,
        basePosition=position,
        baseOrientation=orientation,
        baseInertialFramePosition=centre,
        baseInertialFrameOrientation=principal,
        physicsClientId=client,
    )


def add_table(client: int) -> tuple[int, ...]:
    """Put a table, its top at z = 0, and a floor into the simulation ``client``; return the two bodies."""
    bodies = []
    slabs = (
        (TABLE_HALF_EXTENTS, 0.0, (0.87, 0.84, 0.79)),
        ((3.0, 3.0, 0.05), FLOOR_HEIGHT, (0.62, 0.64, 0.67)),
    )
    for half_extents, top, rgb in slabs:
        shape = {"halfExtents": list(half_extents), "physicsClientId": client}
        body = pybullet.createMultiBody(
            baseMass=0.0,
            baseCollisionShapeIndex=pybullet.createCollisionShape(pybullet.GEOM_BOX, **shape),
            baseVisualShapeIndex=pybullet.createVisualShape(
                pybullet.GEOM_BOX, rgbaColor=[*rgb, 1.0], specularColor=[0.0, 0.0, 0.0], **shape
            ),
            basePosition=[TABLE_CENTRE_X, 0.0, top - half_extents[2]],
            physicsClientId=client,
        )
        # PyBullet multiplies the coefficients of two bodies: one leaves the object's own in force.
        pybullet.changeDynamics(body, -1, lateralFriction=1.0, physicsClientId=client)
        bodies.append(body)
    return tuple(bodies)
