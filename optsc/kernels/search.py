"""Global search of inverse kinematics: attempts at one pose as one CasADi function, all iterations inside.

An iteration is the step of `optsc.kernels.newton`, shortened to `LONGEST_STEP` and projected onto the limits.

With one tolerance, a pose is met when distance and angle are both within it: norms, so that the verdict is the same in
all axes. The iterations go on until both are below `FINISH`, or no longer fall: mostly that is one Newton step more.

With a tolerance for every component, e is what the deviation of the tool from its target (see `tool_deviation`) has
beyond `AIM` times its tolerance, and components within that have no row in J: what is free takes no part, and what has
room is moved no further than it must.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi
import numpy as np

from optsc.kernels import rotations
from optsc.kernels.chain import Chain, tool_kinematics
from optsc.kernels.newton import (
    DAMPING,
    FLOOR,
    INVERSE_WEIGHTS,
    damped_step,
    error_norm,
    pose_error,
    tool_deviation,
    without_blocked,
)
from optsc.kernels.symbols import inputs_like, only_if, symbols

LONGEST_STEP = 1.0
"""Greatest change of a joint in one iteration [rad or m]."""
FALL, PATIENCE = 0.9, 4
"""An attempt is abandoned when eᵀ W e does not fall below FALL times its best for more than PATIENCE iterations: a new
start is worth more than patience."""
ITERATIONS = 40
"""Greatest number of iterations of an attempt; a multiple of _BLOCK."""
_BLOCK = 10

FINISH = 5e-10
"""Distance [m] and angle [rad] to which a solution is finished, where it converges so far: half of what is promised."""
AIM = 0.5
"""Share of its tolerance that a component is led into, so that small steps do not end just outside."""

STARTS = 8
"""Starts that one call of `search` tries one after another."""

_RUNNING, _ENDED = 0, 1


@dataclass
class _State:
    """An attempt while it runs."""

    q: casadi.SX  # what the next iteration evaluates
    at: casadi.SX  # what came nearest to the target so far
    residual: casadi.SX  # there
    status: casadi.SX
    iterations: casadi.SX
    least: casadi.SX  # least cost so far
    stalled: casadi.SX  # iterations since it last fell

    @classmethod
    def start(cls, q: casadi.SX) -> _State:
        return cls(q, q, *(casadi.SX(value) for value in (np.inf, _RUNNING, 0.0, np.inf, 0.0)))

    @classmethod
    def unpack(cls, rows: casadi.SX) -> _State:
        n = (rows.shape[0] - 5) // 2
        return cls(rows[:n], rows[n : 2 * n], *(rows[2 * n + i] for i in range(5)))

    def pack(self) -> casadi.SX:
        rows = (self.q, self.at, self.residual, self.status, self.iterations, self.least, self.stalled)
        return casadi.densify(casadi.vertcat(*rows))


def state_size(n: int) -> int:
    """Return how many numbers the state of an attempt has for an arm of n joints."""
    return 2 * n + 5


@dataclass
class _Miss:
    """How far a configuration is from its target."""

    error: casadi.SX  # what a step is to take away (6,)
    J: casadi.SX  # how much of it joint velocities take away (6, n)
    residual: casadi.SX  # what solutions are compared by [m or rad]
    finish: casadi.SX  # residual up to which iterations go on where they can


def _miss(chain: Chain, q: casadi.SX, target: casadi.SX) -> _Miss:
    """One tolerance for all: target is quaternion, position, tolerance; all in W's axes."""
    R, p, J = tool_kinematics(chain, q)
    error = pose_error(R, p, target)
    return _Miss(error, J, error_norm(error), casadi.fmin(target[7], FINISH))


def _miss_by_component(chain: Chain, q: casadi.SX, target: casadi.SX) -> _Miss:
    """Six tolerances: target is quaternion, position, tolerances; all in the target's axes."""
    R, p, J = tool_kinematics(chain, q)
    R_goal, tolerances = rotations.to_matrix(target[:4]), target[7:13]
    deviation, rates = tool_deviation(R, p, R_goal, target[4:7])
    band = AIM * tolerances
    error = casadi.fmin(casadi.fmax(deviation, -band), band) - deviation
    wanted = casadi.if_else(casadi.fabs(deviation) > band, 1, 0)
    J = casadi.vertcat(R_goal.T @ J[:3, :], rates @ (R_goal.T @ J[3:, :]))
    J = casadi.vertcat(*(J[i, :] * wanted[i] for i in range(6)))
    excess = casadi.mmax(casadi.fabs(deviation) - tolerances)
    return _Miss(error, J, casadi.fmax(excess, 0), casadi.SX(0))


def iteration(chain: Chain, by_component: bool) -> casadi.Function:
    """Return the function (state, target, bounds) -> state of one Levenberg-Marquardt step."""
    n = chain.n
    inputs = symbols(casadi.SX, state=state_size(n), target=target_size(by_component), bounds=2 * n)
    rows, target, bounds = inputs
    lower, upper = bounds[:n], bounds[n:]
    state = _State.unpack(rows)
    miss = (_miss_by_component if by_component else _miss)(chain, state.q, target)
    error, J = miss.error, miss.J
    inverse_weights = casadi.SX(INVERSE_WEIGHTS)
    weighted = error / inverse_weights
    cost = casadi.dot(error, weighted)
    J = without_blocked(J, state.q, J.T @ weighted, lower, upper)
    gradient = J.T @ casadi.diag(1 / inverse_weights) @ error
    step = damped_step(J, error, gradient, DAMPING * cost + FLOOR)
    step = step * casadi.fmin(1, LONGEST_STEP / (casadi.norm_inf(step) + 1e-200))
    fell = cost < FALL * state.least
    stalled = casadi.if_else(fell, 0, state.stalled + 1)
    hopeless = casadi.logic_or(stalled > PATIENCE, state.iterations >= ITERATIONS - 1)
    nearer = miss.residual < state.residual
    least = casadi.if_else(nearer, miss.residual, state.residual)
    moved = casadi.fmin(casadi.fmax(state.q + step, lower), upper)
    after = _State(
        q=moved,
        at=casadi.if_else(nearer, state.q, state.at),
        residual=least,
        status=casadi.if_else(casadi.logic_or(least <= miss.finish, hopeless), _ENDED, _RUNNING),
        iterations=state.iterations + 1,
        least=casadi.if_else(fell, cost, state.least),
        stalled=stalled,
    )
    return casadi.Function("iteration", inputs, [after.pack()])


