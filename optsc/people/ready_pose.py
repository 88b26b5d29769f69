"""Ready poses: where a person would like the tool before letting the robot take over."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import atan2, cos, pi, sin

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.people.parameters import AimParameters


@dataclass(frozen=True)
class Aim:
    """A ready pose relative to an object, so that it follows an object that is moved.

    Attributes:
        elevation: angle of the approach above the horizontal [rad]; pi/2 is from straight above.
        azimuth: about the vertical, from the direction base-object [rad].
        distance: tool to the object's middle [m].
        roll: of the closing axis out of the horizontal [rad].
        flipped: whether the jaws are exchanged, the same grasp for a parallel gripper.
    """

    elevation: float
    azimuth: float
    distance: float
    roll: float
    flipped: bool = False

    def pose(self, X_WO: Pose, middle: float) -> Pose:
        """Return the tool pose X_WT; the robot's base stands at the world's origin.

        Tool z points at the object's middle, ``middle`` [m] above the centre of its base; tool y, the closing
        axis, is horizontal but for the roll.
        """
        centre = X_WO.apply([0.0, 0.0, middle])
        bearing = atan2(centre[1], centre[0]) + self.azimuth
        ahead = np.array([cos(bearing), sin(bearing), 0.0])
        z = cos(self.elevation) * ahead - np.array([0.0, 0.0, sin(self.elevation)])
        y = np.array([-ahead[1], ahead[0], 0.0])
        level = rotation.from_matrix(np.column_stack([np.cross(y, z), y, z]))
        roll = self.roll + (pi if self.flipped else 0.0)
        q = rotation.multiply(level, rotation.exp([0.0, 0.0, roll]))
        return Pose(q, centre - self.distance * z)


def draw_aim(rng: np.random.Generator, X_WO: Pose, X_WT: Pose, others: Iterable[Pose], aims: AimParameters) -> Aim:
    """Return a ready pose for the object at ``X_WO``, as a person with the tool at ``X_WT`` would choose it.

    Of ``aims.draws`` random ones it is the first that keeps clear of the robot's base and of the ``others``, on the
    path there and once there, or the clearest if none does; of both equal turns of the jaws the nearer is taken.
    """
    middles = [X.apply([0.0, 0.0, aims.middle]) for X in others]

    def room(aim: Aim) -> float:
        X_WR = aim.pose(X_WO, aims.middle)
        from_base = float(np.linalg.norm(X_WR.translation[:2])) - aims.nearest
        return min(_clearance(X_WT, X_WR, middles) - aims.clearance, from_base)

    best = _random_aim(rng, aims)
    most = room(best)
    for _ in range(aims.draws - 1):
        if most >= 0.0:
            break
        aim = _random_aim(rng, aims)
        if room(aim) > most:
            best, most = aim, room(aim)
    return _with_nearer_jaws(best, X_WO, X_WT, aims)


def adjust_aim(rng: np.random.Generator, aim: Aim, X_WO: Pose, X_WT: Pose, aims: AimParameters) -> Aim:
    """Return ``aim`` changed a little within the ranges, as a person does for another attempt."""

    def moved(value: float, low: float, high: float) -> float:
        step = aims.adjustment * (high - low) * rng.uniform(-1.0, 1.0)
        return min(max(value + step, low), high)

    changed = Aim(
        elevation=moved(aim.elevation, *aims.elevation),
        azimuth=moved(aim.azimuth, -aims.azimuth, aims.azimuth),
        distance=moved(aim.distance, *aims.distance),
        roll=moved(aim.roll, -aims.roll, aims.roll),
    )
    return _with_nearer_jaws(changed, X_WO, X_WT, aims)


def _random_aim(rng: np.random.Generator, aims: AimParameters) -> Aim:
    return Aim(
        elevation=rng.uniform(*aims.elevation),
        azimuth=rng.uniform(-aims.azimuth, aims.azimuth),
        distance=rng.uniform(*aims.distance),
        roll=rng.uniform(-aims.roll, aims.roll),
    )


def _with_nearer_jaws(aim: Aim, X_WO: Pose, X_WT: Pose, aims: AimParameters) -> Aim:
    both = [Aim(aim.elevation, aim.azimuth, aim.distance, aim.roll, flipped) for flipped in (False, True)]
    turns = [float(rotation.angle(X_WT.quaternion, a.pose(X_WO, aims.middle).quaternion)) for a in both]
    return both[0] if turns[0] <= turns[1] else both[1]


def _clearance(X_WT: Pose, X_WR: Pose, middles: list[Array]) -> float:
    """Return how near [m] the others' middles are to the path and to the gripper in its ready pose."""
    if not middles:
        return np.inf
    # The first part of the path is left out: what stands beside the tool now is so for every ready pose.
    path = X_WT.interpolate(X_WR, np.linspace(0.3, 1.0, 8)).translation
    gripper = X_WR.apply(np.outer([0.0, -0.05, -0.10, -0.15], [0.0, 0.0, 1.0]))
    points = np.concatenate([path, gripper])
    return float(np.min(np.linalg.norm(points[:, None] - np.array(middles), axis=-1)))
