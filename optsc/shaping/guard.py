"""The joint guard: every commanded joint motion passes it, and none leaves it that breaks a limit.

The commanded state (q, v, a) lies in memory of the caller's. A wanted velocity inside the viable interval passes
through unchanged. One outside is approached with Ruckig's time-optimal, jerk-limited profile, so that it is reached
without overshoot. The free edition of Ruckig knows no position limits: the viable interval brakes before them, and has
the last word.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.kernels.kernel import build_kernel
from optsc.kernels.viable import advance, viable_interval
from optsc.robot.limits import JointLimits

ROUNDING = 1e-9
"""Share of the rate limits that is left to rounding, so that differences of commands keep them to the last digit."""


class JointState(NamedTuple):
    """Commanded position, velocity and acceleration (n,) [rad, rad/s, rad/s^2]; a is the difference of v per tick."""

    q: Array
    v: Array
    a: Array


class JointGuard:
    """Keeps position, velocity, acceleration and jerk limits at every tick of ``period`` [s].

    Args:
        limits: of the joints.
        period: of a tick [s].
        state: where the commanded positions, velocities and accelerations (n, 3) are kept, column-major; memory of
            its own by default. Whoever writes there calls `refresh`.

    Raises:
        InvalidValue: a period that is not positive, or a state of another shape.
    """

    def __init__(self, limits: JointLimits, period: float, state: Array | None = None) -> None:
        if not (np.isfinite(period) and period > 0):
            raise InvalidValue("period", period, "positive [s]")
        from ruckig import ControlInterface, InputParameter, Ruckig, Synchronization, Trajectory

        n = len(limits)
        self.period = period
        self._kernel, self._tick = build_kernel(viable_interval(n)), build_kernel(advance(n))
        if state is not None:
            self._kernel.bind(0, state)
        self._state, self._limit_columns, tick = self._kernel.inputs
        tick[:] = period
        self.columns = self._state[:, 0], self._state[:, 1], self._state[:, 2]
        """The commanded positions, velocities and accelerations (n,): views that the next tick changes."""
        self.q = self.columns[0]
        """The commanded configuration (n,) [rad]: a view that the next tick changes."""
        for index, memory in ((0, self._state), (3, self._limit_columns), (4, tick)):
            self._tick.bind(index, memory)
        # A kernel reads while it writes, so the interval of a tick is another memory than that of the next one.
        _, self._interval_now, self._velocity, *_ = self._tick.inputs
        self._next, self.interval, self.bounds, self._outside, self._inside = self._tick.outputs
        self._next_columns = self._next[:, 0], self._next[:, 1], self._next[:, 2]
        self.lowest, self.highest = self.interval[:, 0], self.interval[:, 1]
        """Viable velocities of the next tick (n,) [rad/s], columns of `interval`; `bounds` (n, 2) has their `Bound`."""
        for index, memory in enumerate((self.lowest, self.highest, self.bounds, self._outside)):
            self._kernel.bind_output(index, memory)
        self._planner, self._trajectory = Ruckig(n), Trajectory(n)
        self._plan: Any = InputParameter(n)
        self._plan.control_interface = ControlInterface.Velocity
        self._plan.synchronization = Synchronization.No
        self._plan.target_acceleration = [0.0] * n
        self._write(limits)
        self.planner_failures = 0
        """How often Ruckig had no answer and the velocity was merely clipped."""
        self.reset(np.clip(np.zeros(n), limits.lower, limits.upper))

    def _write(self, limits: JointLimits) -> None:
        self.limits = limits
        rates = np.column_stack([limits.velocity, limits.acceleration, limits.jerk]) * (1.0 - ROUNDING)
        self._limit_columns[:] = np.column_stack([limits.lower, limits.upper, rates])
        self._plan.max_acceleration = limits.acceleration.tolist()
        self._plan.max_jerk = limits.jerk.tolist()

    def set_limits(self, limits: JointLimits) -> None:
        """Keep other limits from now on, also in motion; raise `InvalidValue` unless they are for as many joints.

        Jerk and acceleration hold at once. A joint that is too fast slows down as soon as they allow, and one that is
        beyond a position limit is led back.
        """
        if len(limits) != len(self.limits):
            raise InvalidValue("number of joints of the limits", len(limits), str(len(self.limits)))
        self.refresh(limits)

    def refresh(self, limits: JointLimits) -> None:
        """Work the viable interval out again, after the state was written from outside or with other limits."""
        if limits is not self.limits:
            self._write(limits)
        self._kernel.run()

    @property
    def outside(self) -> float:
        """How far the joint furthest beyond its position limits is beyond them [rad]; zero when all are inside."""
        return float(self._outside[0])

    def reset(self, q: ArrayLike, v: ArrayLike | None = None) -> None:
        """Start from configuration ``q`` (n,) [rad] with velocity ``v`` (n,) [rad/s] and no acceleration.

        A start outside the limits is allowed: the arm then comes back inside. Raises `InvalidValue` unless finite.
        """
        start = np.zeros((len(self.limits), 3))
        for column, value in enumerate((q, np.zeros(len(self.limits)) if v is None else v)):
            value = np.asarray(value, dtype=float)
            if value.shape != (len(self.limits),) or not np.all(np.isfinite(value)):
                raise InvalidValue("qv"[column], value.tolist(), f"finite, shape ({len(self.limits)},)")
            start[:, column] = value
        self._state[:] = start
        self._kernel.run()

    @property
    def state(self) -> JointState:
        """The commanded state."""
        return JointState(*self._state.T.copy())

    def _approach(self, v: Array) -> Array:
        """Return the velocity of the next tick on the time-optimal approach to ``v``, which is outside the interval."""
        from ruckig import Result, RuckigError

        plan = self._plan
        plan.current_position, plan.current_velocity, plan.current_acceleration = self._state.T.tolist()
        plan.target_velocity = np.clip(v, -self.limits.velocity, self.limits.velocity).tolist()
        try:
            result = self._planner.calculate(plan, self._trajectory)
        except RuckigError:
            result = Result.Error
        if result not in (Result.Working, Result.Finished):
            self.planner_failures += 1
            return v
        return np.array(self._trajectory.at_time(self.period)[1])

    def advance(self, velocity: Array) -> JointState:
        """Move one tick towards ``velocity`` (n,) [rad/s] and return the new commanded state.

        Returns the wanted velocity itself where it is viable. A velocity that is not finite means a stop.
        """
        self._interval_now[:], self._velocity[:] = self.interval, velocity
        self._tick.run()
        if self._inside[0] != 1.0:
            lowest, highest = self._interval_now.T
            if not np.isfinite(velocity).all():
                velocity = np.zeros(len(lowest))
            self._velocity[:] = np.minimum(np.maximum(self._approach(velocity), lowest), highest)
            self._tick.run()
        self._state[:] = self._next
        q, v, a = self._next_columns
        return JointState(q.copy(), v.copy(), a.copy())
