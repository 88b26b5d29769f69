"""Settings of grasp sampling: what a grasp has to fulfil, and how many are proposed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from optsc.checks import Between, Checked

_Count = Between(1, 1_000_000)
_UpToOne = Between(0.0, 1.0)


@dataclass(frozen=True)
class AntipodalSettings(Checked):
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
        pool: feasible grasps to gather for each one wanted, so that there is something to choose from.
        max_rounds: after so many rounds of sampling the pool is taken as it is.
    """

    count: Annotated[int, _Count] = 150
    friction: Annotated[float, Between(0.01, 10.0)] = 0.5
    standoff: Annotated[float, _UpToOne] = 0.10
    clearance: Annotated[float, _UpToOne] = 0.003
    table_clearance: Annotated[float, _UpToOne] = 0.003
    lowest_elevation: Annotated[float, Between(0.0, 1.57)] = 0.0
    min_coverage: Annotated[float, _UpToOne] = 0.2
    max_eccentricity: Annotated[float, _UpToOne] = 0.6
    min_alignment: Annotated[float, _UpToOne] = 0.99
    max_lever: Annotated[float, Between(0.001, 1.0)] = 0.06
    spacing: Annotated[float, Between(0.0001, 0.1)] = 0.002
    noise: Annotated[float, Between(0.0, 0.01)] = 0.0
    torsion: Annotated[float, Between(0.0001, 0.1)] = 0.005
    position_error: Annotated[float, Between(0.0, 0.1)] = 0.002
    angle_error: Annotated[float, _UpToOne] = 0.03
    perturbations: Annotated[int, _Count] = 8
    min_robustness: Annotated[float, _UpToOne] = 0.5
    pool: Annotated[int, _Count] = 5
    max_rounds: Annotated[int, _Count] = 60

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
