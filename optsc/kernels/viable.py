"""The viable interval: which joint accelerations at this tick allow a joint to keep every limit for ever.

One joint at a time. Its state at a tick is (q, v, a), and the choice is the acceleration a' of the next tick:

    v' = v + dt a',    q' = q + dt (v + v') / 2,    jerk = (a' - a) / dt.

An a' is viable when the state it leads to can be braked to rest inside all limits, with the jerk and
acceleration limits of the joint. The derivation, with a picture, is in docs/viable-interval.md. Related work:
A. Del Prete, "Joint position and velocity bounds in discrete-time acceleration/torque control of robot
manipulators", RA-L 2018 (position, velocity and acceleration; the jerk limit is added here).
"""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache

import casadi

from optsc.kernels.symbols import only_if, symbols

BISECTIONS = 44
"""Halvings of the interval; enough that its end is exact to rounding."""
OUTSIDE = 1e-9
"""A joint this far [rad] beyond a position limit counts as having started outside it."""
RETURN_RATE = 5.0
"""Speed of return from outside a position limit, per distance [1/s] (tuned here)."""
RETURN_INSET = 1e-3
"""How far inside [rad] the return aims, so that it ends in finite time (tuned here)."""


class Bound(IntEnum):
    """Which limit closes an end of the viable interval."""

    JERK = 0
    ACCELERATION = 1
    VELOCITY = 2
    POSITION = 3


def _stopping_distance(v: casadi.SX, a: casadi.SX, A: casadi.SX, J: casadi.SX) -> casadi.SX:
    """Return how far (>= 0) a joint still moves upwards when it brakes to rest as fast as A and J allow.

    Time-optimal stop: jerk -J down to the deceleration a_p (at most A), hold, jerk +J up to rest.
    """
    a_p = casadi.fmin(casadi.sqrt(casadi.fmax(J * v + 0.5 * a * a, 0.0)), A)
    t1 = casadi.fmax((a + a_p) / J, 0.0)
    x1 = t1 * (v + t1 * (0.5 * a - t1 * J / 6.0))
    v1 = v + t1 * (a - 0.5 * J * t1)
    t_hold = casadi.fmax((v1 - 0.5 * a_p * a_p / J) / A, 0.0)
    x_hold = t_hold * (v1 - 0.5 * A * t_hold)
    x_end = a_p**3 / (6.0 * J * J)
    braking = casadi.fmax(x1 + x_hold + x_end, 0.0)
    # Already decelerating more than the stop needs: the joint turns round before its jerk-limited rest.
    t_turn = 2.0 * v / (-a + casadi.sqrt(casadi.fmax(a * a - 2.0 * J * v, 0.0)) + 1e-300)
    turning = t_turn * (v + t_turn * (0.5 * a + t_turn * J / 6.0))
    needs_braking = v + a * casadi.fabs(a) / (2.0 * J) > 0.0
    return casadi.if_else(needs_braking, braking, casadi.if_else(v > 0.0, turning, 0.0))


def _velocity_end(v: casadi.SX, limit: casadi.SX, jerk_step: casadi.SX, dt: casadi.SX) -> casadi.SX:
    """Return the greatest a' from which the acceleration can be ramped to zero without passing ``limit``.

    Exact on the grid of ticks: n full ramp steps fit below the velocity that is left.
    """
    room = (limit - v) / dt
    n = casadi.floor(0.5 * (casadi.sqrt(1.0 + 8.0 * casadi.fmax(room, 0.0) / jerk_step) - 1.0))
    ramp = (room + 0.5 * jerk_step * n * (n + 1.0)) / (n + 1.0)
    return casadi.if_else(room > 0.0, ramp, room)


def _reach(a_next: casadi.SX, q: casadi.SX, v: casadi.SX, A: casadi.SX, J: casadi.SX, dt: casadi.SX) -> casadi.SX:
    v_next = v + dt * a_next
    return q + 0.5 * dt * (v + v_next) + _stopping_distance(v_next, a_next, A, J)


@lru_cache
def _halving() -> casadi.Function:
    low, high, q, v, u, A, J, dt = symbols(casadi.SX, low=1, high=1, q=1, v=1, u=1, A=1, J=1, dt=1)
    middle = 0.5 * (low + high)
    safe = _reach(middle, q, v, A, J, dt) <= u
    state = casadi.vertcat(casadi.if_else(safe, middle, low), casadi.if_else(safe, high, middle))
    return casadi.Function("halving", [casadi.vertcat(low, high), casadi.vertcat(q, v, u, A, J, dt)], [state])


