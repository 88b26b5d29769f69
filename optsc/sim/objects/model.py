"""Graspable objects: a surface to see and convex pieces to touch, also made from a user's mesh."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optsc.checks import Positive, require
from optsc.errors import InvalidValue
from optsc.geometry import TriangleMesh

if TYPE_CHECKING:
    from manifold3d import Manifold

DENSITY = 1000.0
"""Of a user's object whose mass is not known [kg/m^3]."""
FRICTION = 0.6
"""Coulomb coefficient of a user's object [-]."""

TOLERANCE = 0.00025
"""A piece may stand for its hull if what the hull adds is, spread over it, no thicker than this [m]."""
MOST_PIECES = 160

_CUTS = 9  # planes along each axis that a piece is tried to be cut at
_GAIN = 1e-3  # share of its hull's volume that a cut has to save
_DUST = 1e-12  # [m^3]; what rounding leaves behind along a cut


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A rigid object in its own frame O: origin at the centre of its base, z up, base on z = 0.

    So ``X_WO`` without a rotation and with z = 0 stands on the table.

    Attributes:
        name: key in `OBJECT_NAMES`, or a user's.
        mesh: exact, watertight surface.
        parts: convex pieces whose union is the solid inside `mesh`; they may overlap.
        mass: [kg], spread evenly over the solid.
        friction: Coulomb coefficient against rubber pads and the table [-].
    """

    name: str
    mesh: TriangleMesh
    parts: tuple[TriangleMesh, ...]
    mass: float
    friction: float

    def __post_init__(self) -> None:
        require(f"mass of object {self.name}", self.mass, Positive)
        require(f"friction of object {self.name}", self.friction, Positive)
        if not self.parts:
            raise InvalidValue(f"parts of object {self.name}", (), "at least one convex piece")


def model_from_mesh(
    name: str, mesh: TriangleMesh, *, mass: float | None = None, friction: float = FRICTION
) -> ObjectModel:
    """Return an object with the surface ``mesh``, which is given in O, and convex pieces that stand for it.

    What is hollow is cut along the axes of O until the pieces fill less of the hollow than shows (`TOLERANCE`), or
    there are `MOST_PIECES`. Pieces leave nothing of the object out. The same mesh gives the same pieces.

    Args:
        name: what it is called.
        mesh: closed, faces counter-clockwise seen from outside.
        mass: [kg]; that of `DENSITY` by default.
        friction: Coulomb coefficient [-].

    Raises:
        InvalidValue: the surface is not closed, or a mass or a friction that is not above 0.
    """
    solid = _solid(name, mesh)
    pieces = tuple(_surface(piece) for piece in _convex(solid))
    return ObjectModel(name, mesh, pieces, DENSITY * solid.volume() if mass is None else mass, friction)


def added_thickness(model: ObjectModel) -> float:
    """Return how much the pieces of a model stick out of its surface, as a layer all over it [m]."""
    from manifold3d import Manifold, OpType

    hulls = [Manifold.hull_points(part.vertices) for part in model.parts]
    whole, solid = Manifold.batch_boolean(hulls, OpType.Add), _solid(model.name, model.mesh)
    return float(max(0.0, whole.volume() - solid.volume()) / solid.surface_area())


def _solid(name: str, mesh: TriangleMesh) -> Manifold:
    from manifold3d import Error, Manifold, Mesh64

    solid = Manifold(Mesh64(mesh.vertices.copy(), mesh.faces.astype(np.uint64)))
    if solid.status() != Error.NoError or solid.is_empty() or solid.volume() <= 0.0:
        valid = "a closed surface that encloses a volume, every edge shared by two faces; mend it in a mesh editor"
        raise InvalidValue(f"surface of {name}", str(solid.status()).rpartition(".")[2], valid)
    return solid


def _surface(piece: Manifold) -> TriangleMesh:
    raw = piece.hull().to_mesh64()
    return TriangleMesh(np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts, dtype=np.int64))


def _convex(solid: Manifold) -> list[Manifold]:
    """Return pieces of a solid: always the one whose hull adds most is cut next."""
    waiting: list[tuple[float, int, Manifold]] = []
    done: list[Manifold] = []
    number = 0

    def sort_in(piece: Manifold) -> None:
        nonlocal number
        number += 1
        added = piece.hull().volume() - piece.volume()
        if added <= TOLERANCE * piece.hull().surface_area():
            done.append(piece)
        else:
            heapq.heappush(waiting, (-added, number, piece))

    for part in solid.decompose():
        sort_in(part)
    while waiting and len(waiting) + len(done) < MOST_PIECES:
        piece = heapq.heappop(waiting)[2]
        parts = _best_cut(piece)
        if not parts:
            done.append(piece)
        for part in parts:
            sort_in(part)
    return done + [piece for _, _, piece in sorted(waiting)]


def _best_cut(piece: Manifold) -> list[Manifold]:
    """Return the parts of a piece, cut where their hulls add least in all; none where no cut is of use."""
    best: list[Manifold] = []
    least = piece.hull().volume()
    low, high = np.reshape(piece.bounding_box(), (2, 3))
    for axis, normal in enumerate(np.eye(3)):
        for share in (np.arange(_CUTS) + 1.0) / (_CUTS + 1):
            offset = float(low[axis] + share * (high[axis] - low[axis]))
            halves = piece.split_by_plane(tuple(normal), offset)
            parts = [part for half in halves for part in half.decompose()]
            parts = [part for part in parts if part.volume() > _DUST]
            volume = sum(part.hull().volume() for part in parts)
            if len(parts) > 1 and volume < least * (1.0 - _GAIN):
                best, least = parts, volume
    return best
