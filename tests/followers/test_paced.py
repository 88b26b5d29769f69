"""A simulated arm at the pace of the clock."""

import numpy as np
import pytest

from optsc.followers import IdealFollower, PacedFollower
from optsc.followers.paced import CATCH_UP_LIMIT
from optsc.robot import load_robot


class Clock:
    def __init__(self):
        self.now, self.slept = 5.0, []

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds


def test_a_paced_arm_keeps_to_the_clock_and_does_not_race_after_a_stall():
    robot, clock = load_robot("panda"), Clock()
    with PacedFollower(IdealFollower(robot), clock, clock.sleep) as arm:
        arm.reset(robot.home)

        def step():
            return arm.apply(robot.home, np.zeros(robot.n), 0.0, 0.01)

        for _ in range(3):
            step()
            clock.now += 0.004
        assert clock.slept == pytest.approx([0.01, 0.006, 0.006])
        clock.now += 0.02  # late by a little: it catches up
        for _ in range(3):
            step()
        assert clock.slept[3:] == pytest.approx([0.006])
        assert arm.lost == 0.0
        clock.now += 10 * CATCH_UP_LIMIT
        step()
        assert arm.lost == pytest.approx(10 * CATCH_UP_LIMIT - 0.01)
        step()
        assert clock.slept[4:] == pytest.approx([0.01])
        assert arm.state().time == pytest.approx(0.08)
