"""Arrived is where the tool is measured: an arm that is elsewhere never closes its jaws."""

import numpy as np
import pytest

import optsc
from optsc.control.modes import Event, Mode
from optsc.control.policies import make_policy
from optsc.geometry import Pose, rotation
from optsc.robot import load_robot
from optsc.testing.loop import R_WS, Loop, modes, scene


class Misplaced(Loop):
    """A loop whose arm is off its command by ``off`` (n,) [rad] from a mode on, and is measured to be so."""

    off = 0.0
    since = Mode.APPROACH

    def tick(self, sample=None):
        step = super().tick(sample)
        if self.controller.mode.automatic or self.since is Mode.MANUAL:
            self.measured = self.measured._replace(q=step.command.q + self.off)
        return step


def misplaced(robot, off, **options):
    loop = Misplaced(robot, scene(), **options)
    loop.go(0.3)
    loop.off = off
    return loop


@pytest.mark.parametrize("name", ["panda", "xarm7"])
@pytest.mark.parametrize("size", [0.1, 0.2, 0.29])
def test_an_arm_that_is_off_its_command_does_not_close_its_jaws(name, size):
    robot = load_robot(name)
    rng = np.random.default_rng(round(1000 * size))
    off = rng.uniform(-size, size, robot.n)
    off[1] = rng.choice([-size, size])
    loop = misplaced(robot, off)
    assert loop.press().event is Event.TRIGGERED
    for _ in range(40):
        if loop.go(0.25).mode is Mode.HOLD:
            break
    assert Mode.HOLD in [step.mode for step in loop.steps[200:]]
    assert not {"advance", "close", "lift"} & set(modes(loop.steps))
    assert all(step.opening > 0.0 for step in loop.steps)
    reason = next(step.reason for step in loop.steps if "stuck on the path" in step.reason)
    target = next(step.target for step in loop.steps if step.mode is Mode.APPROACH)
    there = robot.forward(loop.steps[-1].command.q + off).translation
    stated = float(reason.split("is measured ")[1].split(" mm")[0])
    assert stated > 5.0
    assert stated == pytest.approx(1e3 * np.linalg.norm(there - target.X_WP.translation), abs=30.0)


def test_an_arm_that_sags_a_little_arrives():
    robot = load_robot("panda")
    loop = misplaced(robot, np.full(robot.n, 2e-3))
    loop.press()
    loop.go(6.0)
    assert "advance" in modes(loop.steps)


@pytest.mark.parametrize(("size", "closes"), [(0.0, True), (0.1, False), (0.2, False), (0.29, False)])
def test_a_grasp_by_hand_is_judged_where_the_tool_is_measured(size, closes):
    robot = load_robot("panda")
    grasps = scene()
    at = optsc.solve_ik(robot, grasps.X_WG[:4], rng=np.random.default_rng(0))
    loop = Misplaced(robot, arbitration=make_policy("manual"))
    loop.controller.reset(at.q[np.flatnonzero(at.success)[0]])
    loop.measured = loop.follower.reset(loop.controller.servo.guard.q)
    loop.controller.observe(grasps)
    tool = loop.tool()
    loop.hand = Pose(rotation.multiply(rotation.conjugate(R_WS), tool.quaternion), np.zeros(3))
    loop.go(0.3)
    assert loop.controller.mode is Mode.MANUAL
    loop.since, loop.off = Mode.MANUAL, size * np.array([0.0, 1.0, 0.0, -1.0, 0.0, 0.5, 0.0])
    loop.go(0.2)
    loop.press()
    assert ("close" in modes(loop.steps)) is closes
    assert closes or any("mm and" in step.reason for step in loop.steps)
