"""The tool's task of one differential inverse kinematics tick: a quadratic cost in the joint velocity, in CasADi."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import NamedTuple

import casadi

from optsc.kernels import rotations
from optsc.kernels.chain import Chain, tool_kinematics
from optsc.kernels.reference import at_most
from optsc.kernels.symbols import symbols

LEVERS = 0.4
"""Share of the greatest lever that curvature is counted with (tuned here)."""
STOPS = 1.0
"""Share of the time that joints need to stop by which a change of their velocities counts as delayed (tuned here)."""
MISSED = 1e-3
"""Weighted error from which on spare motion is as quick as while the target moves (tuned here)."""
FOLLOWED = 1e-3
"""Damping with which the joint motion is worked out that follows the reference."""
_PARTS = slice(0, 3), slice(3, 6)
GRIP = 0.8
"""Share of a dead band that is entirely free; over the rest the component is taken hold of."""


class PoseTaskSettings:
    """Layout of the settings vector of `pose_task`; see `optsc.ik.differential` for meaning and units."""

    SIZE = 21
    WEIGHTS = slice(0, 6)
    GAIN = slice(6, 8)
    TOLERANCE = slice(8, 14)
    BRAKING = slice(14, 16)
    POSTURE_WEIGHT = 16
    POSTURE_GAIN = 17
    POSTURE_SPEED = 18
    DAMPING = 19
    SMOOTHNESS = 20


class PoseTaskInputs(NamedTuple):
    """Inputs of `pose_task`, in order: joint position, velocity and acceleration (n); reference (7) = p, quaternion of
    T in W; twist (6), linear over angular, in W; posture (n); its activity; greatest joint accelerations (n); the share
    of the acceleration that goes on [s]; settings, see `PoseTaskSettings`."""

    q: casadi.SX
    v: casadi.SX
    a: casadi.SX
    reference: casadi.SX
    twist: casadi.SX
    posture: casadi.SX
    activity: casadi.SX
    most: casadi.SX
    onward: casadi.SX
    settings: casadi.SX


def pose_task(chain: Chain, endless: Sequence[bool] = ()) -> casadi.Function:
    """Return the quadratic cost of one tick in the joint velocity; inputs as `PoseTaskInputs`.

    Outputs: H (n, n) and g (n) of 1/2 v'Hv + g'v; pose error (6) beyond the tolerances, reference minus present, in T's
    axes [m, rad]; sqrt(det(J J')) or, below six joints, sqrt(det(J'J)); the descent (n + 2): what a joint velocity
    takes off half the square of the weighted error, that square, and what the velocity asked of the tool takes off.
    ``endless`` joints go the shorter way to the posture.
    """
    n = chain.n
    sizes = {"q": n, "v": n, "a": n, "reference": 7, "twist": 6, "posture": n, "activity": 1, "most": n, "onward": 1}
    x = PoseTaskInputs(*symbols(casadi.SX, **sizes, settings=PoseTaskSettings.SIZE))
    s = x.settings
    R, p, J = tool_kinematics(chain, x.q)
    turn = rotations.smooth_from_matrix(R.T @ rotations.to_matrix(x.reference[3:7]))
    error, hold = beyond(casadi.vertcat(R.T @ (x.reference[0:3] - p), turn), s[PoseTaskSettings.TOLERANCE])
    tool_J = casadi.vertcat(R.T @ J[:3, :], R.T @ J[3:, :])
    twist = casadi.vertcat(R.T @ x.twist[:3], R.T @ x.twist[3:])
    weight = hold * s[PoseTaskSettings.WEIGHTS]
    weighted_J = casadi.repmat(weight, 1, n) * tool_J
    posture_weight = s[PoseTaskSettings.POSTURE_WEIGHT]
    plain = weighted_J.T @ weighted_J + (posture_weight + s[PoseTaskSettings.DAMPING]) * casadi.SX.eye(n)
    stopping = _stopping_time(plain, weighted_J, weight * twist, x)
    gain, braking = s[PoseTaskSettings.GAIN], s[PoseTaskSettings.BRAKING]
    pull = casadi.vertcat(*(_pull(error[k], gain[i], braking[i], stopping) for i, k in enumerate(_PARTS)))
    H = plain + _curvature(tool_J, weight * weight * pull, gain[0], stopping) * casadi.SX.eye(n)
    homeward = s[PoseTaskSettings.POSTURE_GAIN] * _difference(x.posture, x.q, endless)
    weighted_error = weight * error
    square = casadi.dot(weighted_error, weighted_error)
    activity = casadi.fmin(x.activity + casadi.sqrt(square + 1e-300) / MISSED, 1.0)
    homeward = activity * at_most(homeward, s[PoseTaskSettings.POSTURE_SPEED])
    g = -weighted_J.T @ (weight * (twist + pull)) - posture_weight * homeward
    smoothness = s[PoseTaskSettings.SMOOTHNESS]
    g = g - smoothness * (H @ (x.v + x.onward * x.a))
    H = (1.0 + smoothness) * H
    gram = tool_J @ tool_J.T if n >= 6 else tool_J.T @ tool_J
    volume = casadi.sqrt(_determinant(gram))
    weighted_error = weight * error
    descent = casadi.vertcat(
        weighted_J.T @ weighted_error,
        casadi.dot(weighted_error, weighted_error),
        casadi.dot(weighted_error, weight * pull),
    )
    outputs = [casadi.densify(y) for y in (H, g, error, volume, descent)]
    return casadi.Function("pose_task", list(x), outputs)


def _stopping_time(plain: casadi.SX, weighted_J: casadi.SX, weighted_twist: casadi.SX, x: PoseTaskInputs) -> casadi.SX:
    """Return how long [s] the joints take to brake from what they move besides the reference's own motion."""
    D, L, order = casadi.ldl(plain + FOLLOWED * casadi.SX.eye(plain.shape[0]))
    along = casadi.ldl_solve(weighted_J.T @ weighted_twist, D, L, order)
    return casadi.mmax(casadi.fabs(x.v - along) / x.most)


