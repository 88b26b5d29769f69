"""The visible surfaces of an arm's links, coarse enough to be sent and drawn, and where they are."""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio
from numpy.typing import ArrayLike

from optsc.collision.link_shapes import LinkShapes
from optsc.geometry import Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.robot.model import RobotModel

CELL = 0.006
"""Size of the cubes whose vertices become one [m]: a Panda of 135,000 triangles then has 37,000."""
_ROUND = 24


class LinkVisual(NamedTuple):
    """A visible surface of a link.

    Attributes:
        link: name of the link.
        mesh: in the surface's own frame V.
        colour: red, green, blue and opacity, each in [0, 1].
        given: whether the description names the colour; else it is only a default.
    """

    link: str
    mesh: TriangleMesh
    colour: tuple[float, float, float, float]
    given: bool


class LinkVisuals:
    """The visible surfaces of a whole description, jaws included.

    Args:
        robot: the arm.
        cell: size of the cubes of the clustering [m], see `TriangleMesh.clustered`.

    Attributes:
        visuals: the surfaces.
        hand: which of them belong to the hand: the fingers and the link that carries them.

    Raises:
        DamagedFile: the description or one of its meshes cannot be read.
    """

    def __init__(self, robot: RobotModel, cell: float = CELL) -> None:
        self._shapes = shapes = LinkShapes(robot, visual=True)
        self._robot, self._data = robot, (shapes.model.createData(), shapes.geometry.createData())
        drawn = [(i, mesh) for i, shape in enumerate(shapes.shapes) if (mesh := _mesh(shape, cell)) is not None]
        self._drawn = [i for i, _ in drawn]
        self.visuals = tuple(
            LinkVisual(shapes.links[i], mesh, _colour(shapes.shapes[i]), bool(shapes.shapes[i].overrideMaterial))
            for i, mesh in drawn
        )
        self.hand = tuple(k for k, i in enumerate(self._drawn) if i in shapes.hand)

    def placements(self, q: ArrayLike, opening: float) -> Array:
        """Return position and quaternion (w, x, y, z) of each surface in W (L, 7).

        Args:
            q: configuration of the arm (n,) [rad].
            opening: distance between the pads [m], brought into the jaws' range.
        """
        widest = 0.0 if self._robot.gripper is None else self._robot.gripper.max_opening
        full = self._shapes.configurations(np.asarray(q, dtype=float)[None], np.clip(opening, 0.0, widest))[0]
        data, placed = self._data
        pinocchio.updateGeometryPlacements(self._shapes.model, data, self._shapes.geometry, placed, full)
        rows = np.array([pinocchio.SE3ToXYZQUAT(placed.oMg[i]) for i in self._drawn]).reshape(-1, 7)
        return rows[:, [0, 1, 2, 6, 3, 4, 5]]

    def in_hand(self, opening: float) -> Array:
        """Return position and quaternion of each surface of the hand in the tool frame T (H, 7)."""
        q = self._robot.home
        X_TW = self._robot.forward(q).inverse()
        rows = self.placements(q, opening)[list(self.hand)]
        X_TV = X_TW @ Pose(rows[:, 3:], rows[:, :3])
        return np.hstack([X_TV.translation, X_TV.quaternion])


def _colour(shape: Any) -> tuple[float, float, float, float]:
    r, g, b, a = (float(part) for part in shape.meshColor)
    return r, g, b, a


def _mesh(shape: Any, cell: float) -> TriangleMesh | None:
    """Return the surface of a shape; None for one that has none, such as a plane."""
    geometry = shape.geometry
    if isinstance(geometry, coal.BVHModelBase):
        corners = [geometry.tri_indices(i) for i in range(geometry.num_tris)]
        faces = [[corner[0], corner[1], corner[2]] for corner in corners]
        if not faces:
            return None
        return TriangleMesh(np.asarray(geometry.vertices()), np.array(faces)).clustered(cell)
    import trimesh

    if isinstance(geometry, coal.Box):
        made = trimesh.creation.box(2.0 * np.asarray(geometry.halfSide))
    elif isinstance(geometry, coal.Sphere):
        made = trimesh.creation.icosphere(2, geometry.radius)
    elif isinstance(geometry, coal.Cylinder):
        made = trimesh.creation.cylinder(geometry.radius, 2.0 * geometry.halfLength, _ROUND)
    elif isinstance(geometry, coal.Capsule):
        made = trimesh.creation.capsule(2.0 * geometry.halfLength, geometry.radius, count=(_ROUND, _ROUND))
        made.apply_translation([0.0, 0.0, -made.bounds.mean(axis=0)[2]])
    else:
        return None
    return TriangleMesh(made.vertices, made.faces)
