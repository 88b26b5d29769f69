"""Objects and single views for the grasp benchmark: known ones, and PyBullet's procedural ones as unknown ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pybullet

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, PointCloud, Pose, TriangleMesh, rotation
from optsc.geometry.rotation import Array
from optsc.perception import Segment, segment_image
from optsc.robot import RobotModel
from optsc.sim import ObjectModel, Tabletop, tabletop
from optsc.sim.bullet_bodies import add_object, inertia
from optsc.sim.bullet_client import BulletClient, body_pose, place_body
from optsc.sim.camera import DepthCamera
from optsc.sim.depth_noise import DepthNoise
from optsc.sim.objects.solids import hull, union

SCALE, MASS, FRICTION = 0.015, 0.1, 0.7
"""Of the procedural objects: the scale and the mass of their files, and rubber on plastic."""


class View(NamedTuple):
    """What one depth image shows of one object."""

    segment: Segment
    image: DepthImage
    X_WO: Pose
    """Where the object truly is: only to judge with."""

    def raw(self) -> tuple[PointCloud, Array, Pose]:
        """Return the cloud in a frame U at the table under its middle, the camera's place in U (3,), and X_WU."""
        X_WU = Pose.from_translation([*self.segment.cloud.points[:, :2].mean(axis=0), 0.0])
        eye = X_WU.inverse().apply(self.image.X_WC.translation)
        return self.segment.cloud.transformed(X_WU.inverse()), eye, X_WU


def procedural_object(number: int, rng: np.random.Generator) -> ObjectModel | None:
    """Return object ``number`` (0 to 999) of `pybullet_data`'s ``random_urdfs``, at rest on a random side of it.

    Its frame has the origin at the table under the middle of its box, so that the object stands on z = 0.
    None where the file's pieces enclose nothing.
    """
    import pybullet_data

    name = f"{number:03d}"
    path = Path(pybullet_data.getDataPath(), "random_urdfs", name, f"{name}.obj")
    parts = list(_solid(SCALE * points for points in _groups(path.read_text())))
    if not parts:
        return None
    raw = ObjectModel(f"blob{name}", union(parts), tuple(parts), MASS, FRICTION)
    X = _at_rest(raw, Pose(rotation.random(rng), np.array([0.0, 0.0, 0.15])))
    placed = X.apply(raw.mesh.vertices)
    low, high = placed.min(axis=0), placed.max(axis=0)
    X = Pose.from_translation(-np.array([*(0.5 * (low + high))[:2], low[2]])) @ X
    moved = tuple(TriangleMesh(X.apply(part.vertices), part.faces) for part in parts)
    return ObjectModel(raw.name, TriangleMesh(X.apply(raw.mesh.vertices), raw.mesh.faces), moved, MASS, FRICTION)


def _solid(groups: Iterable[Array]) -> Iterator[TriangleMesh]:
    """Yield the hull of each group of points; some of the files' pieces are flat and enclose nothing."""
    for points in groups:
        try:
            yield hull(points)
        except InvalidValue:
            continue


def _groups(text: str) -> list[Array]:
    """Return the vertices of each group of an OBJ file; its convex pieces are numbered on through the file."""
    groups: list[list[list[float]]] = []
    for line in text.splitlines():
        if line.startswith("o "):
            groups.append([])
        elif line.startswith("v "):
            groups[-1].append([float(v) for v in line.split()[1:4]])
    return [np.array(points) for points in groups if points]


def _at_rest(model: ObjectModel, X_WO: Pose, longest: float = 4.0) -> Pose:
    """Return where the object comes to rest when it falls onto the plane z = 0."""
    with BulletClient() as simulation:
        client = simulation.client
        pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
        shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        pybullet.createMultiBody(0.0, shape, physicsClientId=client)
        X_OM = inertia(model.mesh, model.mass).X_OM
        body = add_object(client, model, Pose.identity())
        place_body(client, body, X_WO @ X_OM)
        for damping in (0.3, 0.0):  # without any at the end, as it will be handled
            pybullet.changeDynamics(body, -1, angularDamping=damping, physicsClientId=client)
            for _ in range(round(0.5 * longest * 240)):
                pybullet.stepSimulation(physicsClientId=client)
        return body_pose(client, body) @ X_OM.inverse()


def single_view(robot: RobotModel, model: ObjectModel, seed: int) -> View | None:
    """Return what a noisy depth camera sees of the object alone on the table; None where it finds nothing."""
    world: Tabletop = tabletop(robot, (model,), seed=seed)
    with DepthCamera(world, noise=DepthNoise()) as camera:
        view = camera.capture(robot.home, rng=np.random.default_rng(seed))
    segments, mine = segment_image(view.image).segments, view.pixels_of(model.name)
    if not segments:
        return None
    best = max(segments, key=lambda s: int((s.pixels & mine).sum()))
    return View(best, view.image, world.X_WO[model.name])
