"""Differential inverse kinematics: the joint velocity of the next tick as a quadratic program.

With x (n,) [rad/s] the joint velocity of the next tick, s (m,) the slacks of the rows, and all quantities of the tool
in its own frame, so that a weight belongs to one degree of freedom of the tool:

    minimise  0.5 * sum((w * (J @ x - V))**2)                       tool task
            + 0.5 * w_p * sum((x - h)**2)                           posture task
            + 0.5 * (d + c) * sum(x**2)                             damping
            + 0.5 * w_s * sum((M @ (x - v - r * T * a))**2)         smoothness task
            + 0.5 * w_r * sum(s**2)                                 slack of soft rows

    within    lowest <= x <= highest                                bounds [rad/s]
              lower <= G @ x + s <= upper                           rows [m/s]

* q, v, a (n,): joint positions, velocities, accelerations; T the period [s]; J (6, n) the tool's Jacobian.
* e (6,): the reference's pose minus the present one [m, rad]; inside a dead band (`position_tolerance`) zero.
* V (6,): the reference's twist plus e at a gain k [1/s], but no faster than the tool can brake with b, nor than the
  joints can stop in the time t: per part of e,

      V = twist + min(k, sqrt(b / norm(e)), 1 / t) * e              [m/s, rad/s]

* t [s]: how long the joints take to brake from what they move besides following the twist.
* w (6,) [1/m, 1/rad]: `position_weight` and `orientation_weight`, zero inside a dead band; w_p: `posture_weight`.
* h (n,): `posture_gain` times the way to the posture q_p (of endless joints the shorter one), no faster than
  `posture_speed`; less where the tool is on its reference and the target rests, at rest nothing.
* d: `damping`; c: damping against curvature, with l the greatest lever of a joint [m] and P the pull V - twist:

      c = 0.4 * (l * norm(w**2 * P)[linear] + norm(w**2 * P)[angular]) * (1 / k + t)

* M' M is the Hessian of the first three terms, so that the smoothness task is the same filter in every direction of the
  joints; w_s, r: see `smoothness`.
* lowest, highest (n,): the viable interval of every joint, which comes from outside.
* G (m, n), lower, upper, w_r: `Rows`, such as distances that must not fall faster; hard (s = 0) without a weight. There
  are no equality constraints.

`tests/ik/test_differential.py` evaluates these lines.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np

from optsc.checks import Checked, Each, NonNegative, Positive, require
from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.ik.solvers import (
    DaqpSolver,
    QpSolution,
    QpSolver,
    Rows,
    make_solver,
    require_numbers,
    require_shapes,
    usable_answer,
)
from optsc.kernels.interior import interior_minimum
from optsc.kernels.kernel import build_kernel
from optsc.kernels.pose_task import PoseTaskSettings, pose_task
from optsc.robot.limits import JointLimits
from optsc.robot.manipulability import Manipulability
from optsc.robot.model import RobotModel

GAIN_PER_TICK = 0.3
"""Share of an error that one tick may take back; more lets the discrete loop overshoot."""
GAIN_PER_RAMP = 0.5
"""Share of an error that may be taken back while an acceleration is ramped up; more oscillates."""
LEVER = (0.4, 0.5)
"""Tool motion per joint motion that the weakest joint is counted on for [m/rad, rad/rad]; cautious for arms."""


def tool_braking(limits: JointLimits) -> tuple[float, float]:
    """Return a deceleration of the tool [m/s^2, rad/s^2] that every joint can give."""
    weakest = float(limits.acceleration.min())
    return LEVER[0] * weakest, LEVER[1] * weakest


def smoothness(time_constant: float, period: float) -> tuple[float, float]:
    """Return the weight of the smoothness task and the share of the acceleration that goes on.

    With z = exp(-T / time_constant) the task, in the metric of all others together, is a filter of their solution with
    a double pole at z: the same in seconds at every rate.
    """
    if time_constant == 0.0:
        return 0.0, 0.0
    z = float(np.exp(-period / time_constant))
    return (2.0 * z - z * z) / (1.0 - z) ** 2, z / (2.0 - z)


def ramp_time(limits: JointLimits) -> float:
    """Return the time [s] that the slowest joint takes to ramp up its acceleration at its jerk limit."""
    return float((limits.acceleration / limits.jerk).max())


@dataclass(frozen=True)
class IkSettings(Checked):
    """Weights and gains of the quadratic program.

    Attributes:
        position_weight: per axis x, y, z of the tool [1/m]; zero leaves that direction free.
        orientation_weight: about x, y, z of the tool [1/rad]; zero leaves that rotation free.
        position_tolerance: dead band along x, y, z of the tool [m]: within it that component is left free ...
        orientation_tolerance: ... and about x, y, z [rad]; zero for none. A free roll is a weight of zero.
        gain: how fast a small pose error decays [1/s].
        braking: deceleration of the tool that catching up counts on [m/s^2, rad/s^2]; bounds its speed. By default
            what the weakest joint gives at `LEVER`.
        posture_weight: weight of the posture task, small against the others [1].
        posture_gain: how fast spare motion goes to the posture [1/s].
        posture_speed: of spare motion at most, over all joints together [rad/s]. While the tool is on its target and
            the target rests, there is no spare motion.
        manipulability_gain: how strongly spare motion climbs the gradient of the penalised manipulability, in the
            velocity of the posture task [rad/s per unit of M and rad]; zero leaves it out.
        smoothing: time constant of the change of joint velocity [s]: when a joint saturates and the tool falls behind,
            the others take over smoothly; zero for none.
        damping: weight on joint speed; bounds it near singularities [1].
    """

    position_weight: Annotated[tuple[float, float, float], Each(NonNegative)] = (1.0, 1.0, 1.0)
    orientation_weight: Annotated[tuple[float, float, float], Each(NonNegative)] = (0.3, 0.3, 0.3)
    position_tolerance: Annotated[tuple[float, float, float], Each(NonNegative)] = (0.0, 0.0, 0.0)
    orientation_tolerance: Annotated[tuple[float, float, float], Each(NonNegative)] = (0.0, 0.0, 0.0)
    gain: Annotated[float, NonNegative] = 20.0
    braking: Annotated[tuple[float, float] | None, Each(NonNegative)] = None
    posture_weight: Annotated[float, NonNegative] = 1e-4
    posture_gain: Annotated[float, NonNegative] = 1.0
    posture_speed: Annotated[float, NonNegative] = 0.2
    manipulability_gain: Annotated[float, NonNegative] = 0.0
    smoothing: Annotated[float, NonNegative] = 4e-3
    damping: Annotated[float, NonNegative] = 1e-5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.manipulability_gain > 0 and self.posture_gain * self.posture_weight == 0:
            raise InvalidValue("manipulability_gain", self.manipulability_gain, "zero where there is no posture task")
        if self.damping + self.posture_weight <= 0:
            raise InvalidValue("damping", self.damping, "positive where there is no posture task")

    def feasible_gain(self, limits: JointLimits, period: float) -> float:
        """Return the gain [1/s] for joints of ``limits`` and ticks of ``period`` [s]: less where they are slow."""
        return min(self.gain, GAIN_PER_TICK / period, GAIN_PER_RAMP / ramp_time(limits))

    @property
    def components(self) -> Array:
        """Which components of the tool's pose count (6,), one or zero, and their tolerances (6,), as `settled`."""
        weights = (*self.position_weight, *self.orientation_weight)
        return np.array([*(float(w > 0) for w in weights), *self.position_tolerance, *self.orientation_tolerance])

    def vector(self, limits: JointLimits, period: float) -> Array:
        """Return the settings as `pose_task` reads them, for joints of ``limits`` and ticks of ``period`` [s]."""
        s = np.zeros(PoseTaskSettings.SIZE)
        s[PoseTaskSettings.WEIGHTS] = (*self.position_weight, *self.orientation_weight)
        s[PoseTaskSettings.TOLERANCE] = (*self.position_tolerance, *self.orientation_tolerance)
        s[PoseTaskSettings.GAIN] = self.feasible_gain(limits, period)
        s[PoseTaskSettings.BRAKING] = tool_braking(limits) if self.braking is None else self.braking
        s[PoseTaskSettings.POSTURE_WEIGHT] = self.posture_weight
        s[PoseTaskSettings.POSTURE_GAIN] = self.posture_gain
        s[PoseTaskSettings.POSTURE_SPEED] = self.posture_speed
        s[PoseTaskSettings.SMOOTHNESS] = smoothness(self.smoothing, period)[0]
        s[PoseTaskSettings.DAMPING] = self.damping
        return s