@lru_cache
def _upper_ends() -> casadi.Function:
    """(q, v, a, u, V, A, J, dt) -> least a', velocity end, position test at both, position end when outside."""
    q, v, a, u, V, A, J, dt = symbols(casadi.SX, q=1, v=1, a=1, u=1, V=1, A=1, J=1, dt=1)
    step = J * dt
    least = casadi.fmin(casadi.fmax(-A, a - step), a + step)
    most = casadi.fmin(casadi.fmax(A, a - step), a + step)
    velocity_end = _velocity_end(v, V, step, dt)
    end = casadi.fmin(casadi.fmax(velocity_end, least), most)
    homeward = (-casadi.fmin(RETURN_RATE * (q - u + RETURN_INSET), 0.5 * V) - v) / dt
    # Seen from far outside all of the above still holds; the position end just asks for the return.
    outside_end = casadi.fmin(casadi.fmax(homeward, least), end)
    fits = _reach(end, q, v, A, J, dt) <= u
    outside = q > u + OUTSIDE
    bound = casadi.if_else(velocity_end < most, 2.0, casadi.if_else(most >= A, 1.0, 0.0))
    return casadi.Function(
        "ends",
        [casadi.vertcat(q, v, a, u, V, A, J, dt)],
        [casadi.vertcat(least, end, fits, outside, outside_end, bound)],
    )


@lru_cache
def _searched() -> casadi.Function:
    """(must it be, (q, v, a, u, V, A, J, dt), least a', velocity end) -> end by all limits; jumped over elsewhere."""
    x, least, end = symbols(casadi.MX, x=8, least=1, end=1)
    data = casadi.vertcat(x[0], x[1], x[3], x[5], x[6], x[7])
    halvings = _halving().fold(BISECTIONS)(casadi.vertcat(least, end), casadi.repmat(data, 1, BISECTIONS))
    return only_if(casadi.Function("search", [x, least, end], [halvings[0]]), [x, least, end], [end])


@lru_cache
def _all_ends(n: int) -> casadi.Function:
    """(state, limits, dt) -> for the upper ends of all joints, then for the lower ones, seen as upper ones (1, 2 n):

    what `_upper_ends` takes (8, 2 n); least a'; velocity end; whether the end must be searched for; the end where it
    must not be; `Bound`; and whether any must be searched for.
    """
    inputs = symbols(casadi.SX, state=(n, 3), limits=(n, 5), dt=1)
    state, limits, dt = inputs
    columns, rows, some = [], [], casadi.SX(0)
    for sign, position in ((1.0, 1), (-1.0, 0)):
        for i in range(n):
            x = casadi.vertcat(sign * state[i, :].T, sign * limits[i, position], limits[i, 2:].T, dt)
            ends = _upper_ends()(x)
            least, end, fits, outside, outside_end, bound = (ends[k] for k in range(6))
            must = casadi.logic_and(fits < 0.5, outside < 0.5)
            some = casadi.logic_or(some, must)
            plain = casadi.if_else(outside > 0.5, outside_end, end)
            by_position = casadi.logic_or(fits < 0.5, outside > 0.5)
            bound = casadi.if_else(by_position, float(Bound.POSITION), bound)
            columns.append(x)
            rows.append(casadi.vertcat(least, end, must, plain, bound))
    table = casadi.horzcat(*rows)
    outputs = [casadi.horzcat(*columns), *(table[k, :] for k in range(5)), some]
    return casadi.Function("all_ends", inputs, [casadi.densify(x) for x in outputs])


