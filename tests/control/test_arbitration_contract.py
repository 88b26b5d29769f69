"""The contract of arbitration policies, tried on each of them, and what the controller makes of impossible answers."""

from dataclasses import dataclass

import numpy as np
import pytest

from optsc.control.arbitration import Arbitration, Blend
from optsc.control.modes import Event, Mode
from optsc.control.policies import POLICIES, Continuous, make_policy
from optsc.geometry import Pose
from optsc.operators import OperatorSample
from optsc.robot import load_robot
from optsc.testing import ArbitrationContract
from optsc.testing.loop import PERIOD, SAMPLE, Loop, assert_limits_hold, scene


@dataclass(frozen=True)
class Wild(Arbitration):
    """A policy that asks for the impossible, another impossible thing at every tick."""

    name = "wild"

    def blend(self, moment):
        """Return large numbers of changing signs."""
        sign = np.sin(1e3 * moment.p[0] + 1e4 * moment.hand[0])
        return Blend(1e3 * sign * np.ones((6, 6)), -1e6 * sign * np.ones(6), 1.0)


@dataclass(frozen=True)
class Broken(Arbitration):
    """A policy that answers with what is no blend."""

    answer: Blend

    name = "broken"

    def blend(self, moment):
        """Return it."""
        return self.answer


class TestBuiltIn(ArbitrationContract):
    @pytest.fixture(autouse=True, params=POLICIES)
    def _each(self, request):
        self.policy = make_policy(request.param)
        # Who is led elsewhere by continuous blending has to content themselves with the robot's grasp.
        if isinstance(self.policy, Continuous):
            self.near = (0.03, 0.5)

    def make_policy(self):
        return self.policy


class TestWild(ArbitrationContract):
    # It pulls always, and nowhere.
    test_a_hand_at_rest_keeps_still_where_nothing_is_in_reach = None
    test_without_anything_in_reach_the_tool_goes_where_the_hand_goes = None
    test_an_operator_and_the_policy_grasp_the_intended_object = None

    def make_policy(self):
        return Wild()


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


@pytest.mark.parametrize(
    "answer",
    [
        Blend(np.eye(6), np.full(6, np.nan)),
        Blend(np.full((6, 6), np.inf), np.zeros(6)),
        Blend(np.eye(6), np.zeros(6), float("nan")),
        Blend(np.eye(3), np.zeros(6)),
        Blend(np.eye(6), np.zeros(3)),
    ],
)
def test_a_policy_that_gives_no_usable_blend_is_a_fault_with_its_name(robot, answer):
    loop = Loop(robot, scene(count=5), arbitration=Broken(answer))
    loop.go(0.1)
    fault = next(step for step in loop.steps if step.event is Event.FAULT)
    assert "broken" in fault.reason
    assert loop.controller.mode is Mode.HOLD
    assert_limits_hold(robot, loop.steps)


class Away(Arbitration):
    """A policy that pulls to where no arm gets."""

    name = "away"

    def blend(self, moment):
        """Return a constant pull."""
        return Blend(np.eye(6), np.array([1.0, 0, 0, 0, 0, 0]), 1.0)


def test_what_the_arm_cannot_follow_is_not_saved_up(robot):
    """Neither the robot's pull nor the hand's push winds up: the way back begins at once."""
    loop = Loop(robot, scene(count=2), arbitration=Away())
    loop.go(5.0, move=(0.4, 0.0, 0.0))
    before = loop.tool().translation[0]
    loop.go(0.6, move=(-0.2, 0.0, 0.0))
    assert loop.tool().translation[0] < before - 0.05
    assert_limits_hold(robot, loop.steps)


def test_a_hand_that_is_no_longer_heard_asks_for_nothing_once_its_motion_is_not_carried_on(robot):
    loop = Loop(robot, scene(), arbitration=make_policy("linear blending"))
    loop.go(0.1)
    loop.go(0.5, move=(0.0, 0.1, 0.0))
    heard, settings = loop.controller.state.monitor.hand.stamp, loop.controller.servo.settings
    until = heard + settings.lag + settings.prediction.horizon
    silent = []
    while (step := loop.tick()).assistance is not None:
        silent.append(step)
    asked = {step.time: np.linalg.norm(step.assistance.hand) for step in silent}
    assert min(v for time, v in asked.items() if time < until - 2 * PERIOD) > 0.1
    assert max(v for time, v in asked.items() if time > until + 2 * PERIOD) == 0.0


def test_the_sampling_of_the_hand_does_not_change_where_it_leads(robot):
    """The steps of the prediction add up to the way of the hand, at whatever ticks its samples come."""
    assert SAMPLE > 1
    ends = []
    for every in (1, 7):
        loop = Loop(robot, scene({"far": (3.0, 0.0, 0.2)}), arbitration=make_policy("hindsight optimisation"))
        start = loop.hand
        for k in range(750):
            way = min(max(k - 50, 0) / 500, 1.0) * np.array([0.1, 0.0, 0.0])
            loop.hand = Pose(start.quaternion, start.translation + way)
            loop.tick(OperatorSample(loop.time, loop.hand) if k % every == 0 else None)
        ends.append(loop.tool().translation)
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-4)