class IkStep(NamedTuple):
    """One tick's answer.

    Attributes:
        velocity: joint velocity of the next tick (n,) [rad/s]; meaningless unless solved.
        solved: whether the solver found it; `reason` says otherwise why.
        error: reference minus present tool pose (6,), in the tool frame [m, rad].
        volume: volume of the manipulability ellipsoid at the present configuration (Yoshikawa's index).
        iterations: of the solver; zero where the minimum without bounds is within them, so that it was not asked.
        reason: why not solved; empty when solved.
        slack: how far soft rows are missed at most, in their own unit.
    """

    velocity: Array
    solved: bool
    error: Array
    volume: float
    iterations: int
    reason: str
    slack: float = 0.0


@dataclass(eq=False)
class DifferentialIK:
    """Builds and solves one quadratic program per tick for ``robot`` at ticks of ``period`` [s]."""

    robot: RobotModel
    period: float
    settings: IkSettings = field(default_factory=IkSettings)
    solver: QpSolver = field(default_factory=make_solver)
    manipulability: Manipulability = field(default_factory=Manipulability)

    def __post_init__(self) -> None:
        require("period", self.period, Positive)
        self._kernel = build_kernel(pose_task(self.robot.chain, self.robot.endless.tolist()))
        self._q, self._v, self._a, self._reference, self._twist, self._posture, self._activity, most, onward, vector = (
            self._kernel.inputs
        )
        most[:] = self.robot.limits.acceleration
        self.gain = self.settings.feasible_gain(self.robot.limits, self.period)
        onward[:] = smoothness(self.settings.smoothing, self.period)[1] * self.period
        vector[:] = self.settings.vector(self.robot.limits, self.period)
        self._H, self._g, self._error, self._volume, self.descent = self._kernel.outputs
        """How the error falls (n + 2,), see `pose_task`: memory that the next tick changes."""
        self._interior = build_kernel(interior_minimum(self.robot.n))
        self._interior.bind(0, self._H)
        self._interior.bind(1, self._g)
        *_, self._lowest, self._highest = self._interior.inputs
        self._minimum, self._inside = self._interior.outputs

    def volume(self, q: Array) -> float:
        """Return the volume of the manipulability ellipsoid at configuration ``q`` (n,), as `IkStep.volume`."""
        self._q[:] = q
        self._kernel.run()
        return float(self._volume[0])

    def solve(
        self,
        state: tuple[Array, Array, Array],
        reference: Array,
        twist: Array,
        preferred: Array,
        lowest: Array,
        highest: Array,
        rows: Rows | None = None,
        activity: float = 1.0,
    ) -> IkStep:
        """Return the joint velocity of the next tick.

        Args:
            state: present joint positions, velocities and accelerations, each (n,), SI.
            reference: pose of T in W as position and quaternion (7,).
            twist: its linear and angular velocity (6,), in W.
            preferred: configuration (n,) [rad] that spare motion goes to.
            lowest, highest: bounds of the answer (n,) [rad/s].
            rows: further linear constraints on the answer.
            activity: share of the spare motion that is given while the tool is on its reference.

        Raises `InvalidValue` for rows that are none.
        """
        q, self._v[:], self._a[:] = state
        self._q[:], self._reference[:], self._twist[:] = q, reference, twist
        self._posture[:], self._activity[:] = preferred, activity
        if self.settings.manipulability_gain > 0:
            # A posture that lies uphill: the task's gain turns it into the wanted share of the gradient.
            uphill = self.manipulability.gradient(self.robot, q)
            self._posture[:] += self.settings.manipulability_gain / self.settings.posture_gain * uphill
        self._kernel.run()
        solution = self._solution(lowest, highest, rows)
        return IkStep(
            solution.x,
            solution.solved,
            self._error.copy(),
            float(self._volume[0]),
            solution.iterations,
            solution.reason,
            solution.slack,
        )

    def at_once(self, lowest: Array, highest: Array, rows: Rows | None) -> Array | None:
        """Return the solution (n,) of the last tick's program without smoothness, of an arm at rest; None if none is.

        Within other bounds and rows than the tick's.
        """
        weight = 1.0 + smoothness(self.settings.smoothing, self.period)[0]
        solution = self.solver.solve(self._H.T / weight, self._g, lowest, highest, rows)
        return solution.x if solution.solved else None

    def _solution(self, lowest: Array, highest: Array, rows: Rows | None) -> QpSolution:
        """Return the solution of the program that the kernel has written."""
        if rows is not None:
            require_shapes(rows, len(lowest))
        if type(self.solver) is DaqpSolver:
            # Mostly nothing holds the minimum, and then no solver is needed to find it.
            self._lowest[:], self._highest[:] = lowest, highest
            self._interior.run()
            if self._inside[0] == 1.0 and (rows is None or rows.met(self._minimum)):
                return QpSolution(self._minimum.copy(), True, 0)
        if rows is not None:
            require_numbers(rows)
        # H is symmetric, so the column-major buffer is read as row-major without a copy.
        # Copies of the bounds: what a user's solver writes there must not become the limits that are kept.
        answer = self.solver.solve(self._H.T, self._g, lowest.copy(), highest.copy(), rows)
        return usable_answer(answer, len(lowest), self.solver.name)