def _repeated(step: casadi.Function, times: int, name: str) -> casadi.Function:
    """Return the function that applies ``step`` ``times`` times, or until the attempt is no longer running."""
    arguments = inputs_like(step)
    state, *others = arguments
    status = (state.shape[0] - state_size(0)) + 1
    unchanged = casadi.Function(f"{name}_unchanged", arguments, [state])
    by_status = casadi.Function.conditional(f"{name}_by_status", [step], unchanged)
    for _ in range(times):
        state = by_status(state[status], state, *others)
    return casadi.Function(name, arguments, [state])


def _unwound(q: casadi.SX, seed: casadi.SX, lower: casadi.SX, upper: casadi.SX) -> casadi.SX:
    """Return angles that differ by full turns: inside the limits, and there as near to the seed as can be.

    Where the limits leave no room for a full turn, there is none to take off.
    """
    turn = 2.0 * np.pi
    wanted = casadi.floor((q - seed) / turn + 0.5)
    least, most = casadi.ceil((q - upper) / turn), casadi.floor((q - lower) / turn)
    return q - turn * casadi.fmax(casadi.fmin(wanted, most), least)


def target_size(by_component: bool) -> int:
    """Return how many numbers describe a target: quaternion, position, and one tolerance or six."""
    return 13 if by_component else 8


def _ended(chain: Chain) -> casadi.Function:
    """Return the function (state, best, tolerance, seed, limits) -> best after an attempt."""
    n = chain.n
    inputs = symbols(casadi.SX, state=state_size(n), best=n + 3, tolerance=1, seed=n, limits=2 * n)
    rows, best, tolerance, seed, limits = inputs
    state, lower, upper = _State.unpack(rows), limits[:n], limits[n:]
    turned = _unwound(state.at, seed, lower, upper)
    q = casadi.vertcat(*(state.at[i] if slides else turned[i] for i, slides in enumerate(chain.slides)))
    # Taking off turns leaves rounding, which must not lead out of the limits.
    inside = casadi.fmin(casadi.fmax(q, lower), upper)
    found = casadi.vertcat(inside, state.residual, state.residual <= tolerance)
    better = state.residual < best[n]
    kept = casadi.vertcat(casadi.if_else(better, found, best[: n + 2]), best[n + 2] + state.iterations)
    return casadi.Function("ended", inputs, [kept])


def _attempt(chain: Chain, by_component: bool) -> casadi.Function:
    """Return the function (best, target, seed, start, bounds, limits) -> best of one attempt, see `search`."""
    n, q = chain.n, casadi.SX.sym("q", chain.n)
    begin = casadi.Function("begin", [q], [_State.start(q).pack()])
    block = _repeated(iteration(chain, by_component), _BLOCK, "block")
    run = _repeated(block, ITERATIONS // _BLOCK, "blocks")
    size = target_size(by_component)
    inputs = symbols(casadi.MX, best=n + 3, target=size, seed=n, start=n, bounds=2 * n, limits=2 * n)
    best, target, seed, start, bounds, limits = inputs
    # Six tolerances are taken off the residual already.
    tolerance = 0.0 if by_component else target[7]
    after = _ended(chain)(run(begin(start), target, bounds), best, tolerance, seed, limits)
    return casadi.Function("attempt", inputs, [after])


def search(chain: Chain, by_component: bool = False) -> casadi.Function:
    """Return the function (best, target, seed, starts, count, bounds, limits) -> best of attempts at one pose.

    * best (n + 3), in and out: the configuration of least residual so far; its residual, the larger of distance and
      angle to the target there [m or rad], infinite at first; whether it is within tolerance; iterations so far.
    * target (8): unit quaternion w, x, y, z, position [m], tolerance of the residual; or, ``by_component``, (13):
      the last six are tolerances of the components of `tool_deviation`, infinite where one is free. The residual is
      then what exceeds them, zero on success.
    * seed (n): turning joints end within half a turn of it, as far as the limits permit.
    * starts (n, `STARTS`), count: configurations inside the bounds; the first ``count`` are tried until one succeeds.
    * bounds (2 n): lower, then upper positions that the iterations observe. A joint that can make a full turn
      needs none.
    * limits (2 n): lower, then upper positions that the result observes, infinite where there are none.
    """
    n, size = chain.n, target_size(by_component)
    inputs = symbols(
        casadi.MX, best=n + 3, target=size, seed=n, starts=(n, STARTS), count=1, bounds=2 * n, limits=2 * n
    )
    best, target, seed, starts, count, bounds, limits = inputs
    attempt, after = only_if(_attempt(chain, by_component)), best
    for k in range(STARTS):
        wanted = casadi.logic_and(k < count, casadi.logic_not(after[n + 1]))
        after = attempt(wanted, after, target, seed, starts[:, k], bounds, limits)
    tried = casadi.Function("tried", inputs, [after])
    # Without this an empty place in a batch would cost a test for every start.
    return casadi.Function("search", inputs, [only_if(tried, inputs, [best])(count, *inputs)])
