"""The damped Newton (Levenberg-Marquardt) step of inverse kinematics, as CasADi expressions.

With the pose error e = (p* - p, log(R* Rᵀ)), weights W, and the Jacobian J without the columns of joints that stand
at a limit and are pushed outward,

    dq = Jᵀ (J Jᵀ + λ W⁻¹)⁻¹ e,    λ = DAMPING eᵀ W e + FLOOR,

which is the damping of T. Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method",
IEEE T-RO 27(5), 2011: it fades with the error, so that convergence is quadratic, and needs no acceptance test.
"""

from __future__ import annotations

import casadi

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


def without_blocked(
    J: casadi.SX, q: casadi.SX, gradient: casadi.SX, lower: casadi.SX, upper: casadi.SX
) -> casadi.SX:
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
