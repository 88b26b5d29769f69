"""A closed loop of controller and ideal arm that is driven tick by tick, and a scene to drive it in."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from optsc.control.arbitration import Arbitration
from optsc.control.controller import ControlStep, SharedController
from optsc.followers import IdealFollower
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates
from optsc.operators import ClutchSettings, OperatorSample, OperatorView
from optsc.robot import RobotModel
from optsc.selection.selector import GraspSelector

PERIOD = 1 / 500.0
"""Of the loop [s]."""
SAMPLE = 5
"""The hand is sampled at every fifth tick."""
R_WS = tuple(rotation.exp([0.0, 0.0, 0.7]))
"""Orientation of the operator's station in the world (w, x, y, z)."""
DOWN = np.array([0.0, 1.0, 0.0, 0.0])
PLACES = MappingProxyType({"left": (0.45, 0.2, 0.15), "middle": (0.6, 0.0, 0.12), "right": (0.5, -0.2, 0.12)})


def scene(places: Mapping[str, tuple[float, float, float]] = PLACES, count: int = 12, seed: int = 0) -> Candidates:
    """Return ``count`` grasps of each thing from above, tilted by up to half a radian, at places in the world."""
    rng = np.random.default_rng(seed)
    total = count * len(places)
    q = rotation.multiply(rotation.exp(rng.uniform(-0.3, 0.3, (total, 3))), DOWN)
    p = np.repeat(np.array(list(places.values())), count, axis=0) + rng.uniform(-0.01, 0.01, (total, 3))
    return Candidates(
        object_names=tuple(places),
        object_index=np.repeat(np.arange(len(places)), count),
        grasp_index=np.tile(np.arange(count), len(places)),
        X_WG=Pose(q, p),
        opening=np.full(total, 0.04),
        quality=np.ones(total),
        jaw_symmetric=True,
    )


def controller(robot: RobotModel, arbitration: Arbitration | None = None, **settings: Any) -> SharedController:
    """Return a shared controller with the default selector and the station's rotation."""
    clutch = ClutchSettings(R_WS=R_WS)
    return SharedController(robot, GraspSelector(robot), arbitration=arbitration, clutch=clutch, **settings)


class StraightOperator:
    """An `Operator` that leads the tool straight to a pose at 0.12 m/s, seeing where it is, and presses the trigger.

    Args:
        p: where the tool is led, pointing down (3,) [m].
        near: how near the tool has to be before the trigger is pressed [m], [rad].
    """

    def __init__(self, p: Array, near: tuple[float, float] = (0.012, 0.15)) -> None:
        self.goal, self.near = Pose(DOWN, np.array(p, dtype=float)), near
        self.hand: Pose | None = None
        self.pressed, self.seen = -9.0, 0.0

    def read(self, view: OperatorView) -> OperatorSample | None:
        """Return a sample at every `SAMPLE`-th period."""
        if round(view.time / PERIOD) % SAMPLE:
            return None
        to_station = rotation.conjugate(R_WS)
        if self.hand is None:
            self.hand = Pose(rotation.multiply(to_station, view.X_WT.quaternion), np.zeros(3))
        if not view.automatic and view.time > 0.2:
            shift = self.goal.translation - view.X_WT.translation
            turn = rotation.log(rotation.multiply(self.goal.quaternion, rotation.conjugate(view.X_WT.quaternion)))
            distance, angle = float(np.linalg.norm(shift)), float(np.linalg.norm(turn))
            step = min(view.time - self.seen, 0.05)
            v, w = shift * min(0.12 / (distance + 1e-9), 2.0), turn * min(0.4 / (angle + 1e-9), 2.0)
            self.hand = Pose(
                rotation.multiply(rotation.exp(rotation.rotate(to_station, w * step)), self.hand.quaternion),
                self.hand.translation + rotation.rotate(to_station, v * step),
            )
            if distance < self.near[0] and angle < self.near[1] and view.time > self.pressed + 1.0:
                self.pressed = view.time
        self.seen = view.time
        return OperatorSample(view.time, self.hand, True, 0 <= view.time - self.pressed < 0.1)


