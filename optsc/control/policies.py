"""Arbitration policies: the hand alone, hand-over at a trigger or by itself, blending, fixtures, hindsight."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot, pi
from types import MappingProxyType
from typing import Annotated, ClassVar

import numpy as np

from optsc.checks import Checked, NonNegative, Pair, Positive, Share
from optsc.control.arbitration import (
    HAND_ALONE,
    Arbitration,
    Blend,
    Goal,
    GraspPose,
    Moment,
    Trigger,
    blended,
    limited,
    offset,
    ramp,
    towards,
)
from optsc.errors import InvalidValue, UnknownName
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Vector
from optsc.selection.intent import HuberCost, IntentSettings


@dataclass(frozen=True)
class Alternating(Arbitration):
    """Alternating control (Chen et al. 2023): u = u_h until the trigger, then the robot alone until the next."""

    name: ClassVar[str] = "alternating"
    trigger: ClassVar[Trigger] = Trigger.HANDS_OVER
    assists: ClassVar[bool] = False


@dataclass(frozen=True)
class Automatic(Checked, Arbitration):
    """The robot begins by itself once the same object has been intended for a while; the operator may step in.

    From then on it is `Alternating`: who has stepped in hands over again with the trigger.

    Attributes:
        dwell: for how long the same object has to be intended [s].
    """

    dwell: Annotated[float, NonNegative] = 0.5

    name: ClassVar[str] = "automatic"
    trigger: ClassVar[Trigger] = Trigger.HANDS_OVER
    assists: ClassVar[bool] = False

    def begins(self, intended_for: float) -> bool:
        """Tell whether the object has been intended long enough."""
        return intended_for >= self.dwell


@dataclass(frozen=True)
class Continuous(Checked, Arbitration):
    """Continuous blending, u = (1 - alpha) u_h + alpha u_r, towards the grasp of greatest manipulability.

    Known of Zhu et al. (IEEE Access, 2023): it "dynamically and continuously" blends the user's intention with
    assistance, and the grasp is the one of best manipulability, whatever the hand's pose. The law by which it
    blends is not known. Here it is the distance confidence that is usual elsewhere: alpha = most max(0, 1 - d / reach),
    with d the distance from the tool to that grasp, changing no quicker than ``rate``.

    Attributes:
        reach: distance at which the robot begins to help [m].
        most: the largest alpha [1].
        rate: by how much alpha changes at most [1/s].
    """

    reach: Annotated[float, Positive] = 0.3
    most: Annotated[float, Share] = 0.6
    rate: Annotated[float, Positive] = 2.0

    name: ClassVar[str] = "continuous"

    def aim(self, goal: Goal) -> GraspPose:
        """Return the grasp of greatest manipulability."""
        return goal.best

    def blend(self, moment: Moment) -> Blend:
        """Return A = (1 - alpha) I and r = alpha u_r."""
        goal = moment.goal
        if goal is None:
            return HAND_ALONE
        shift, _ = offset(moment, self.aim(goal))
        wanted = self.most * max(0.0, 1.0 - hypot(*shift) / self.reach)
        return blended(moment, wanted, self.rate, self.aim(goal))


@dataclass(frozen=True)
class ProductOfExperts(Checked, Arbitration):
    """Product of Gaussian experts: the velocity that hand and goals find most likely together.

        Lambda = Lambda_h + sum_g beta_g Lambda_g,   u = Lambda^-1 (Lambda_h u_h + sum_g beta_g Lambda_g u_g)

    The blending of K. Hansel, J. Urain, J. Peters, G. Chalvatzaki, "Hierarchical policy blending as inference for
    reactive robot control", 2022, without its planner. An expert that stands for a goal is sure across the path to it
    and less so along it: it corrects the direction more than the speed. Linear blending is the special case of scalar
    precisions. The weights are tuned here: beta_g = max(0, b_g - 1/K) / (1 - 1/K), the belief beyond knowing nothing;
    1 for a single object.

    Attributes:
        hand: standard deviations of the hand's velocity [m/s, rad/s].
        across, along: those of a goal's velocity, across the path to it and along it [m/s, rad/s].
    """

    hand: Annotated[tuple[float, float], Pair] = (0.05, 0.25)
    across: Annotated[tuple[float, float], Pair] = (0.05, 0.25)
    along: Annotated[tuple[float, float], Pair] = (0.1, 0.5)

    name: ClassVar[str] = "product of experts"

    def blend(self, moment: Moment) -> Blend:
        """Return A = Lambda^-1 Lambda_h and r = Lambda^-1 sum_g beta_g Lambda_g u_g."""
        if not moment.goals:
            return HAND_ALONE
        by_hand = np.diag(np.repeat(np.array(self.hand) ** -2.0, 3))
        total, wish = by_hand.copy(), np.zeros(6)
        for goal, beta in zip(moment.goals, weights([g.probability for g in moment.goals]), strict=True):
            shift, turn = offset(moment, self.aim(goal))
            precision = np.zeros((6, 6))
            precision[:3, :3] = self._precision(0, shift)
            precision[3:, 3:] = self._precision(1, turn)
            total += beta * precision
            u_g = towards(moment, self.aim(goal))
            wish += beta * (precision @ u_g)
        A = np.asarray(np.linalg.solve(total, by_hand), dtype=float)
        r = np.asarray(np.linalg.solve(total, wish), dtype=float)
        return Blend(A, r, 1.0 - float(np.trace(A)) / 6.0)

    def _precision(self, part: int, path: Vector) -> Array:
        """Return the precision (3, 3) of a goal's velocity: low along the path, high across it."""
        across, along = self.across[part] ** -2.0, self.along[part] ** -2.0
        length = hypot(*path)
        if length < 1e-9:
            return across * np.eye(3)
        d = np.array(path) / length
        return across * np.eye(3) + (along - across) * np.outer(d, d)