@lru_cache
def viable_interval(n: int) -> casadi.Function:
    """Return the function that closes the accelerations of ``n`` joints in for one tick.

    Inputs: state (n, 3) with the columns q, v, a; limits (n, 5) with lower, upper, V, A, J; the period dt [s].
    Outputs: lowest and highest viable velocity v' of the next tick (n,) [rad/s]; the `Bound` that closes each
    end (n, 2); how far the joint furthest beyond its position limits is beyond them (1), zero when none is.
    Jerk and acceleration never give, then velocity, then position: the interval is never empty.
    """
    inputs = symbols(casadi.MX, state=(n, 3), limits=(n, 5), dt=1)
    x, least, end, must, plain, bound, any_must = _all_ends(n)(*inputs)
    # The search is needed only close to a limit, and jumped over elsewhere.
    arguments = symbols(casadi.MX, x=(8, 2 * n), least=(1, 2 * n), end=(1, 2 * n), must=(1, 2 * n), plain=(1, 2 * n))
    xs, leasts, ends, musts, plains = arguments
    found = [
        casadi.if_else(musts[k], _searched()(musts[k], xs[:, k], leasts[k], ends[k]), plains[k]) for k in range(2 * n)
    ]
    search = casadi.Function("searches", arguments, [casadi.horzcat(*found)])
    all_limits = only_if(search, arguments, [plains])(any_must, x, least, end, must, plain)
    return casadi.Function(
        "viable_interval",
        inputs,
        list(_closed(n)(*inputs, end, all_limits, bound)),
        ["state", "limits", "dt"],
        ["lowest", "highest", "bounds", "outside"],
    )


@lru_cache
def _closed(n: int) -> casadi.Function:
    """(state, limits, dt, ends by the rates alone, by all limits, bounds) -> the outputs of `viable_interval`."""
    inputs = symbols(
        casadi.SX, state=(n, 3), limits=(n, 5), dt=1, rates=(1, 2 * n), all_limits=(1, 2 * n), bound=(1, 2 * n)
    )
    state, limits, dt, rates, all_limits, bound = inputs
    high, low = (x.T for x in casadi.horzsplit(all_limits, n))
    high_rates, low_rates = (x.T for x in casadi.horzsplit(rates, n))
    highest = casadi.fmax(high, -low_rates)
    lowest = casadi.fmin(-low, high_rates)
    # Two position limits closer together than the joint can stop between: share what neither leaves.
    middle = 0.5 * (lowest + highest)
    crossed = lowest > highest
    highest, lowest = casadi.if_else(crossed, middle, highest), casadi.if_else(crossed, middle, lowest)
    q, v = state[:, 0], state[:, 1]
    outside = casadi.fmax(casadi.mmax(casadi.fmax(q - limits[:, 1], limits[:, 0] - q)), 0.0)
    bounds = casadi.horzcat(*(x.T for x in casadi.horzsplit(bound, n)[::-1]))
    outputs = [v + dt * lowest, v + dt * highest, bounds, outside]
    return casadi.Function("closed", inputs, [casadi.densify(x) for x in outputs])


@lru_cache
def advance(n: int) -> casadi.Function:
    """Return the function that moves ``n`` joints on by one tick, and closes their accelerations in for the next one.

    Inputs: state (n, 3); interval (n, 2), the viable velocities of this tick; velocity (n), the one that is wanted;
    limits (n, 5); the period dt [s]. Outputs: the next state, with a' = (v' - v) / dt and q' = q + dt (v + v') / 2; its
    interval, bounds and what is outside, as `viable_interval` gives them; whether the velocity is inside the interval
    of this tick, without which the other outputs mean nothing.
    """
    inputs = symbols(casadi.SX, state=(n, 3), interval=(n, 2), velocity=n, dt=1)
    state, interval, velocity, dt = inputs
    q, v = state[:, 0], state[:, 1]
    moved = casadi.horzcat(q + (0.5 * dt) * (v + velocity), velocity, (velocity - v) / dt)
    inside = casadi.SX(1)
    for i in range(n):
        within = casadi.logic_and(velocity[i] >= interval[i, 0], velocity[i] <= interval[i, 1])
        inside = casadi.logic_and(inside, within)
    step = casadi.Function("step", inputs, [moved, inside])
    state, interval, velocity, limits, dt = symbols(
        casadi.MX, state=(n, 3), interval=(n, 2), velocity=n, limits=(n, 5), dt=1
    )
    moved, inside = step(state, interval, velocity, dt)
    lowest, highest, bounds, outside = viable_interval(n)(moved, limits, dt)
    return casadi.Function(
        "advance",
        [state, interval, velocity, limits, dt],
        [moved, casadi.horzcat(lowest, highest), bounds, outside, inside],
        ["state", "interval", "velocity", "limits", "dt"],
        ["next", "next_interval", "bounds", "outside", "inside"],
    )