def _curvature(tool_J: casadi.SX, pull: casadi.SX, gain: casadi.SX, stopping: casadi.SX) -> casadi.SX:
    """Return the damping that keeps curvature from leading the joints faster than they can follow.

    The quadratic program takes the tool's motion for linear in the joints'. Its error is second order: a joint at an
    angle from where the tool can go no further is pulled there at the rate lever * pull / damping, which must not
    exceed that at which velocities can change.
    """
    lever = casadi.sqrt(casadi.mmax(casadi.sum1(tool_J[:3, :] ** 2)))
    sizes = [casadi.sqrt(casadi.dot(pull[k], pull[k]) + 1e-300) for k in _PARTS]
    return LEVERS * (lever * sizes[0] + sizes[1]) * (1.0 / gain + STOPS * stopping)


def _difference(to: casadi.SX, start: casadi.SX, endless: Sequence[bool]) -> casadi.SX:
    """Return how far each joint is from ``to`` (n); without whole turns of endless ones."""
    gap = [to[i] - start[i] for i in range(to.numel())]
    for i, turns in enumerate(endless):
        if turns:
            gap[i] = gap[i] - 2.0 * pi * casadi.floor(gap[i] / (2.0 * pi) + 0.5)
    return casadi.vertcat(*gap)


def _pull(error: casadi.SX, gain: casadi.SX, braking: casadi.SX, stopping: casadi.SX) -> casadi.SX:
    """Return the velocity towards the reference: in proportion to the error, but never faster than can be braked.

    A joint that has fallen behind because it could not accelerate more cannot decelerate more either. Pulled back by
    proportion alone it overshoots, and goes on doing so.
    """
    size = casadi.sqrt(casadi.dot(error, error) + 1e-300)
    return error * casadi.fmin(casadi.fmin(gain, casadi.sqrt(braking / size)), 1.0 / (stopping + 1e-12))


def beyond(error: casadi.SX, tolerance: casadi.SX) -> tuple[casadi.SX, casadi.SX]:
    """Return the error (6) beyond its dead band, and how firmly each component is held (6), in [0, 1].

    Inside the band a component is free. It is taken hold of over the last share of the band, so that nothing
    switches at its edge: there it follows the reference's velocity, and only beyond is it led back.
    """
    size = casadi.fabs(error)
    excess = casadi.sign(error) * casadi.fmax(size - tolerance, 0.0)
    used = size / casadi.fmax(tolerance, 1e-12)
    hold = casadi.fmin(casadi.fmax((used - GRIP) / (1.0 - GRIP), 0.0), 1.0)
    return excess, casadi.if_else(tolerance > 0.0, hold, 1.0)


def _determinant(gram: casadi.SX) -> casadi.SX:
    """Determinant of a symmetric positive matrix by LDL': far shorter code than the expansion by minors."""
    D, _, _ = casadi.ldl(gram)
    result = casadi.SX(1)
    for i in range(D.numel()):
        result = result * casadi.fmax(D[i], 0.0)
    return result
