"""A simulated arm for the fault test: ideal, until it is braked, moved by hand, or finds something else in its jaws."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.followers.protocol import JAW_SPEED, FollowerState, checked_command
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel

WIDTH = 0.04
"""Of the objects between the jaws [m], as the grasps say."""


class ArmState(NamedTuple):
    """All that the arm is: a value, so that a run can begin anywhere.

    Attributes:
        state: as it would be measured.
        width: of what is between the jaws [m]; zero for nothing.
        braked: whether it stays where it is, whatever it is commanded.
        sag: by how much each joint is off its command (n,) [rad].
        jaws_stuck: whether the jaws stay as they are.
        let_go: whether it moves to where it is commanded to be, after its brakes were let go of there on purpose.
        jump: by how much a joint has moved further in one period than at its greatest speed, at most so far [rad].
    """

    state: FollowerState
    width: float
    braked: bool
    sag: Array
    jaws_stuck: bool = False
    let_go: bool = False
    jump: float = 0.0


class ArmWithJaws:
    """The arm; `now` is its state, which may be written."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        opening = robot.gripper.max_opening if robot.gripper else 0.0
        state = FollowerState(0.0, robot.home.copy(), np.zeros(robot.n), opening)
        self.now = ArmState(state, WIDTH, False, np.zeros(robot.n))

    def measured(self) -> FollowerState:
        """Return where it is; the arrays are copies."""
        time, q, v, opening = self.now.state
        return FollowerState(time, q.copy(), v.copy(), opening)

    @property
    def holding(self) -> bool:
        """Whether something of the right width is between the jaws, and they touch it."""
        return self.now.width > 0.0 and abs(self.now.state.opening - self.now.width) < 1e-6

    def apply(self, q: ArrayLike, v: ArrayLike, opening: float, period: float) -> None:
        """Follow a command for one period; raise `InvalidValue` for one that is none."""
        command = checked_command(self.robot, q, v, opening, period)
        now = self.now
        at, speed = (now.state.q, 0.0 * command.v) if now.braked else (command.q + now.sag, command.v)
        most = self.robot.limits.velocity * period
        if now.let_go:
            at = np.clip(at, now.state.q - most, now.state.q + most)
        jump = float(np.max(np.abs(at - now.state.q) - most))
        step = 0.0 if now.jaws_stuck else JAW_SPEED * period
        jaws = min(max(command.opening, now.state.opening - step), now.state.opening + step)
        if 0.0 < now.width <= now.state.opening + 1e-12:
            jaws = max(jaws, now.width)
        state = FollowerState(now.state.time + period, at, speed, jaws)
        let_go = now.let_go and bool(np.any(at != command.q + now.sag))
        self.now = now._replace(state=state, jump=max(now.jump, jump), let_go=let_go)

    def move(self, offset: ArrayLike) -> None:
        """Put the joints elsewhere by ``offset`` (n,) [rad], as somebody does who pushes a braked arm."""
        state = self.now.state
        self.now = self.now._replace(state=state._replace(q=state.q + np.asarray(offset, dtype=float)))

    def change(self, **fields: object) -> None:
        """Change fields of `ArmState`."""
        self.now = self.now._replace(**fields)  # type: ignore[arg-type]
