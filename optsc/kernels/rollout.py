"""Leading the tool along a straight line, posture by posture, as one CasADi function.

The way from one pose to the other has straight translation and turns about one axis. It is followed in equal steps,
each from the posture of the one before, by the damped Newton iteration of `optsc.kernels.newton`, projected
onto the joint limits. So the postures stay in one branch, as those of an arm on its way do.
"""

from __future__ import annotations

import casadi
import numpy as np

from optsc.kernels import rotations
from optsc.kernels.chain import Chain, tool_kinematics
from optsc.kernels.newton import DAMPING, FLOOR, WEIGHTS, damped_step, pose_error, without_blocked

BLOCK = 8
STEPS = 8 * BLOCK
"""Steps of a way at most."""
TOLERANCE, ON_THE_WAY = 1e-5, 1e-3
"""Greatest component of the pose error at the end and after each other step [m and rad]."""
ITERATIONS = 8
"""Of one step at most; two or three are common."""


def _newton(chain: Chain) -> casadi.Function:
    """(state, target, next target, tolerance, limits) -> state (2 n + 1): posture, last posture at a target, residual.

    Where the posture is at the target, the iteration leads on to the next one: one evaluation of the kinematics both
    checks a step and begins another.
    """
    n = chain.n
    sizes = {"state": 2 * n + 1, "target": 7, "onward": 7, "tolerance": 1, "limits": 2 * n}
    state, target, onward, tolerance, limits = (casadi.SX.sym(name, size) for name, size in sizes.items())
    q, lower, upper, weights = state[:n], limits[:n], limits[n:], casadi.SX(WEIGHTS)
    R, p, J = tool_kinematics(chain, q)
    error = pose_error(R, p, target)
    residual = casadi.norm_inf(error)
    there = residual <= tolerance
    error = casadi.if_else(there, pose_error(R, p, onward), error)
    J = without_blocked(J, q, J.T @ (weights * error), lower, upper)
    damping = DAMPING * casadi.dot(error, weights * error) + FLOOR
    step = damped_step(J, error, J.T @ (weights * error), damping)
    moved = casadi.fmin(casadi.fmax(q + step, lower), upper)
    after = casadi.vertcat(moved, casadi.if_else(there, q, state[n : 2 * n]), residual)
    inputs = [state, target, onward, tolerance, limits]
    return casadi.Function("newton", inputs, [casadi.densify(after)])


def _step(chain: Chain) -> casadi.Function:
    """The same function as `_newton`, repeated until the posture is at the target."""
    n, newton = chain.n, _newton(chain)
    inputs = [casadi.MX.sym(newton.name_in(i), newton.sparsity_in(i)) for i in range(newton.n_in())]
    unchanged = casadi.Function("newton_unchanged", inputs, [inputs[0]])
    guarded = casadi.Function.if_else("newton_guarded", newton, unchanged)
    state, *others = inputs
    tolerance = others[2]
    state = newton(state, *others)
    for _ in range(ITERATIONS - 1):
        state = guarded(state[2 * n] > tolerance, state, *others)
    return casadi.Function("step", inputs, [state])


def _pose_at(share: casadi.SX, line: casadi.SX) -> casadi.SX:
    """Return quaternion and position (7) at a share of a line (13): start, shift and rotation vector."""
    half = 0.5 * share * line[10:13]
    angle = casadi.sqrt(casadi.dot(half, half) + 1e-300)
    w, v = casadi.cos(angle), casadi.sin(angle) / angle * half
    turned = rotations.multiply(casadi.vertcat(w, v), line[:4])
    return casadi.vertcat(turned, line[4:7] + share * line[7:10])


