"""What an object is to the rest of the library: a surface to look at and convex pieces to touch."""

from __future__ import annotations

from dataclasses import dataclass

from optsc.errors import InvalidValue
from optsc.geometry import TriangleMesh


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A rigid object in its own frame O: origin at the centre of its base, z up, base on z = 0.

    So ``X_WO`` without a rotation and with z = 0 stands on the table.

    Attributes:
        name: key in `OBJECT_NAMES`, or one's own.
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
        for field, value in (("mass", self.mass), ("friction", self.friction)):
            if not 0.0 < value < float("inf"):
                raise InvalidValue(f"{field} of object {self.name}", value, "finite, above 0")
        if not self.parts:
            raise InvalidValue(f"parts of object {self.name}", (), "at least one convex piece")
