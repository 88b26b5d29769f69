"""Tracking of a target: the reference is led to it, the tool to the reference, and a verdict says what held it back.

One tick: the reference model moves on towards the target (`optsc.kernels.reference`), the quadratic program gives the
joint velocity with which the tool goes after the reference (`optsc.ik.differential`), and where the arm cannot follow,
the reference waits for it. What is written here is in `Numbers`, so that it is part of the servo's state.
"""

from __future__ import annotations

from math import exp, hypot, sqrt
from typing import NamedTuple

import numpy as np

from optsc.control.servo_settings import ServoSettings
from optsc.control.state import Numbers
from optsc.control.status import (
    FOLLOWING,
    STILL,
    Miss,
    Verdict,
    judge,
    within,
)
from optsc.geometry import scalar
from optsc.geometry.rotation import Array
from optsc.ik import DifferentialIK, ramp_time, tool_braking
from optsc.ik.avoidance import Avoidance
from optsc.ik.differential import IkStep, smoothness
from optsc.kernels.kernel import build_kernel
from optsc.kernels.reference import ReferenceSettings, reference_model
from optsc.kernels.settling import SettlingSettings, settled
from optsc.operators import prediction
from optsc.robot.manipulability import typical_volume
from optsc.shaping import JointGuard

SINGULAR_SHARE = 0.1
"""Share of the arm's typical manipulability below which it may be losing a direction (tuned here)."""
NEAR = 0.8
"""Share of `ServoSettings.far` from which on the reference begins to wait for the arm (tuned here)."""
STALLED = 0.1
"""Time [s] without much to gain after which nothing counts as leading nearer (tuned here)."""
LAGGING = (5e-3, 0.02)
"""Distance and angle [m, rad] of the tool to the reference up to which the reference does not wait (tuned here)."""
PUSHED = 5e-3
"""Rate [m/s] from which on a distance that has to grow is more than rounding (tuned here)."""
NEARBY = 0.1
"""Share of the greatest velocities that is a slow motion (tuned here)."""
AT_END = 1e-3
"""A joint this near to the end of its range [rad, m] counts as being there (tuned here)."""
WAITING = 9e-3
"""Time constant [s] with which a reference that waits takes on the target's own velocity (tuned here)."""

_PARTS = (ReferenceSettings.LINEAR, ReferenceSettings.ANGULAR)
PACE = 13
"""Where the pace of the target is in what the reference model returns of it."""
_RATES = (slice(7, 10), slice(13, 16)), (slice(10, 13), slice(16, 19))  # velocity, acceleration of a reference


class TrackingStep(NamedTuple):
    """One tick's answer.

    Attributes:
        velocity: of the joints (n,) [rad/s], within their bounds.
        ik: the IK's step.
        verdict: what holds the tick back.
        error: (6,) of the commanded tool to the target at the end of the tick, see `Command.error`.
    """

    velocity: Array
    ik: IkStep
    verdict: Verdict
    error: Array


