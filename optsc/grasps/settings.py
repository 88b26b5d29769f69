"""The numbers that decide which grasps are kept."""

from __future__ import annotations

from dataclasses import dataclass, fields

from optsc.errors import InvalidValue


@dataclass(frozen=True)
class AntipodalSettings:
    """Settings of `sample_grasps`.

    Attributes:
        count: grasps wanted per object.
        friction: Coulomb coefficient [-] whose cone both contacts have to lie in.
        standoff: length of the straight approach along the tool's z axis that has to be free [m].
        clearance: distance that the gripper keeps from the object until it closes [m].
        table_clearance: distance that the gripper keeps from the table, z = 0 in the object's frame [m].
        lowest_elevation: smallest angle above the horizontal from which the hand may come [rad].
        min_coverage: share of each pad's area that has to carry load [-].
        max_eccentricity: greatest distance of the load's middle from the pad's middle, in half pad sizes [-].
        min_alignment: smallest cosine between the closing axis and the mean normal under a pad [-].
        max_lever: greatest lever with which gravity may turn the object between the pads [m]: the distance of
            its centre of mass from the vertical plane through the closing axis.
        spacing: mean distance of the surface points that all checks use [m].
        pool: sound grasps to gather for each one wanted, so that there is something to choose from.
        max_rounds: after so many rounds of sampling the pool is taken as it is.
    """

    count: int = 150
    friction: float = 0.5
    standoff: float = 0.10
    clearance: float = 0.003
    table_clearance: float = 0.003
    lowest_elevation: float = 0.0
    min_coverage: float = 0.2
    max_eccentricity: float = 0.6
    min_alignment: float = 0.99
    max_lever: float = 0.06
    spacing: float = 0.002
    pool: int = 8
    max_rounds: int = 60

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            low, high = _RANGES.get(
                field.name, (1, 1_000_000) if isinstance(field.default, int) else (0.0, 1.0)
            )
            if not low <= value <= high:
                raise InvalidValue(f"AntipodalSettings.{field.name}", value, f"{low:g} to {high:g}")


_RANGES = {  # all others: counts from 1 up, shares and lengths [m] from 0 to 1
    "friction": (0.01, 10.0),
    "lowest_elevation": (0.0, 1.57),
    "max_lever": (0.001, 1.0),
    "spacing": (0.0001, 0.1),
}
