"""World of the fault test: an arm, its controller with user-defined parts, and a snapshot in every control mode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from optsc.control.arbitration import Arbitration
from optsc.control.controller import SharedController
from optsc.control.controller_state import ControllerSnapshot, ControlStep
from optsc.control.fine_tuning import FineTuning
from optsc.control.modes import Mode
from optsc.control.policies import Alternating
from optsc.errors import SolverFailure
from optsc.geometry import Pose, rotation, scalar
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates
from optsc.operators import Button, ClutchSettings, OperatorSample
from optsc.robot import RobotModel
from optsc.selection import Cascade, GraspSelector
from optsc.selection.costs import ManipulabilityLoss, OrientationDistance
from optsc.selection.rules import Stage
from optsc.study.faults.arm_with_jaws import WIDTH, ArmState, ArmWithJaws
from optsc.study.faults.arms import arm
from optsc.study.faults.parts import (
    Hooks,
    UserAvoidance,
    UserCost,
    UserFilter,
    UserPolicy,
    UserSolver,
    user_clear,
    user_ik,
)

R_WS = tuple(rotation.exp([0.0, 0.0, 0.7]).tolist())
"""Orientation of the operator's station in W (w, x, y, z)."""
MOVED = 0.06
"""How far the hand moves in manual mode, before and while there is a fault [m] ..."""
MOVING_TIME = 1.2
"""... and for how long [s]."""
AFTER: Mapping[Mode, float] = {
    Mode.HOLD: 0.1,
    Mode.MANUAL: 0.7,
    Mode.APPROACH: 0.3,
    Mode.ADJUST: 0.1,
    Mode.ADVANCE: 0.3,
    Mode.CLOSE: 0.1,
    Mode.LIFT: 0.3,
    Mode.CARRY: 0.2,
    Mode.PLACE: 0.3,
    Mode.RELEASE: 0.1,
    Mode.RETREAT: 0.2,
}
"""How long after a mode has begun its snapshot is taken [s]."""
MODES = tuple(AFTER)
"""Modes that a fault is done in."""
LONGEST_MODE = 8.0
"""A mode that takes longer [s] is not left as it should be."""


def smooth(share: float) -> float:
    """Return the path of a minimum-jerk movement, from 0 to 1."""
    u = min(max(share, 0.0), 1.0)
    return u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)


class Start(NamedTuple):
    """Where a run begins.

    Attributes:
        controller: its snapshot.
        arm: the arm's state.
        hand: of the operator, in S.
        coupled: the tool and the hand, in W, at which the clutch closed; None while it is open.
        step: the last decision.
    """

    controller: ControllerSnapshot
    arm: ArmState
    hand: Pose
    coupled: tuple[Pose, Pose] | None
    step: ControlStep | None


class World:
    """An arm with its controller, which can be put into any mode.

    Args:
        name: of the arm, see `optsc.study.faults.arms`.
        rate: control rate [Hz].
        assisted: whether the policy is a user-defined one.
        timed: whether the loop tells the controller what time it is.

    Attributes:
        hooks: what the user-defined parts answer: "solver", "policy", "begins", "cost", "filter", "reason",
            "inverse kinematics", "clear", "rows", "stopping", "blocking", "obstacles", "hand may touch".
        starts: a snapshot in every mode, made by a run without a fault.

    Raises:
        SolverFailure: a mode is not reached.
    """

    def __init__(self, name: str, rate: float, *, assisted: bool = False, timed: bool = False) -> None:
        self.robot: RobotModel = arm(name)
        self.period, self.timed, self.hooks = 1.0 / rate, timed, Hooks()
        self.clear = user_clear(self.hooks)
        rule = Cascade((Stage(OrientationDistance(), 8), Stage(UserCost(self.hooks), 4), Stage(ManipulabilityLoss())))
        selector = GraspSelector(self.robot, rule, filters=(UserFilter(self.hooks),))
        selector.solver = replace(selector.solver, solve=user_ik(self.hooks, selector.solver.solve))
        policy: Arbitration = UserPolicy(self.hooks) if assisted else Alternating()
        self.controller = SharedController(
            self.robot,
            selector,
            arbitration=policy,
            fine_tuning=FineTuning(),
            clutch=ClutchSettings(R_WS=R_WS),
            avoid=UserAvoidance(self.hooks),
        )
        self.arm = ArmWithJaws(self.robot)
        self.candidates = scene(self.robot)
        self.controller.reset(self.robot.home, rate)
        self.take_solver()
        self.controller.observe(self.candidates, self.clear)
        self.starts = _Drive(self).starts()

    def take_solver(self) -> None:
        """Put the user's solver into the servo, which a reset makes again."""
        ik = self.controller.servo.ik
        if not isinstance(ik.solver, UserSolver):
            ik.solver = UserSolver(self.hooks, ik.solver)

    def restore(self, mode: Mode) -> Start:
        """Go back to the snapshot in ``mode``, all parts as they should be, and return it."""
        start = self.starts[mode]
        self.hooks.set({})
        self.take_solver()
        self.controller.selector.filters = self.controller.selector.filters[:1]
        self.controller.restore(start.controller)
        self.arm.now = start.arm
        return start

    def tick(self, sample: Any, measured: Any, now: Any = None) -> ControlStep:
        """Let the controller do one tick, and the arm follow it."""
        step = self.controller.step(sample, measured, now=now)
        self.follow(step)
        return step

    def follow(self, step: ControlStep) -> None:
        """Let the arm follow a command; raise `InvalidValue` for one that is none."""
        self.arm.apply(step.command.q, step.command.v, step.opening, self.period)

    def in_world(self, hand: Pose) -> Pose:
        """Return a hand in S in the world's axes."""
        R = self.controller.clutch.R_WS
        q, p = tuple(hand.quaternion.tolist()), tuple(hand.translation.tolist())
        return Pose(np.array(scalar.multiply(R, q)), np.array(scalar.rotate(R, p)))