def weights(probability: list[float]) -> list[float]:
    """Return beta_g: how far each probability is above that of knowing nothing, 1 where it is certain."""
    count = len(probability)
    if count == 1:
        return [1.0]
    return [max(0.0, b - 1.0 / count) / (1.0 - 1.0 / count) for b in probability]


@dataclass(frozen=True)
class VirtualFixture(Checked, Arbitration):
    """Guidance fixture: u = ([D] + k_tau (I - [D])) u_h, with [D] = D (D^T D)^+ D^T the preferred directions.

    P. Marayong et al., "Spatial motion constraints", 2003. Preferred are here the line and the axis that lead to the
    nearest grasp of the most probable object, both ways. The fixture closes with the belief, which is added here: k_tau
    runs from 1, free, to its value as the lead of that object rises from ``low`` to ``high``; and it opens again
    within ``near`` of the grasp, where there is no direction to speak of.

    Attributes:
        k_tau: what is left of motion in other directions, from 0, hard, to 1, free [1].
        low, high: leads between which the fixture closes [1].
        near: distance and angle to the grasp within which it opens [m, rad].
        rate: by how much its hold changes at most [1/s].
    """

    k_tau: Annotated[float, Share] = 0.3
    low: Annotated[float, Share] = 0.4
    high: Annotated[float, Share] = 0.8
    near: Annotated[tuple[float, float], Pair] = (0.03, 0.2)
    rate: Annotated[float, Positive] = 2.0

    name: ClassVar[str] = "virtual fixture"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.low > self.high:
            raise InvalidValue("low, high", (self.low, self.high), "0 <= low <= high <= 1")

    def blend(self, moment: Moment) -> Blend:
        """Return A = I - hold (1 - k_tau) (I - [D]) and r = 0; the share is hold (1 - k_tau)."""
        goal = moment.goal
        if goal is None:
            return HAND_ALONE
        paths = offset(moment, self.aim(goal))
        wanted = (1.0 - self.k_tau) * ramp(moment.gap, self.low, self.high)
        share = limited(moment.last.share, wanted, self.rate * moment.period)
        A = np.eye(6)
        for part, path in enumerate(paths):
            block = slice(3 * part, 3 * part + 3)
            A[block, block] -= share * min(1.0, hypot(*path) / self.near[part]) * across(path)
        return Blend(A, HAND_ALONE.robot, share)


def across(path: Vector) -> Array:
    """Return I - [D] (3, 3) of a single preferred direction: what is left across it."""
    length = hypot(*path)
    if length < 1e-9:
        return np.zeros((3, 3))
    d = np.array(path) / length
    return np.eye(3) - np.outer(d, d)


