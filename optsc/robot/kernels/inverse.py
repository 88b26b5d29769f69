"""An attempt to solve the inverse kinematics as one CasADi function, all iterations inside.

An iteration is a Levenberg-Marquardt step. With the pose error e = (p* - p, log(R* Rᵀ)), weights W, and the
Jacobian J without the columns of joints that stand at a limit and are pushed outward,

    dq = Jᵀ (J Jᵀ + λ W⁻¹)⁻¹ e,    λ = DAMPING eᵀ W e + FLOOR,

which is the damping of T. Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt
method", IEEE T-RO 27(5), 2011: it fades with the error, so that convergence is quadratic, and needs no
acceptance test. The step is shortened to `LONGEST_STEP` and projected onto the limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi

from optsc.robot.kernels.kinematics import chain
from optsc.robot.model import RobotModel

LENGTH = 0.2
"""An error of one radian weighs as much as one of this many metres (W)."""
DAMPING = 0.05
FLOOR = 1e-10
LONGEST_STEP = 1.0
"""Greatest change of a joint in one iteration [rad or m]."""
FALL, PATIENCE = 0.9, 4
"""An attempt is given up when eᵀ W e does not fall below FALL times its best for more than PATIENCE
iterations: a new start is worth more than patience."""
ITERATIONS = 40
"""Greatest number of iterations of an attempt; a multiple of _BLOCK."""
_BLOCK = 10

IDLE, RUNNING, SOLVED, GIVEN_UP = 0, 1, 2, 3
"""Status of an attempt. Only one that is RUNNING costs time."""

STATE_ROWS = 5
"""Rows of an attempt's state after the posture, see `attempt`."""


@dataclass
class _State:
    """The rows of an attempt's state, see `attempt`."""

    q: casadi.SX
    status: casadi.SX
    least: casadi.SX
    stalled: casadi.SX
    iterations: casadi.SX
    residual: casadi.SX

    @classmethod
    def unpack(cls, rows: casadi.SX, n: int) -> _State:
        return cls(rows[:n], *(rows[n + i] for i in range(STATE_ROWS)))

    def pack(self) -> casadi.SX:
        return casadi.vertcat(self.q, self.status, self.least, self.stalled, self.iterations, self.residual)


def rotation_vector(D: casadi.SX) -> casadi.SX:
    """Return the rotation vector (3,) [rad], at most π long, of a rotation matrix.

    At half a turn D - Dᵀ vanishes, and with it what it says about the axis: the length is right there, and
    the axis is x.
    """
    v = 0.5 * casadi.vertcat(D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1])
    sine, cosine = casadi.sqrt(casadi.dot(v, v)), 0.5 * (casadi.trace(D) - 1)
    angle = casadi.atan2(sine, cosine)
    # The tiny number keeps the quotient finite where there is no rotation; v is zero there.
    vector = v * (angle / (sine + 1e-200))
    half_turn = casadi.logic_and(cosine < 0, sine < 1e-8)
    return casadi.vertcat(casadi.if_else(half_turn, angle, vector[0]), vector[1], vector[2])


