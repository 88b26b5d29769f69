"""Tracking of a target: the reference is led to it, the tool to the reference, and a verdict says what held it back.

One tick: the reference model moves on towards the target (`optsc.kernels.reference`), the quadratic program gives the
joint velocity with which the tool goes after the reference (`optsc.ik.differential`), and where the arm cannot follow,
the reference waits for it. What is written here is in `Numbers`, so that it is part of the servo's state.
"""

from __future__ import annotations

from math import exp
from typing import NamedTuple

import numpy as np

from optsc.control.servo_settings import ServoSettings
from optsc.control.state import Numbers
from optsc.control.status import FOLLOWING, Status, Verdict, held_back, near_singularity
from optsc.geometry import Pose, scalar
from optsc.geometry.rotation import Array
from optsc.ik import DifferentialIK, ramp_time, tool_braking
from optsc.ik.avoidance import Avoidance
from optsc.ik.differential import IkStep
from optsc.kernels.kernel import build_kernel
from optsc.kernels.reference import ReferenceSettings, reference_model
from optsc.kernels.viable import Bound
from optsc.operators import prediction
from optsc.shaping import JointGuard

NEAR = 0.99
"""Share of the square of `ServoSettings.far` up to which a target is within reach."""
SINGULAR_SHARE = 0.1
"""Share of the manipulability at home below which the arm may be losing a direction (tuned here)."""
NOTICEABLE = (1e-3, 5e-3)
"""Distance and angle to the reference [m, rad] up to which the arm counts as following, whatever limit it touches
(tuned here): half of what the tool may be off."""
BEHIND = (4e-3, 2e-2)
"""Distance and angle of the reference to its target [m, rad] from which on an arm at a limit counts as held back even
where the reference has waited for it (tuned here): a quick hand is half of that ahead of a free arm."""
WAITING = 9e-3
"""Time constant [s] with which the reference goes to an arm that is at a limit of its rates (tuned here)."""

_PARTS = (ReferenceSettings.LINEAR, ReferenceSettings.ANGULAR)


class TrackingStep(NamedTuple):
    """One tick's answer: the joint velocity (n,) [rad/s] within its bounds, the IK's step, and what held it back."""

    velocity: Array
    ik: IkStep
    verdict: Verdict


class Tracking:
    """Leads a reference to a target and the tool along the reference.

    Args:
        ik: the quadratic program, for ticks of the servo.
        settings: how a target is followed.
        numbers: the servo's; joints are read, the reference is written.
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
        self._next_reference, self._gap = self._model.outputs
        limits = self.robot.limits
        # An arm that ramps its accelerations slowly cannot follow a quick reference.
        values[ReferenceSettings.BANDWIDTH] = min(settings.bandwidth, 1.0 / ramp_time(limits))
        for part, *pair in zip(_PARTS, tool_braking(limits), settings.catching_up, strict=True):
            values[part] = pair
        period[:] = ik.period
        self._waiting = 1.0 - exp(-ik.period / WAITING)
        self._singular_volume = SINGULAR_SHARE * ik.volume(self.robot.home)

    def start(self) -> None:
        """Begin to lead the tool from where it is commanded to be, at the velocity that it has."""
        q, v, _ = self.guard.state
        X_WT, twist = self.robot.forward(q), self.robot.jacobian(q) @ v
        self._reference[:] = np.concatenate([X_WT.translation, X_WT.quaternion, twist, np.zeros(6)])

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
        step = self.ik.solve(
            guard.columns, reference[:7], self._next_reference[7:13], numbers.preferred, lowest, highest, rows
        )
        reference[:] = self._next_reference
        if not step.solved:
            return TrackingStep(step.velocity, step, FOLLOWING)
        # A little inside, or a reference that waits at just this distance would count as near at every other tick.
        squares = _squares(step.error)
        far = _exceeds(squares, self.settings.far, NEAR)
        gap = self._gap.tolist()
        noticeable = _exceeds(squares, NOTICEABLE) or gap[0] > BEHIND[0] or gap[1] > BEHIND[1]
        if far:
            self._wait()
        wanted = np.minimum(np.maximum(step.velocity, guard.lowest), guard.highest)
        verdict = FOLLOWING
        if noticeable:
            near = None if self.avoid is None else self.avoid.blocking(wanted.copy())
            verdict = held_back(self.robot, guard, wanted, near, far)
        if verdict.status is Status.LIMITED:
            self._yield(wanted)
        if step.volume < self._singular_volume and noticeable:
            verdict = near_singularity(self.robot, guard.q, step.error, verdict)
        return TrackingStep(wanted, step, verdict)

    def _wait(self) -> None:
        """Let the reference wait for an arm that cannot follow, so that there is no distance to make up in a rush."""
        X_WT, reference = self._tool(), self._reference
        tool_q = tuple(X_WT.quaternion.tolist())
        far_p, far_r = self.settings.far
        ahead = scalar.shortened(tuple((reference[:3] - X_WT.translation).tolist()), far_p)
        turn = scalar.log(scalar.multiply(tuple(reference[3:7].tolist()), scalar.conjugate(tool_q)))
        reference[:3] = X_WT.translation + ahead
        reference[3:7] = scalar.multiply(scalar.exp(scalar.shortened(turn, far_r)), tool_q)

    def _tool(self) -> Pose:
        return self.robot.forward(self.guard.q)

    def _yield(self, wanted: Array) -> None:
        """Lead the reference to an arm that a limit of its rates holds back, so that it does not have to run after.

        An arm that presses against the end of a joint is left alone: there is nothing that it could catch up with.
        """
        guard, reference = self.guard, self._reference
        bounds = np.where(wanted <= guard.lowest, guard.bounds[:, 0], -1.0)
        bounds = np.where(wanted >= guard.highest, guard.bounds[:, 1], bounds)
        if (bounds == Bound.POSITION).any():
            return
        share = self._waiting
        X_WT, own = self._tool(), tuple(reference[3:7].tolist())
        back = scalar.log(scalar.multiply(tuple(X_WT.quaternion.tolist()), scalar.conjugate(own)))
        turn = scalar.exp((share * back[0], share * back[1], share * back[2]))
        reference[:3] += share * (X_WT.translation - reference[:3])
        reference[3:7] = scalar.multiply(turn, own)
        reference[7:13] += share * (self.robot.jacobian(guard.q) @ wanted - reference[7:13])


def _squares(error: Array) -> tuple[float, float]:
    """Return the squares of distance and angle of a pose error (6,)."""
    x, y, z, a, b, c = error.tolist()
    return x * x + y * y + z * z, a * a + b * b + c * c


def _exceeds(squares: tuple[float, float], limits: tuple[float, float], share: float = 1.0) -> bool:
    """Tell whether a pose error is beyond a distance or an angle; ``share`` scales their squares."""
    return squares[0] > share * limits[0] ** 2 or squares[1] > share * limits[1] ** 2