@dataclass(frozen=True)
class Hindsight(Checked, Arbitration):
    """Hindsight optimisation, or QMDP: u = u_h + sum_g b_g a_g, with a_g the descent of the cost-to-go of object g.

    S. Javdani, S. Srinivasa, J. A. Bagnell, "Shared autonomy via hindsight optimization", 2015 and 2018, with the
    constants of the authors' program: a_g = -V_t'(d) / 40 along the line and -V_r'(a) / 0.05 about the axis that lead
    to the nearest grasp of g, made proportional to distance and angle within 2 cm and 15 degrees of it. Far away that
    is 0.061 m/s and 0.294 rad/s. There is help before anything is certain, and in the middle of two grasps it
    cancels.

    Attributes:
        translation, rotation: cost-to-go over distance and angle.
        dampings: what the derivatives are divided by [s/m^2, s/rad^2].
        near: distance and angle within which the help falls to zero [m, rad].
    """

    translation: HuberCost = field(default_factory=lambda: IntentSettings().translation)
    rotation: HuberCost = field(default_factory=lambda: IntentSettings().rotation)
    dampings: Annotated[tuple[float, float], Pair] = (40.0, 0.05)
    near: Annotated[tuple[float, float], Pair] = (0.02, pi / 12)

    name: ClassVar[str] = "hindsight optimisation"

    def blend(self, moment: Moment) -> Blend:
        """Return A = I and r = sum_g b_g a_g; the share is the probability of the most probable object."""
        goal = moment.goal
        if goal is None:
            return HAND_ALONE
        r = np.zeros(6)
        for g in moment.goals:
            shift, turn = offset(moment, self.aim(g))
            r[:3] += g.probability * self._descent(self.translation, 0, shift)
            r[3:] += g.probability * self._descent(self.rotation, 1, turn)
        return Blend(HAND_ALONE.hand, r, goal.probability)

    def _descent(self, cost: HuberCost, part: int, path: Vector) -> np.ndarray:
        length = hypot(*path)
        slope = float(cost.derivative(np.array(length))) / self.dampings[part]
        return np.array(path) * slope / max(length, self.near[part])


@dataclass(frozen=True)
class LinearBlending(Checked, Arbitration):
    """Linear blending, u = (1 - alpha) u_h + alpha u_r, towards the nearest grasp of the most probable object.

    A. Dragan, S. Srinivasa, "A policy-blending formalism for shared control", 2013. The confidence is the lead c of
    the most probable object over the second; alpha = most (c - low) / (high - low), between 0 and ``most``, the
    piecewise linear form of Gopinath et al.; equal thresholds make it the switch at a lead of 0.4 in the program of
    Javdani et al., whose largest alpha is 0.6 too. The rate limit of alpha and the upper threshold are tuned here.

    Attributes:
        low, high: leads between which alpha rises [1].
        most: the largest alpha [1].
        rate: by how much alpha changes at most [1/s].
    """

    low: Annotated[float, Share] = 0.4
    high: Annotated[float, Share] = 0.8
    most: Annotated[float, Share] = 0.6
    rate: Annotated[float, Positive] = 2.0

    name: ClassVar[str] = "linear blending"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.low > self.high:
            raise InvalidValue("low, high", (self.low, self.high), "0 <= low <= high <= 1")

    def blend(self, moment: Moment) -> Blend:
        """Return A = (1 - alpha) I and r = alpha u_r."""
        goal = moment.goal
        if goal is None:
            return HAND_ALONE
        wanted = self.most * ramp(moment.gap, self.low, self.high)
        return blended(moment, wanted, self.rate, self.aim(goal))


@dataclass(frozen=True)
class Manual(Arbitration):
    """The hand alone, u = u_h; the trigger closes the jaws where they are."""

    name: ClassVar[str] = "manual"
    assists: ClassVar[bool] = False


POLICIES = MappingProxyType(
    {
        policy.name: policy
        for policy in (
            Alternating,
            Automatic,
            Continuous,
            Hindsight,
            LinearBlending,
            Manual,
            ProductOfExperts,
            VirtualFixture,
        )
    }
)
"""The policies that are built in, by name."""


def make_policy(name: str) -> Arbitration:
    """Return the policy of that name with its default settings; raise `UnknownName`."""
    if name not in POLICIES:
        raise UnknownName("arbitration policy", name, POLICIES)
    return POLICIES[name]()