class Loop:
    """A controller with an ideal arm and a hand that is moved by `go`.

    Attributes:
        hand: where the hand is in the station frame.
        steps: what was decided, tick by tick.
        reference: pose (7,) that the tool was led along, tick by tick.
    """

    def __init__(
        self,
        robot: RobotModel,
        candidates: Candidates | None = None,
        clear: Any = None,
        arbitration: Arbitration | None = None,
        **settings: Any,
    ) -> None:
        self.robot, self.controller = robot, controller(robot, arbitration, **settings)
        self.controller.reset(robot.home)
        self.follower = IdealFollower(robot, between=candidates)
        self.measured = self.follower.reset(robot.home)
        q = rotation.multiply(rotation.conjugate(R_WS), robot.forward(robot.home).quaternion)
        self.hand = Pose(q, np.zeros(3))
        self.steps: list[ControlStep] = []
        self.reference: list[Array] = []
        if candidates is not None:
            self.controller.observe(candidates, clear)

    @property
    def time(self) -> float:
        """The controller's time [s]."""
        return self.controller.time

    def tick(self, sample: OperatorSample | None = None) -> ControlStep:
        """Go on by one tick."""
        step = self.controller.step(sample, self.measured)
        self.measured = self.follower.apply(step.command.q, step.command.v, step.opening, PERIOD)
        self.steps.append(step)
        self.reference.append(np.concatenate(self.controller.servo.reference))
        return step

    def go(self, seconds: float, move: Iterable[float] = (0.0, 0.0, 0.0), **sample: Any) -> ControlStep:
        """Move the hand steadily by a displacement in the world's axes [m]; the rest goes into every sample."""
        ticks = max(1, round(seconds / PERIOD))
        shift = rotation.rotate(rotation.conjugate(R_WS), np.asarray(move, dtype=float)) / ticks
        for k in range(ticks):
            self.hand = Pose(self.hand.quaternion, self.hand.translation + shift)
            self.tick(OperatorSample(self.time, self.hand, **sample) if k % SAMPLE == 0 else None)
        return self.steps[-1]

    def press(self, **sample: Any) -> ControlStep:
        """Press the trigger, and let go of it; return the step at which it was decided what comes of it."""
        step = self.decided(self.tick(OperatorSample(self.time, self.hand, trigger=True, **sample)))
        # Longer than presses are taken for one.
        self.go(0.16)
        return step

    def decided(self, step: ControlStep) -> ControlStep:
        """Go on from a step while a decision is in the making; return the step at which it was made."""
        while self.controller.state.choice.deciding is not None:
            step = self.tick()
        return step

    def tool(self) -> Pose:
        """Return where the tool is commanded to be."""
        return self.robot.forward(self.controller.servo.guard.q)


def modes(steps: Iterable[Any]) -> list[str]:
    """Return the modes of steps or ticks in their order."""
    found: list[str] = []
    for step in steps:
        if not found or step.mode.value != found[-1]:
            found.append(step.mode.value)
    return found


def assert_limits_hold(robot: RobotModel, steps: Iterable[ControlStep], period: float = PERIOD) -> None:
    """Hold position, velocity, acceleration and jerk to the limits at every tick, so that nothing jumps."""
    commands = [step.command for step in steps]
    q, v, a = (np.array([getattr(command, name) for command in commands]) for name in ("q", "v", "a"))
    assert np.all(np.isfinite(q))
    assert np.all(np.abs(v) <= robot.limits.velocity)
    assert np.all(np.abs(a) <= robot.limits.acceleration)
    assert np.all(np.abs(np.diff(a, axis=0)) <= robot.limits.jerk * period * (1 + 1e-9))
    assert np.all((q >= robot.limits.lower) & (q <= robot.limits.upper))
    np.testing.assert_allclose(np.diff(q, axis=0), 0.5 * (v[1:] + v[:-1]) * period, atol=1e-9)
