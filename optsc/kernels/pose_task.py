"""The tool's task of one differential inverse kinematics tick: a quadratic cost in the joint velocity, in CasADi."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import casadi

from optsc.kernels import rotations
from optsc.kernels.chain import Chain, tool_kinematics
from optsc.kernels.reference import at_most
from optsc.kernels.symbols import symbols

GRIP = 0.8
"""Share of a dead band that is entirely free; over the rest the component is taken hold of."""


class PoseTaskSettings:
    """Layout of the settings vector of `pose_task`; see `optsc.ik.differential` for meaning and units."""

    SIZE = 23
    WEIGHTS = slice(0, 6)
    GAIN = slice(6, 8)
    LARGEST_ERROR = slice(8, 10)
    POSTURE_WEIGHT = 10
    POSTURE_GAIN = 11
    DAMPING = 12
    ERROR_DAMPING = 13
    TOLERANCE = slice(14, 20)
    BRAKING = slice(20, 22)
    SMOOTHNESS = 22


def pose_task(chain: Chain, endless: Sequence[bool] = ()) -> casadi.Function:
    """Return the quadratic cost of one tick in the joint velocity.

    Inputs: q (n); reference (7) = p, quaternion of T in W; twist (6), linear over angular, in W; posture (n);
    onward (n), the joint velocity that goes on smoothly; settings
    (23), see `PoseTaskSettings`. Outputs: H (n, n) and g (n) of 1/2 v'Hv + g'v; pose error (6) beyond the
    tolerances, reference minus present, in T's axes [m, rad]; sqrt(det(J J')) or, below six joints, sqrt(det(J'J)).
    ``endless`` joints go the shorter way to the posture.
    """
    n = chain.n
    size = PoseTaskSettings.SIZE
    inputs = symbols(casadi.SX, q=n, reference=7, twist=6, posture=n, onward=n, settings=size)
    q, reference, twist, posture, onward, s = inputs
    R, p, J = tool_kinematics(chain, q)
    turn = rotations.smooth_from_matrix(R.T @ rotations.to_matrix(reference[3:7]))
    error = casadi.vertcat(R.T @ (reference[0:3] - p), turn)
    error, hold = _beyond(error, s[PoseTaskSettings.TOLERANCE])
    gain, largest = s[PoseTaskSettings.GAIN], s[PoseTaskSettings.LARGEST_ERROR]
    braking = s[PoseTaskSettings.BRAKING]
    pull = casadi.vertcat(_pull(error[:3], gain[0], braking[0]), _pull(error[3:], gain[1], braking[1]))
    wanted = casadi.vertcat(R.T @ twist[:3], R.T @ twist[3:]) + pull
    tool_J = casadi.vertcat(R.T @ J[:3, :], R.T @ J[3:, :])
    weight = hold * s[PoseTaskSettings.WEIGHTS]
    weighted_J = casadi.repmat(weight, 1, n) * tool_J
    posture_weight = s[PoseTaskSettings.POSTURE_WEIGHT]
    # Levenberg-Marquardt damping that grows with the error (Sugihara 2011): next to nothing while the tool is on its
    # reference, and calm where a target is out of reach and the Jacobian loses a direction.
    weighted_error = (
        weight[:3] * at_most(error[:3], largest[0]),
        weight[3:] * at_most(error[3:], largest[1]),
    )
    square = casadi.dot(weighted_error[0], weighted_error[0]) + casadi.dot(weighted_error[1], weighted_error[1])
    damping = s[PoseTaskSettings.DAMPING] + s[PoseTaskSettings.ERROR_DAMPING] * square
    H = weighted_J.T @ weighted_J + (posture_weight + damping) * casadi.SX.eye(n)
    homeward = s[PoseTaskSettings.POSTURE_GAIN] * _difference(posture, q, endless)
    smoothness = s[PoseTaskSettings.SMOOTHNESS]
    H = H + smoothness * casadi.SX.eye(n)
    g = -weighted_J.T @ (weight * wanted) - posture_weight * homeward - smoothness * onward
    gram = tool_J @ tool_J.T if n >= 6 else tool_J.T @ tool_J
    volume = casadi.sqrt(_determinant(gram))
    outputs = [casadi.densify(x) for x in (H, g, error, volume)]
    return casadi.Function("pose_task", inputs, outputs)


def _difference(to: casadi.SX, start: casadi.SX, endless: Sequence[bool]) -> casadi.SX:
    """Return how far each joint is from ``to`` (n); without whole turns of endless ones."""
    gap = [to[i] - start[i] for i in range(to.numel())]
    for i, turns in enumerate(endless):
        if turns:
            gap[i] = gap[i] - 2.0 * pi * casadi.floor(gap[i] / (2.0 * pi) + 0.5)
    return casadi.vertcat(*gap)


def _pull(error: casadi.SX, gain: casadi.SX, braking: casadi.SX) -> casadi.SX:
    """Return the velocity towards the reference: in proportion to the error, but never faster than can be braked.

    A joint that has fallen behind because it could not accelerate more cannot decelerate more either. Pulled back by
    proportion alone it overshoots, and goes on doing so.
    """
    size = casadi.sqrt(casadi.dot(error, error) + 1e-300)
    return error * casadi.fmin(gain, casadi.sqrt(braking / size))


def _beyond(error: casadi.SX, tolerance: casadi.SX) -> tuple[casadi.SX, casadi.SX]:
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