class Tracking:
    """Leads a reference to a target and the tool along the reference.

    Args:
        ik: the quadratic program, for ticks of the servo.
        settings: how a target is followed.
        numbers: the servo's; joints are read, reference and waiting time are written.
        guard: of the joints.
        avoid: what the arm keeps clear of, if anything.
    """

    def __init__(
        self,
        ik: DifferentialIK,
        settings: ServoSettings,
        numbers: Numbers,
        guard: JointGuard,
        avoid: Avoidance | None,
    ) -> None:
        self.ik, self.robot, self.settings, self.numbers, self.guard = ik, ik.robot, settings, numbers, guard
        self.avoid = avoid
        self._model = build_kernel(reference_model(prediction.FADING))
        self._model.bind(0, numbers.reference)
        self._reference, self._target, self._elapsed, values, period, self._led = self._model.inputs
        self._next_reference, self._end = self._model.outputs
        limits = self.robot.limits
        # An arm that ramps its accelerations slowly cannot follow a quick reference.
        values[ReferenceSettings.BANDWIDTH] = min(settings.bandwidth, 1.0 / ramp_time(limits))
        for part, *pair in zip(_PARTS, tool_braking(limits), settings.catching_up, strict=True):
            values[part] = pair
        period[:] = ik.period
        self._braking = tool_braking(limits) if settings.ik.braking is None else settings.ik.braking
        self._waiting = 1.0 - exp(-ik.period / WAITING)
        self._singular_volume = SINGULAR_SHARE * typical_volume(self.robot)
        self._settled = build_kernel(settled(self.robot.chain))
        for index, memory in ((0, numbers.joints), (4, ik.descent), (5, self._end), (6, numbers.waiting)):
            self._settled.bind(index, memory)
        self._settled.bind(7, guard.interval)
        _, self._wish, self._free, self._resting, *_, self._bound, values = self._settled.inputs
        values[: SettlingSettings.PERIOD] = settings.ik.components
        weight, share = smoothness(settings.ik.smoothing, ik.period)
        values[SettlingSettings.PERIOD : SettlingSettings.SIZE] = ik.period, weight, share * ik.period
        values[SettlingSettings.SIZE :] = limits.velocity
        self._given, self._waited, self._error, self._sizes = self._settled.outputs

    def start(self) -> None:
        """Begin to lead the tool from where it is commanded to be, at the velocity that it has."""
        q, v, _ = self.guard.state
        X_WT, twist = self.robot.forward(q), self.robot.jacobian(q) @ v
        self._reference[:] = np.concatenate([X_WT.translation, X_WT.quaternion, twist, np.zeros(6)])
        self.numbers.waiting[:] = 0.0
        if self.settings.spare_motion == "stay":
            self.numbers.preferred[:] = q

    def aim(self, target: tuple[float, ...]) -> None:
        """Take a target (19,) in W: position, quaternion, twist and its derivative, at a time of its own."""
        self._target[:] = target

    def step(self, elapsed: float, led: float) -> TrackingStep:
        """Return the joint velocity of the tick that ends ``elapsed`` [s] after the target's time.

        ``led`` is the share of the target's acceleration that the reference is led along with.
        """
        self._elapsed[0], self._led[0] = elapsed, led
        self._model.run()
        reference, guard, numbers = self._reference, self.guard, self.numbers
        lowest, highest = guard.lowest, guard.highest
        # Copies: avoidance may be a user's, and what it writes there must not become the state or its limits.
        rows = None if self.avoid is None else self.avoid.rows(guard.q.copy(), lowest.copy(), highest.copy())
        pace = float(self._end[PACE])
        step = self.ik.solve(
            guard.columns,
            reference[:7],
            self._next_reference[7:13],
            numbers.preferred,
            lowest,
            highest,
            rows,
            min(pace, 1.0),
        )
        reference[:] = self._next_reference
        if not step.solved:
            return TrackingStep(step.velocity, step, FOLLOWING, step.error)
        unhurried = None if numbers.waiting[0] == 0.0 else self._unhurried()
        free = step.velocity if unhurried is None else unhurried
        self._resting[0] = unhurried is not None
        # Rows that lead the arm away from something have to be kept.
        self._bound[0] = rows is not None and (rows.lower > PUSHED).any()
        self._wish[:], self._free[:] = step.velocity, free
        self._settled.run()
        numbers.waiting[:] = self._waited
        self._wait(step.error)
        velocity, error = self._given.copy(), self._error.copy()
        return TrackingStep(velocity, step, self._judged(step, free, velocity, error, pace), error)

    def _unhurried(self) -> Array | None:
        """Return what an arm at rest would wish (n,) if its joints could change their velocities at once.

        Asked where there seems to be little to gain: an arm at rest can only begin slowly, which is not to stall. None
        for an arm that moves. Bodies count that are so near that they hold a slow motion.
        """
        guard = self.guard
        (q, v, _), (lower, upper), most = guard.columns, guard.limits.positions, guard.limits.velocity
        if (np.abs(v) > STILL * most).any():
            return None
        lowest = np.where(q - lower < AT_END, 0.0, -most)
        highest = np.where(upper - q < AT_END, 0.0, most)
        rows = None if self.avoid is None else self.avoid.rows(q.copy(), NEARBY * lowest, NEARBY * highest)
        return self.ik.at_once(lowest, highest, rows)

    def _judged(self, step: IkStep, free: Array, velocity: Array, error: Array, pace: float) -> Verdict:
        """Return what holds a tick back that wishes ``free`` (n,), after which the tool has this error (6,)."""
        distance, angle, speed, turning, fastest = self._sizes.tolist()
        if within(distance, angle, speed, turning):
            return FOLLOWING if pace >= 1.0 or fastest < STILL else Verdict.spare(self.robot, velocity)
        far = distance > self.settings.far[0] or angle > self.settings.far[1]
        stalled = float(self.numbers.waiting[0]) > STALLED
        miss = Miss(error, (distance, angle), far, stalled, step.volume < self._singular_volume)
        # Judged is what is wished, not what is given of it.
        near = None if self.avoid is None else self.avoid.blocking(free.copy())
        wished = np.minimum(np.maximum(free, self.guard.lowest), self.guard.highest)
        return judge(self.robot, self.guard, wished, near, miss)

    def _wait(self, error: Array) -> None:
        """Let the reference wait for an arm that has fallen behind, so that there is no distance to make up in a rush.

        By what it draws away faster than the target moves is limited to what the pull towards it leaves of the speed of
        catching up, and near the greatest distance to nothing.
        """
        x, y, z, a, b, c = error.tolist()
        if hypot(x, y, z) <= LAGGING[0] and hypot(a, b, c) <= LAGGING[1]:
            return
        reference, far, ik = self._reference, self.settings.far, self.ik
        X_WT = self.robot.forward(self.guard.q)
        tool_q = tuple(X_WT.quaternion.tolist())
        turn = scalar.log(scalar.multiply(tuple(reference[3:7].tolist()), scalar.conjugate(tool_q)))
        aheads = reference[:3] - X_WT.translation, np.array(turn)
        for k, (ahead, (velocity, acceleration)) in enumerate(zip(aheads, _RATES, strict=True)):
            size = sqrt(float(ahead @ ahead))
            pull = min(ik.gain * size, sqrt(self._braking[k] * size))
            firmness = min(max((size / far[k] - NEAR) / (1.0 - NEAR), 0.0), 1.0)
            allowed = (1.0 - firmness) * max(self.settings.catching_up[k] - pull, 0.0)
            away = ahead / (size + 1e-12)
            excess = float(away @ (reference[velocity] - self._end[velocity])) - allowed
            if excess > 0.0:
                reference[velocity] -= self._waiting * excess * away
                reference[acceleration] -= self._waiting * max(float(away @ reference[acceleration]), 0.0) * away
        reference[:3] = X_WT.translation + scalar.shortened(tuple(aheads[0].tolist()), far[0])
        reference[3:7] = scalar.multiply(scalar.exp(scalar.shortened(turn, far[1])), tool_q)