class _Drive:
    """The run without a fault that the snapshots are taken from."""

    def __init__(self, world: World) -> None:
        self.world = world
        q = rotation.multiply(rotation.conjugate(np.array(R_WS)), world.robot.forward(world.robot.home).quaternion)
        self.hand = Pose(q, np.array([0.1, -0.2, 0.3]))
        self.coupled: tuple[Pose, Pose] | None = None
        self.step: ControlStep | None = None

    def starts(self) -> dict[Mode, Start]:
        """Return the snapshots."""
        found = {Mode.HOLD: self._after(Mode.HOLD, clutch=False)}
        tool = self.world.robot.forward(self.world.controller.servo.guard.q)
        self.coupled = tool, self.world.in_world(self.hand)
        found[Mode.MANUAL] = self._after(Mode.MANUAL, move=(0.0, 0.6, 0.8))
        self._ticks(MOVING_TIME - AFTER[Mode.MANUAL] + 0.3, move=(0.0, 0.6, 0.8), since=AFTER[Mode.MANUAL])
        self.coupled = None
        self._ticks(self.world.period, trigger=True)
        found[Mode.APPROACH] = self._after(Mode.APPROACH)
        found[Mode.ADJUST] = self._after(Mode.ADJUST)
        self._ticks(self.world.period, buttons=frozenset({Button.CONFIRM}))
        for mode in (Mode.ADVANCE, Mode.CLOSE, Mode.LIFT, Mode.CARRY):
            found[mode] = self._after(mode)
        self._ticks(self.world.period, buttons=frozenset({Button.PLACE}))
        for mode in (Mode.PLACE, Mode.RELEASE, Mode.RETREAT):
            found[mode] = self._after(mode)
        return found

    def _after(self, mode: Mode, **what: Any) -> Start:
        world = self.world
        for _ in range(round(LONGEST_MODE / world.period)):
            if world.controller.mode is mode:
                break
            self._ticks(world.period, **{name: x for name, x in what.items() if name != "move"})
        else:
            reason = "" if self.step is None else self.step.reason
            raise SolverFailure(
                f"{world.robot.name} is in {world.controller.mode.value}, not in {mode.value}: {reason}"
            )
        self._ticks(AFTER[mode], **what)
        return Start(world.controller.snapshot(), world.arm.now, self.hand, self.coupled, self.step)

    def _ticks(
        self, seconds: float, *, move: tuple[float, ...] = (0.0, 0.0, 0.0), since: float = 0.0, **sample: Any
    ) -> None:
        world = self.world
        axis = rotation.rotate(rotation.conjugate(np.array(R_WS)), np.array(move))
        for k in range(max(1, round(seconds / world.period))):
            time = since + k * world.period
            share = smooth((time + world.period) / MOVING_TIME) - smooth(time / MOVING_TIME)
            self.hand = Pose(self.hand.quaternion, self.hand.translation + MOVED * share * axis)
            now = world.controller.time
            said = now if world.timed else None
            self.step = world.tick(OperatorSample(now, self.hand, **sample), world.arm.measured(), said)


def scene(robot: RobotModel, seed: int = 0, count: int = 8, shift: Array | None = None) -> Candidates:
    """Return grasps of two objects below the tool at home, which points at them."""
    rng = np.random.default_rng(seed)
    X = robot.forward(robot.home)
    side = rotation.rotate(X.quaternion, [0.0, 1.0, 0.0])
    along = rotation.rotate(X.quaternion, [0.0, 0.0, 1.0])
    centres = [X.translation + 0.14 * along + sign * 0.05 * side for sign in (-1.0, 1.0)]
    p = np.repeat(np.array(centres), count, axis=0) + rng.uniform(-0.008, 0.008, (2 * count, 3))
    q = rotation.multiply(rotation.exp(rng.uniform(-0.15, 0.15, (2 * count, 3))), X.quaternion)
    return Candidates(
        object_names=("left", "right"),
        object_index=np.repeat([0, 1], count),
        grasp_index=np.tile(np.arange(count), 2),
        X_WG=Pose(q, p if shift is None else p + shift),
        opening=np.full(2 * count, WIDTH),
        quality=np.ones(2 * count),
        jaw_symmetric=True,
    )
