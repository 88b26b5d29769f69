"""Straight-line rollout: the tool follows a line, configuration by configuration, as one CasADi function.

The path from one pose to the other has straight translation and turns about one axis. It is followed in equal steps,
each from the configuration of the one before, by the damped Newton iteration of `optsc.kernels.newton`, projected
onto the joint limits. So the configurations stay in one branch, as those of a moving arm do.
"""

from __future__ import annotations

import casadi
import numpy as np

from optsc.kernels import rotations
from optsc.kernels.chain import Chain, tool_kinematics
from optsc.kernels.newton import DAMPING, FLOOR, WEIGHTS, damped_step, error_norm, pose_error, without_blocked
from optsc.kernels.symbols import inputs_like, only_if, symbols

STEPS_PER_BLOCK = 8
STEPS = 8 * STEPS_PER_BLOCK
"""Steps of a path at most."""
END_TOLERANCE, STEP_TOLERANCE = 1e-5, 1e-3
"""Greatest distance [m] and angle [rad] to the pose at the end and after each other step."""
NEWTON_STEPS = 8
"""Of one step of the path at most; two or three are common."""


def newton(chain: Chain) -> casadi.Function:
    """(state, target, next target, tolerance, limits) -> state (2 n + 1) of one Newton step.

    The state is the configuration, the last configuration at a target, and the residual. Where the configuration is
    at the target, the step goes on to the next one: one evaluation of the kinematics both checks a step and begins
    another.
    """
    n = chain.n
    inputs = symbols(casadi.SX, state=2 * n + 1, target=7, onward=7, tolerance=1, limits=2 * n)
    state, target, onward, tolerance, limits = inputs
    q, lower, upper, weights = state[:n], limits[:n], limits[n:], casadi.SX(WEIGHTS)
    R, p, J = tool_kinematics(chain, q)
    error = pose_error(R, p, target)
    residual = error_norm(error)
    there = residual <= tolerance
    error = casadi.if_else(there, pose_error(R, p, onward), error)
    J = without_blocked(J, q, J.T @ (weights * error), lower, upper)
    damping = DAMPING * casadi.dot(error, weights * error) + FLOOR
    step = damped_step(J, error, J.T @ (weights * error), damping)
    moved = casadi.fmin(casadi.fmax(q + step, lower), upper)
    after = casadi.vertcat(moved, casadi.if_else(there, q, state[n : 2 * n]), residual)
    return casadi.Function("newton", inputs, [casadi.densify(after)])


def _newton_steps(chain: Chain) -> casadi.Function:
    """The same function as `newton`, repeated until the configuration is at the target."""
    n, once = chain.n, newton(chain)
    again, inputs = only_if(once), inputs_like(once)
    state, *others = inputs
    tolerance = others[2]
    state = once(state, *others)
    for _ in range(NEWTON_STEPS - 1):
        state = again(state[2 * n] > tolerance, state, *others)
    return casadi.Function("newton_steps", inputs, [state])


def _pose_at(share: casadi.SX, line: casadi.SX) -> casadi.SX:
    """Return quaternion and position (7) at a share of a line (13): start, shift and rotation vector."""
    half = 0.5 * share * line[10:13]
    angle = casadi.sqrt(casadi.dot(half, half) + 1e-300)
    turn = casadi.vertcat(casadi.cos(angle), casadi.sin(angle) / angle * half)
    return casadi.vertcat(rotations.multiply(turn, line[:4]), line[4:7] + share * line[7:10])


def _targets() -> casadi.Function:
    """(number of the step, count, line) -> its pose, the pose of the next step, the tolerance of the step."""
    inputs = symbols(casadi.SX, k=1, count=1, line=13)
    k, count, line = inputs
    tolerance = casadi.if_else(k >= count, END_TOLERANCE, STEP_TOLERANCE)
    poses = [_pose_at(casadi.fmin(step / count, 1), line) for step in (k, k + 1)]
    return casadi.Function("targets", inputs, [*poses, tolerance])