def walk(chain: Chain) -> casadi.Function:
    """Return the function (q, line, count, pace, limits, velocity) -> walked, postures.

    * q (n): where the arm stands.
    * line (13): quaternion and position of the first pose, which the arm holds; shift and rotation vector, in W, to
      the last.
    * count: number of equal steps, at most `STEPS`.
    * pace: time of a step [s].
    * limits (2 n): lower, then upper joint positions.
    * velocity (n): greatest joint speeds [rad/s].
    * walked (n + 3): the last posture; number of steps done; greatest share of a joint's greatest speed; what ended
      the way: 0 its end, 1 no posture within the limits, 2 a joint too slow.
    * postures (n `STEPS`): one after another; after the end of the way the last one is repeated.
    """
    n = chain.n
    sizes = {"q": n, "line": 13, "count": 1, "pace": 1, "limits": 2 * n, "velocity": n}
    inputs = [casadi.MX.sym(name, size) for name, size in sizes.items()]
    q, line, count, pace, limits, velocity = inputs
    others = [count, pace, limits, velocity]
    # Where the arm stands counts as there, so that this leads on to the first step.
    begun = _newton(chain)(casadi.vertcat(q, q, 0), *_targets()(0, count, line)[:2], np.inf, limits)
    state, postures, block = casadi.vertcat(q, casadi.DM.zeros(3), begun[:n]), [], _block(chain)
    arguments = [casadi.MX.sym(f"x{i}", block.sparsity_in(i)) for i in range(block.n_in())]
    still = casadi.repmat(arguments[0][:n], BLOCK, 1)
    rest = casadi.Function("rest", arguments, [arguments[0], still])
    # Most ways are short: whole blocks of steps are passed over.
    guarded = casadi.Function.if_else("block_guarded", block, rest)
    for k in range(0, STEPS, BLOCK):
        going = casadi.logic_and(k < count, state[n + 2] == 0)
        state, reached = guarded(going, state, line, k, *others)
        postures.append(reached)
    nothing = [casadi.MX(casadi.vertcat(q, casadi.DM.zeros(3))), casadi.MX(casadi.DM.zeros(n * STEPS))]
    whole = casadi.Function("whole", inputs, [state[: n + 3], casadi.vertcat(*postures)])
    idle = casadi.Function("idle", inputs, nothing)
    chosen = casadi.Function.if_else("any", whole, idle)(count > 0, *inputs)
    return casadi.Function("walk", inputs, list(chosen))


def _targets() -> casadi.Function:
    """(number of the step, count, line) -> its pose, the pose of the next step, the tolerance of the step."""
    k, count, line = casadi.SX.sym("k"), casadi.SX.sym("count"), casadi.SX.sym("line", 13)
    tolerance = casadi.if_else(k >= count, TOLERANCE, ON_THE_WAY)
    poses = [_pose_at(casadi.fmin(step / count, 1), line) for step in (k, k + 1)]
    return casadi.Function("targets", [k, count, line], [*poses, tolerance])


def _block(chain: Chain) -> casadi.Function:
    """(walked, line, steps before, count, pace, limits, velocity) -> walked, postures (n `BLOCK`)."""
    one, n = _guarded_step(chain), chain.n
    inputs = [casadi.MX.sym(one.name_in(i), one.sparsity_in(i)) for i in range(one.n_in())]
    state, line, before, *others = inputs
    postures = []
    for k in range(1, BLOCK + 1):
        state = one(state, line, before + k, *others)
        postures.append(state[:n])
    return casadi.Function("block", inputs, [state, casadi.vertcat(*postures)])


def _guarded_step(chain: Chain) -> casadi.Function:
    """(walked, line, number of the step, count, pace, limits, velocity) -> walked, unchanged after the end.

    After what `walk` has, walked (2 n + 3) holds a posture that is already on its way to the next pose.
    """
    n = chain.n
    sizes = {"walked": 2 * n + 3, "line": 13, "k": 1, "count": 1, "pace": 1, "limits": 2 * n, "velocity": n}
    inputs = [casadi.MX.sym(name, size) for name, size in sizes.items()]
    walked, line, k, count, pace, limits, velocity = inputs
    target, onward, tolerance = _targets()(k, count, line)
    start = casadi.vertcat(walked[n + 3 :], walked[:n], np.inf)
    found = _step(chain)(start, target, onward, tolerance, limits)
    forward = casadi.Function("forward", inputs, [_advanced(n)(walked, found, tolerance, pace, velocity)])
    stay = casadi.Function("stay", inputs, [walked])
    guarded = casadi.Function.if_else("forward_guarded", forward, stay)
    going = casadi.logic_and(k <= count, walked[n + 2] == 0)
    return casadi.Function("guarded_step", inputs, [guarded(going, *inputs)])


def _advanced(n: int) -> casadi.Function:
    """(walked, what a step found, tolerance, pace, velocity) -> walked after the step."""
    sizes = {"walked": 2 * n + 3, "found": 2 * n + 1, "tolerance": 1, "pace": 1, "velocity": n}
    inputs = [casadi.SX.sym(name, size) for name, size in sizes.items()]
    walked, found, tolerance, pace, velocity = inputs
    at = found[n : 2 * n]
    speed = casadi.mmax(casadi.fabs(at - walked[:n]) / (velocity * pace))
    lost = casadi.logic_not(found[2 * n] <= tolerance)
    end = casadi.if_else(lost, 1, casadi.if_else(speed > 1, 2, 0))
    q = casadi.if_else(end == 0, at, walked[:n])
    after = casadi.vertcat(q, walked[n] + (end == 0), casadi.fmax(walked[n + 1], speed), end, found[:n])
    return casadi.Function("advanced", inputs, [casadi.densify(after)])
