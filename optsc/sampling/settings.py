"""The numbers that decide which grasps are kept."""

from __future__ import annotations

from dataclasses import dataclass, fields

from optsc.errors import require_within


@dataclass(frozen=True)
class AntipodalSettings:
    """Settings of `sample_grasps` and `detect_grasps`; the defaults are for exact surfaces.

    Attributes:
        count: grasps wanted per object.
        friction: Coulomb coefficient [-] whose cone both contacts have to lie in.
        standoff: length of the straight approach along the tool's z axis that has to be free [m].
        clearance: distance that the gripper keeps from the object until it closes [m].
        table_clearance: distance that the gripper keeps from the table [m].
        lowest_elevation: smallest angle above the horizontal from which the hand may come [rad].
        min_coverage: share of each pad's area that has to carry load [-].
        max_eccentricity: greatest distance of the load's middle from the pad's middle, in half pad sizes [-].
        min_alignment: smallest cosine between the closing axis and the mean normal under a pad [-].
        max_lever: greatest lever with which gravity may turn the object between the pads [m]: the distance of
            its centre of mass from the vertical plane through the closing axis.
        spacing: mean distance of the surface points that all checks use [m].
        noise: root mean square error of the surface's points [m]; contacts and margins allow for twice as much.
        torsion: radius [m] at which a pad's friction resists turning about its normal, for the wrenches.
        position_error: standard deviation, per axis, of the errors that a robust grasp bears [m].
        angle_error: the same of rotations, per axis [rad].
        perturbations: poses with such errors that each grasp is tried at, in geometry.
        min_robustness: share of them that has to hold as well [-].
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
    noise: float = 0.0
    torsion: float = 0.005
    position_error: float = 0.002
    angle_error: float = 0.03
    perturbations: int = 8
    min_robustness: float = 0.5
    pool: int = 5
    max_rounds: int = 60

    def __post_init__(self) -> None:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        counts = {field.name for field in fields(self) if isinstance(field.default, int)}
        usual = {name: (1, 1_000_000) if name in counts else (0.0, 1.0) for name in values}
        require_within("AntipodalSettings", values, usual | _RANGES)

    @classmethod
    def for_clouds(cls, count: int = 150) -> AntipodalSettings:
        """Return settings for measured points, whose normals are estimates and whose errors show."""
        return cls(
            count=count,
            min_alignment=0.94,
            min_coverage=0.10,
            max_eccentricity=0.7,
            spacing=0.0025,
            max_rounds=40,
        )


_RANGES: dict[str, tuple[float, float]] = {  # others: counts from 1 up, shares and lengths [m] from 0 to 1
    "friction": (0.01, 10.0),
    "lowest_elevation": (0.0, 1.57),
    "max_lever": (0.001, 1.0),
    "spacing": (0.0001, 0.1),
    "noise": (0.0, 0.01),
    "torsion": (0.0001, 0.1),
    "position_error": (0.0, 0.1),
}