def rotation_matrix(quaternion: casadi.SX) -> casadi.SX:
    """Return the rotation matrix (3, 3) of a unit quaternion w, x, y, z."""
    w, x, y, z = casadi.vertsplit(quaternion)
    return casadi.blockcat(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _free(q: casadi.SX, gradient: casadi.SX, lower: casadi.SX, upper: casadi.SX) -> casadi.SX:
    """Return 1 for each joint that may move, 0 for one that stands at a limit and is pushed against it."""
    at_lower = casadi.logic_and(q <= lower, gradient < 0)
    at_upper = casadi.logic_and(q >= upper, gradient > 0)
    return casadi.if_else(casadi.logic_or(at_lower, at_upper), 0, 1)


def _damped_step(J: casadi.SX, error: casadi.SX, inverse_weights: casadi.SX, damping: casadi.SX) -> casadi.SX:
    """Return the step (n,), with the smaller of the two equivalent linear systems."""
    rows, n = J.shape
    if n >= rows:
        A, b = J @ J.T + damping * casadi.diag(inverse_weights), error
    else:
        scaled = J.T @ casadi.diag(1 / inverse_weights)
        A, b = scaled @ J + damping * casadi.SX.eye(n), scaled @ error
    D, LT, permutation = casadi.ldl(A, False)
    x = casadi.ldl_solve(b, D, LT, permutation)
    return J.T @ x if n >= rows else x


def iteration(robot: RobotModel) -> casadi.Function:
    """Return the function (state, target and tolerance, limits) -> state of one Levenberg-Marquardt step."""
    n = robot.n
    rows = casadi.SX.sym("state", n + STATE_ROWS)
    target = casadi.SX.sym("target", 8)
    limits = casadi.SX.sym("limits", 2 * n)
    lower, upper = limits[:n], limits[n:]
    state = _State.unpack(rows, n)
    R, p, J = chain(robot, state.q)
    error = casadi.vertcat(target[4:7] - p, rotation_vector(rotation_matrix(target[:4]) @ R.T))
    inverse_weights = casadi.SX([1.0] * 3 + [LENGTH**-2] * 3)
    weighted = error / inverse_weights
    cost = casadi.dot(error, weighted)
    free = _free(state.q, J.T @ weighted, lower, upper)
    J = casadi.horzcat(*(J[:, i] * free[i] for i in range(n)))
    step = _damped_step(J, error, inverse_weights, DAMPING * cost + FLOOR)
    step = step * casadi.fmin(1, LONGEST_STEP / (casadi.norm_inf(step) + 1e-200))
    fell = cost < FALL * state.least
    residual = casadi.norm_inf(error)
    stalled = casadi.if_else(fell, 0, state.stalled + 1)
    hopeless = casadi.logic_or(stalled > PATIENCE, state.iterations >= ITERATIONS - 1)
    status = casadi.if_else(residual <= target[7], SOLVED, casadi.if_else(hopeless, GIVEN_UP, RUNNING))
    moved = casadi.fmin(casadi.fmax(state.q + step, lower), upper)
    after = _State(
        # The residual belongs to the posture that is returned, so the last iteration does not move.
        q=casadi.if_else(status == RUNNING, moved, state.q),
        status=status,
        least=casadi.if_else(fell, cost, state.least),
        stalled=stalled,
        iterations=state.iterations + 1,
        residual=residual,
    )
    return casadi.Function("iteration", [rows, target, limits], [casadi.densify(after.pack())])


def _repeat_while_running(step: casadi.Function, times: int, n: int, name: str) -> casadi.Function:
    """Return the function that applies ``step`` ``times`` times, or until the attempt has ended."""
    arguments = [casadi.MX.sym(step.name_in(i), step.sparsity_in(i)) for i in range(step.n_in())]
    state, *others = arguments
    unchanged = casadi.Function(f"{name}_unchanged", arguments, [state])
    by_status = casadi.Function.conditional(f"{name}_by_status", [unchanged, step], unchanged)
    for _ in range(times):
        state = by_status(state[n], state, *others)
    return casadi.Function(name, arguments, [state])


def attempt(robot: RobotModel) -> casadi.Function:
    """Return the function (state, target, limits) -> state of one attempt, from its start to its end.

    * state (n + STATE_ROWS), in and out: posture; status (`IDLE`, `RUNNING`, `SOLVED`, `GIVEN_UP`); least
      cost so far, infinite at the start; iterations since it last fell; iterations; and the residual: the
      largest component of the pose error [m or rad] at the posture. Starts must lie inside the limits.
    * target (8): unit quaternion w, x, y, z, position [m], tolerance of the residual.
    * limits (2 n): lower, then upper positions, infinite where there are none.
    """
    block = _repeat_while_running(iteration(robot), _BLOCK, robot.n, "block")
    blocks = _repeat_while_running(block, ITERATIONS // _BLOCK, robot.n, "blocks")
    return _repeat_while_running(blocks, 1, robot.n, "attempt")
