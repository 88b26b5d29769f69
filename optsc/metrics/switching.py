"""What happens at a change of mode: the jump that shared control is to avoid."""

from __future__ import annotations

from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.metrics.checks import finite, positive


class SwitchJump(NamedTuple):
    """The jump at one change of mode, in five parts.

    Steps of pose and velocity are of the controller's own making: a bumpless one has none, but for the motion
    of one tick. The distances to the target are what a good choice of the grasp makes small.

    Attributes:
        position_step: distance between the last tool position before and the first after the switch [m].
        rotation_step: the same for the orientation [rad].
        velocity_step: difference of the tool's velocities just after and just before [m/s].
        angular_velocity_step: the same for its angular velocities [rad/s].
        peak_acceleration: greatest acceleration of the tool within the window about the switch [m/s^2].
        peak_jerk: greatest jerk there [m/s^3].
        target_distance: from the tool to the new target at the switch [m], the paper's d_l; NaN without one.
        target_chord: distance of their quaternions [-], the paper's d_a, at most sqrt(2); NaN without one.
        joint_step: greatest change of one joint's command at the switch [rad].
        branch_flip: whether some joint's command jumps within the window further than an arm moves in a tick:
            the inverse kinematics changed to another of its solutions.
    """

    position_step: float
    rotation_step: float
    velocity_step: float
    angular_velocity_step: float
    peak_acceleration: float
    peak_jerk: float
    target_distance: float
    target_chord: float
    joint_step: float
    branch_flip: bool


def switch_indices(mode: ArrayLike) -> NDArray[np.intp]:
    """Return the indices (M,) of the samples whose ``mode`` (N,) differs from that of the sample before."""
    values = np.asarray(mode)
    if values.ndim != 1:
        raise InvalidValue("mode", values.shape, "shape (N,)")
    return np.flatnonzero(values[1:] != values[:-1]) + 1


def switch_jump(
    index: int,
    rate: float,
    X_WT: Pose,
    q: ArrayLike,
    target: Pose | None = None,
    window: float = 0.5,
    branch_step: float = 0.5,
) -> SwitchJump:
    """Return the jump at the switch to sample ``index``, the first of the new mode.

    Args:
        index: at least two samples after the first and one before the last.
        rate: of the samples [Hz].
        X_WT: commanded tool poses (N,).
        q: joint commands (N, n) [rad].
        target: what the tool heads for in the new mode.
        window: how far before and after the switch acceleration, jerk and branch are looked at [s].
        branch_step: joint step that counts as a change of branch [rad]; ours, no arm does it in one tick.

    Velocities are differences of neighbouring samples on one side of the switch, so that a step of the
    position is not counted as one of the velocity as well. Raises `InvalidValue` for NaN, for shapes that do
    not fit and for an index too near an end.
    """
    p = finite("tool positions", X_WT.translation, 3)
    r = rotation.checked(finite("tool orientations", X_WT.quaternion, 4), "tool orientations")
    joints = finite("joint commands", q)
    if len(joints) != len(p):
        raise InvalidValue("joint commands", joints.shape, f"one row for each of the {len(p)} tool poses")
    if not 2 <= index <= len(p) - 2:
        raise InvalidValue("index of the switch", index, f"2 to {len(p) - 2}")
    reach = round(positive("window", window) * positive("rate", rate))
    about = slice(max(index - reach, 0), index + reach + 1)
    before, after = slice(index - 2, index), slice(index, index + 2)
    distance = chord = nan
    if target is not None:
        distance = float(np.linalg.norm(target.translation - p[index]))
        chord = float(rotation.chord(target.quaternion, r[index]))
    return SwitchJump(
        position_step=float(np.linalg.norm(p[index] - p[index - 1])),
        rotation_step=float(rotation.angle(r[index], r[index - 1])),
        velocity_step=rate * float(np.linalg.norm(np.diff(p[after], axis=0) - np.diff(p[before], axis=0))),
        angular_velocity_step=rate * float(np.linalg.norm(_turn(r[after]) - _turn(r[before]))),
        peak_acceleration=_peak(p[about], rate, 2),
        peak_jerk=_peak(p[about], rate, 3),
        target_distance=distance,
        target_chord=chord,
        joint_step=float(np.max(np.abs(joints[index] - joints[index - 1]))),
        branch_flip=bool(np.max(np.abs(np.diff(joints[about], axis=0))) > branch_step),
    )


def _turn(r: Array) -> Array:
    return rotation.log(rotation.multiply(r[1], rotation.conjugate(r[0])))


def _peak(p: Array, rate: float, order: int) -> float:
    return rate**order * float(np.max(np.linalg.norm(np.diff(p, order, axis=0), axis=1)))
