"""Mode-switch transients: the jump at a change of control mode, which shared control is to avoid."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import Positive, require
from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.metrics.motion import Measures, Motion, finite_rows


class SwitchJump(NamedTuple):
    """The jump at one change of mode.

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
        window: how far before and after the switch acceleration, jerk and branch are measured [s].
        branch_step: joint step that counts as a change of branch [rad]; tuned here, no arm does it in one tick.

    Velocities are differences of neighbouring samples on one side of the switch, so that a step of the
    position is not counted as one of the velocity as well. Raises `InvalidValue` for NaN, for shapes that do
    not fit and for an index too near an end.
    """
    p = finite_rows("tool positions", X_WT.translation, 3)
    r = rotation.checked(finite_rows("tool orientations", X_WT.quaternion, 4), "tool orientations")
    joints = finite_rows("joint commands", q)
    if len(joints) != len(p):
        raise InvalidValue("joint commands", joints.shape, f"one row for each of the {len(p)} tool poses")
    if not 2 <= index <= len(p) - 2:
        raise InvalidValue("index of the switch", index, f"2 to {len(p) - 2}")
    require("window", window, Positive)
    require("rate", rate, Positive)
    reach = round(window * rate)
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


def jump_measures(motion: Motion, index: int, target: Pose | None = None) -> Measures:
    """Return the parts of the jump at tick ``index``, the first of a new mode; NaN too near an end."""
    names = [
        "jump_position_m",
        "jump_rotation_rad",
        "jump_velocity_m_s",
        "jump_angular_velocity_rad_s",
        "jump_acceleration_m_s2",
        "jump_jerk_m_s3",
        "jump_target_distance_m",
        "jump_target_chord",
        "jump_joint_rad",
        "jump_branch_flip",
    ]
    if not 2 <= index <= len(motion) - 2:
        return dict.fromkeys(names, nan)
    jump = switch_jump(index, motion.rate, motion.X_WT, motion.q, target)
    return dict(zip(names, map(float, jump), strict=True))


def worst_jumps(motion: Motion, targets: Sequence[Pose | None] | None = None) -> Measures:
    """Return the worst of each part of `jump_measures` over all changes of mode; NaN where there is none.

    ``targets`` (N,) are what the tool heads for at each tick, None where there is nothing: the one of the first tick
    of the new mode counts. Without them the distances to the target are NaN. The worst of the parts need not be of
    the same change. Raises `InvalidValue` unless there is one for each tick.
    """
    if targets is not None and len(targets) != len(motion):
        raise InvalidValue("targets", len(targets), f"{len(motion)}, one for each tick")
    row: Measures = jump_measures(motion, -1)
    changes = [i for i in range(1, len(motion)) if motion.modes[i] != motion.modes[i - 1]]
    jumps = [jump_measures(motion, index, None if targets is None else targets[index]) for index in changes]
    for name in row:
        values = [jump[name] for jump in jumps if jump[name] == jump[name]]
        row[name] = max(values) if values else nan
    return row