def _advanced(n: int) -> casadi.Function:
    """(progress, what the Newton steps found, tolerance, pace, velocity) -> progress after a step of the path."""
    inputs = symbols(casadi.SX, progress=2 * n + 3, found=2 * n + 1, tolerance=1, pace=1, velocity=n)
    progress, found, tolerance, pace, velocity = inputs
    at = found[n : 2 * n]
    speed = casadi.mmax(casadi.fabs(at - progress[:n]) / (velocity * pace))
    lost = casadi.logic_not(found[2 * n] <= tolerance)
    end = casadi.if_else(lost, 1, casadi.if_else(speed > 1, 2, 0))
    q = casadi.if_else(end == 0, at, progress[:n])
    after = casadi.vertcat(q, progress[n] + (end == 0), casadi.fmax(progress[n + 1], speed), end, found[:n])
    return casadi.Function("advanced", inputs, [casadi.densify(after)])


def _step(chain: Chain) -> casadi.Function:
    """(progress, line, number of the step, count, pace, limits, velocity) -> progress, unchanged after the end.

    Progress (2 n + 3) is that of `rollout`, and a configuration that already moves to the next pose.
    """
    n = chain.n
    inputs = symbols(casadi.MX, progress=2 * n + 3, line=13, k=1, count=1, pace=1, limits=2 * n, velocity=n)
    progress, line, k, count, pace, limits, velocity = inputs
    target, onward, tolerance = _targets()(k, count, line)
    start = casadi.vertcat(progress[n + 3 :], progress[:n], np.inf)
    found = _newton_steps(chain)(start, target, onward, tolerance, limits)
    step = casadi.Function("step", inputs, [_advanced(n)(progress, found, tolerance, pace, velocity)])
    going = casadi.logic_and(k <= count, progress[n + 2] == 0)
    return casadi.Function("step_if_going", inputs, [only_if(step)(going, *inputs)])


def _block(chain: Chain) -> casadi.Function:
    """(progress, line, steps before, count, pace, limits, velocity) -> progress, configurations of a block of steps."""
    one, n = _step(chain), chain.n
    inputs, configurations = inputs_like(one), []
    progress, line, before, *others = inputs
    for k in range(1, STEPS_PER_BLOCK + 1):
        progress = one(progress, line, before + k, *others)
        configurations.append(progress[:n])
    return casadi.Function("block", inputs, [progress, casadi.vertcat(*configurations)])


def rollout(chain: Chain) -> casadi.Function:
    """Return the function (q, line, count, pace, limits, velocity) -> progress, configurations.

    * q (n): present configuration.
    * line (13): quaternion and position of the first pose, which the arm holds; shift and rotation vector, in W, to
      the last.
    * count: number of equal steps, at most `STEPS`.
    * pace: time of a step [s].
    * limits (2 n): lower, then upper joint positions.
    * velocity (n): greatest joint speeds [rad/s].
    * progress (n + 3): the last configuration; number of steps done; greatest share of a joint's greatest speed; what
      ended the rollout: 0 the end of the path, 1 no configuration within the limits, 2 a joint too slow.
    * configurations (n `STEPS`): one after another; after the end the last one is repeated.
    """
    n, block = chain.n, _block(chain)
    inputs = symbols(casadi.MX, q=n, line=13, count=1, pace=1, limits=2 * n, velocity=n)
    q, line, count, pace, limits, velocity = inputs
    # The present configuration counts as at its target, so that this goes on to the first step.
    begun = newton(chain)(casadi.vertcat(q, q, 0), *_targets()(0, count, line)[:2], np.inf, limits)
    progress, configurations = casadi.vertcat(q, casadi.DM.zeros(3), begun[:n]), []
    arguments = inputs_like(block)
    # Most paths are short: whole blocks of steps are jumped over.
    repeated = casadi.repmat(arguments[0][:n], STEPS_PER_BLOCK, 1)
    block_if = only_if(block, arguments, [arguments[0], repeated])
    for k in range(0, STEPS, STEPS_PER_BLOCK):
        going = casadi.logic_and(k < count, progress[n + 2] == 0)
        progress, reached = block_if(going, progress, line, k, count, pace, limits, velocity)
        configurations.append(reached)
    whole = casadi.Function("whole", inputs, [progress[: n + 3], casadi.vertcat(*configurations)])
    nothing = [casadi.MX(casadi.vertcat(q, casadi.DM.zeros(3))), casadi.MX(casadi.DM.zeros(n * STEPS))]
    chosen = only_if(whole, inputs, nothing)(count > 0, *inputs)
    return casadi.Function("rollout", inputs, list(chosen))
