"""The damped Newton (Levenberg-Marquardt) step of inverse kinematics and its pose errors, as CasADi expressions.

With the pose error e = (p* - p, log(R* Rᵀ)), weights W, and the Jacobian J without the columns of joints that stand
at a limit and are pushed outward,

    dq = Jᵀ (J Jᵀ + λ W⁻¹)⁻¹ e,    λ = DAMPING eᵀ W e + FLOOR,

which is the damping of T. Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method",
IEEE T-RO 27(5), 2011: it fades with the error, so that convergence is quadratic, and needs no acceptance test.
"""

from __future__ import annotations

import casadi
import numpy as np

from optsc.kernels import rotations

LENGTH = 0.2
"""An error of one radian weighs as much as one of this many metres (W)."""
WEIGHTS, INVERSE_WEIGHTS = ([1.0] * 3 + [LENGTH**k] * 3 for k in (2, -2))
"""The diagonals of W and of its inverse."""
DAMPING, FLOOR = 0.05, 1e-10
"""Square of the damping: its share of the squared error, and the least."""


def pose_error(R: casadi.SX, p: casadi.SX, target: casadi.SX) -> casadi.SX:
    """Return the error (6) of a tool at R, p to a target (7) of quaternion and position, in W's axes [m, rad]."""
    return casadi.vertcat(target[4:7] - p, rotations.from_matrix(rotations.to_matrix(target[:4]) @ R.T))


def error_norm(error: casadi.SX) -> casadi.SX:
    """Return the larger of distance [m] and angle [rad] of a pose error (6): the same in all axes."""
    distance, angle = (casadi.sqrt(casadi.dot(part, part)) for part in (error[:3], error[3:]))
    return casadi.fmax(distance, angle)


def tool_deviation(
    R_WT: casadi.SX, p_WT: casadi.SX, R_goal: casadi.SX, p_goal: casadi.SX
) -> tuple[casadi.SX, casadi.SX]:
    """Return the deviation (6,) of a tool from its target, and what turns angular velocity into its rates.

    In the target's axes: position [m], tilt about x and y, roll about z [rad]. The tilt is the rotation vector,
    in the x y plane, that takes the target's z axis to the tool's; what is left is the roll:

        D = R*ᵀ R,    tilt = acos(D₂₂) (-D₁₂, D₀₂) / √(D₀₂² + D₁₂²),    roll = atan2(D₁₀ - D₀₁, D₀₀ + D₁₁)

    Unlike the rotation vector of D, this says the same of the tilt whatever the roll is. The matrix (3, 3) maps
    angular velocity in the target's axes to the rates of tilt and roll. Where the z axes are opposite, the tilt
    is half a turn about x and the roll arbitrary.
    """
    D = R_goal.T @ R_WT
    x, y, z = D[0, 2], D[1, 2], D[2, 2]
    square = x * x + y * y
    sine = casadi.sqrt(square)
    angle = casadi.atan2(sine, z)
    aligned = casadi.logic_and(z > 0, square < 1e-8)
    # f = angle / sine as a function of the cosine z has the derivative (z f - 1) / (1 - z²), at z = 1 -1/3.
    f = casadi.if_else(aligned, 1 + square / 6, angle / (sine + 1e-200))
    slope = casadi.if_else(square < 1e-8, -1 / 3, (z * f - 1) / (square + 1e-200))
    half_turn = casadi.logic_and(z < 0, sine < 1e-8)
    f = casadi.if_else(half_turn, 0, f)
    tilt_x = casadi.if_else(half_turn, np.pi, -f * y)
    N, M = D[1, 0] - D[0, 1], D[0, 0] + D[1, 1]
    scale = M * M + N * N + 1e-200
    rates = casadi.blockcat(
        [
            [f * z - slope * y * y, slope * x * y, -f * x],
            [slope * x * y, f * z - slope * x * x, -f * y],
            [(N * D[2, 1] - M * D[2, 0]) / scale, -(M * D[2, 1] + N * D[2, 0]) / scale, 1],
        ]
    )
    deviation = casadi.vertcat(R_goal.T @ (p_WT - p_goal), tilt_x, f * x, casadi.atan2(N, M))
    return deviation, rates


def without_blocked(J: casadi.SX, q: casadi.SX, gradient: casadi.SX, lower: casadi.SX, upper: casadi.SX) -> casadi.SX:
    """Return J (6, n) with zero columns for joints that stand at a limit and are pushed against it."""
    at_lower = casadi.logic_and(q <= lower, gradient < 0)
    at_upper = casadi.logic_and(q >= upper, gradient > 0)
    free = casadi.if_else(casadi.logic_or(at_lower, at_upper), 0, 1)
    return casadi.horzcat(*(J[:, i] * free[i] for i in range(J.shape[1])))


def damped_step(J: casadi.SX, error: casadi.SX, gradient: casadi.SX, damping: casadi.SX) -> casadi.SX:
    """Return the step (n,), by the smaller of the two equivalent linear systems; ``gradient`` is Jᵀ W e."""
    rows, n = J.shape
    if n >= rows:
        A, b = J @ J.T + damping * casadi.diag(INVERSE_WEIGHTS), error
    else:
        A, b = J.T @ casadi.diag(WEIGHTS) @ J + damping * casadi.SX.eye(n), gradient
    x = casadi.ldl_solve(b, *casadi.ldl(A, False))
    return J.T @ x if n >= rows else x
