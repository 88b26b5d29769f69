"""What the robot and the operator can do with what the jaws hold, and what becomes of it when they do not hold it."""

import numpy as np
import pytest

from optsc.control.approach import Approach
from optsc.control.modes import Event, Mode
from optsc.control.policies import LinearBlending
from optsc.operators import Button, OperatorSample
from optsc.robot import load_robot
from optsc.testing.loop import PERIOD, Loop, assert_limits_hold, modes, scene

PLACE = {"thing": (0.45, 0.1, 0.15)}
WIDTH = 0.04
OPEN = 0.08
SEEDS = range(2)


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


class Jaws(Loop):
    """A loop whose jaws close on something ``width`` [m] wide, which can change; readings may be noisy."""

    def __init__(self, robot, seed=0, lift=0.15, noise=0.0, carry_time=0.3, **settings):
        self.width, self.noise, self.rng = WIDTH, noise, np.random.default_rng(seed)
        self.opening = OPEN
        approach = Approach(speed=0.3, acceleration=2.0, jerk=20.0, lift=lift, carry_time=carry_time)
        super().__init__(robot, scene(PLACE, seed=seed), approach=approach, **settings)

    def tick(self, sample=None):
        step = super().tick(sample)
        before, travel = self.opening, 0.1 * PERIOD
        opening = min(max(step.opening, before - travel), before + travel)
        if self.width <= before:
            opening = max(opening, self.width)
        self.opening = opening
        self.measured = self.measured._replace(opening=opening + self.noise * self.rng.normal())
        return step

    def until(self, mode, longest=8.0):
        end = self.time + longest
        while self.controller.mode is not mode:
            assert self.time < end, f"{mode} was not reached: {modes(self.steps)}, {self.steps[-1].reason}"
            self.go(0.01)
        self.tick()
        return self

    def grasped(self, mode=Mode.CARRY):
        self.go(0.2)
        self.press()
        return self.until(mode)

    @property
    def held(self):
        return self.controller.state.held


def test_an_object_that_was_moved_away_is_not_lifted_and_the_reason_stays(robot):
    for seed in SEEDS:
        loop = Jaws(robot, seed)
        loop.grasped(Mode.ADVANCE)
        loop.width = 4e-4
        loop.until(Mode.HOLD)
        loop.go(1.0)
        assert modes(loop.steps)[-2:] == ["close", "hold"]
        assert loop.steps[-1].reason == ("the jaws closed on nothing: opening 0.4 mm, expected 40.0 mm for the thing")
        assert loop.held is None
        assert not loop.controller.finished
        loop.go(0.05, clutch=False)
        loop.go(0.3)
        assert loop.controller.mode is Mode.MANUAL
        assert "closed on nothing" not in loop.steps[-1].reason
        loop.width = WIDTH
        loop.press()
        loop.until(Mode.CARRY)
        assert loop.held.object_name == "thing"


def test_something_wider_than_the_grasp_is_not_lifted_and_not_dropped(robot):
    for seed in SEEDS:
        loop = Jaws(robot, seed)
        loop.width = float(np.random.default_rng(seed).uniform(WIDTH + 0.012, 0.075))
        loop.grasped(Mode.HOLD)
        assert modes(loop.steps)[-2:] == ["close", "hold"]
        assert "something wider" in loop.steps[-1].reason
        assert loop.held is None
        assert loop.steps[-1].opening == 0.0


@pytest.mark.parametrize("mode", [Mode.LIFT, Mode.CARRY])
def test_what_is_taken_out_of_the_jaws_stops_the_arm_and_is_never_finished(robot, mode):
    for seed in SEEDS:
        loop = Jaws(robot, seed, carry_time=2.0)
        loop.grasped(mode)
        loop.go(float(np.random.default_rng(seed).uniform(0.0, 0.2)))
        loop.width = 0.0
        loop.until(Mode.HOLD, 0.6)
        assert "no longer between the jaws" in loop.go(1.5).reason
        assert Event.LOST in [step.event for step in loop.steps]
        assert loop.held is None
        assert loop.controller.state.tasks == 0
        assert_limits_hold(robot, loop.steps)


def test_what_slips_stops_the_arm_and_is_still_held(robot):
    for seed in SEEDS:
        loop = Jaws(robot, seed, carry_time=2.0).grasped(Mode.LIFT)
        loop.width = WIDTH - 0.006
        loop.until(Mode.HOLD, 0.6)
        assert "slips" in loop.steps[-1].reason
        assert loop.held.opening == pytest.approx(loop.width, abs=1e-3)
        assert loop.steps[-1].opening == 0.0


def test_who_steps_in_keeps_what_is_held_and_the_trigger_puts_it_down_where_it_stood(robot):
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        loop = Jaws(robot, seed, lift=float(rng.uniform(0.05, 0.25))).grasped()
        grasped_at = loop.held.at[0][2]
        loop.press()
        assert loop.controller.mode is Mode.MANUAL
        loop.go(0.6, move=(*rng.uniform(-0.05, 0.05, 2), float(rng.uniform(-0.02, 0.05))))
        loop.go(0.3)
        assert loop.steps[-1].held.object_name == "thing"
        assert loop.opening == pytest.approx(WIDTH)
        loop.press()
        loop.until(Mode.RELEASE)
        assert loop.tool().translation[2] == pytest.approx(grasped_at, abs=2e-3)
        loop.until(Mode.MANUAL)
        assert modes(loop.steps)[-4:] == ["place", "release", "retreat", "manual"]
        assert loop.held is None
        assert loop.opening == pytest.approx(OPEN)
        assert_limits_hold(robot, loop.steps)


def test_presses_in_quick_succession_are_one_and_never_open_the_jaws_in_the_air(robot):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        loop = Jaws(robot, seed, lift=0.13, carry_time=9.0).grasped()
        height = loop.tool().translation[2]
        assert height > 0.25
        for _ in range(int(rng.integers(2, 6))):
            loop.tick(OperatorSample(loop.time, loop.hand, trigger=True))
            loop.tick(OperatorSample(loop.time, loop.hand))
            for _ in range(int(rng.integers(0, 70))):
                loop.tick(OperatorSample(loop.time, loop.hand))
        loop.go(1.0)
        assert modes(loop.steps)[-2:] == ["carry", "manual"]
        assert loop.opening == pytest.approx(WIDTH)
        assert loop.held is not None


def test_two_presses_at_any_interval_never_let_fall_what_is_held(robot):
    for seed in range(4):
        loop = Jaws(robot, seed, lift=0.13, carry_time=9.0).grasped()
        support = loop.held.at[0][2]
        loop.press()
        for _ in range(round(np.random.default_rng(seed).uniform(0.0, 0.6) / PERIOD)):
            loop.tick(OperatorSample(loop.time, loop.hand))
        loop.press()
        loop.go(6.0)
        opened = next(k for k, step in enumerate(loop.steps) if step.mode is Mode.RELEASE)
        z = robot.forward(loop.steps[opened].command.q).translation[2]
        assert z == pytest.approx(support, abs=2e-3)
        assert Mode.APPROACH not in {step.mode for step in loop.steps[opened:]}


def test_a_clutch_that_closes_with_a_bouncing_trigger_is_closed(robot):
    loop = Loop(robot)
    loop.go(0.2)
    bounces = [(False, True), (False, False), (True, True)]
    for clutch, trigger in bounces:
        step = loop.tick(OperatorSample(loop.time, loop.hand, clutch=clutch, trigger=trigger))
    assert step.event is Event.ENGAGED
    assert [step.reason for step in loop.steps].count("there are no grasps") == 1


@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.CARRY])
def test_the_release_button_opens_the_jaws_where_the_tool_is(robot, mode):
    loop = Jaws(robot, carry_time=9.0).grasped()
    if mode is Mode.MANUAL:
        loop.press()
        loop.go(0.4)
    at = loop.tool()
    step = loop.tick(OperatorSample(loop.time, loop.hand, buttons=frozenset({Button.RELEASE})))
    assert step.event is Event.RELEASED
    loop.go(1.0)
    assert loop.controller.mode is Mode.MANUAL
    assert loop.opening == pytest.approx(OPEN)
    assert loop.held is None
    assert np.linalg.norm(loop.tool().translation - at.translation) < 2e-3
    again = loop.tick(OperatorSample(loop.time, loop.hand, buttons=frozenset({Button.RELEASE})))
    assert again.reason == "the jaws are open"


@pytest.mark.parametrize("mode", [Mode.MANUAL, Mode.CARRY])
def test_the_place_button_lowers_and_opens(robot, mode):
    for seed in SEEDS:
        loop = Jaws(robot, seed, carry_time=9.0).grasped()
        support = loop.held.at[0][2]
        if mode is Mode.MANUAL:
            loop.press()
            loop.go(0.4, move=(0.0, 0.0, 0.1))
        loop.tick(OperatorSample(loop.time, loop.hand, buttons=frozenset({Button.PLACE})))
        loop.until(Mode.RELEASE)
        assert loop.tool().translation[2] == pytest.approx(support, abs=2e-3)
        loop.until(Mode.MANUAL)
        refused = loop.tick(OperatorSample(loop.time, loop.hand, buttons=frozenset({Button.PLACE})))
        assert refused.reason == "the jaws hold nothing"


def test_where_the_arm_cannot_go_straight_down_the_object_stays_in_the_jaws_and_the_reason_says_it(robot):
    loop = Jaws(robot, lift=0.2, carry_time=9.0).grasped()
    # As if it had been lifted from far below the table.
    jaws = loop.controller.state.jaws
    (x, y, z), q = jaws.at
    loop.controller.state = loop.controller.state._replace(jaws=jaws._replace(at=((x, y, z - 1.5), q)))
    loop.press()
    assert loop.controller.mode is Mode.MANUAL
    assert "cannot lower what it holds" in loop.press().reason
    loop.go(0.5)
    assert loop.controller.mode is Mode.MANUAL
    assert loop.held is not None
    assert loop.opening == pytest.approx(WIDTH)


def test_below_where_it_was_lifted_from_an_object_is_not_let_fall(robot):
    loop = Jaws(robot, lift=0.01, carry_time=9.0).grasped()
    loop.press()
    loop.go(1.0, move=(0.0, 0.0, -0.05))
    loop.go(0.4)
    loop.press()
    loop.go(9.0)
    assert loop.controller.mode is Mode.MANUAL
    assert any("nothing to put it down on" in step.reason for step in loop.steps) or any(
        "stuck" in step.reason for step in loop.steps
    )
    assert loop.held is not None
    assert loop.opening == pytest.approx(WIDTH)


def test_an_object_that_was_put_down_elsewhere_has_to_be_observed_before_it_is_grasped_again(robot):
    loop = Jaws(robot, carry_time=9.0).grasped()
    loop.press()
    loop.go(0.8, move=(0.0, 0.08, 0.0))
    loop.press()
    loop.until(Mode.MANUAL)
    assert "has not been observed since" in loop.press().reason
    loop.controller.observe(scene({"thing": (0.45, 0.18, 0.15)}))
    loop.go(0.2)
    loop.press()
    loop.until(Mode.CARRY)
    assert loop.controller.state.tasks == 1
    assert loop.held.object_name == "thing"


def test_grasps_that_are_sampled_again_on_the_way_are_no_fault_and_a_moved_object_is(robot):
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        loop = Jaws(robot, seed)
        loop.go(0.2)
        loop.press()
        loop.controller.observe(scene(PLACE, count=int(rng.integers(8, 40)), seed=seed + 100))
        loop.go(0.1)
        assert loop.controller.mode is Mode.APPROACH
        x, y, z = PLACE["thing"]
        loop.controller.observe(scene({"thing": (x + 0.05, y - 0.03, z)}, count=20, seed=seed + 200))
        loop.go(0.1)
        assert loop.controller.mode is Mode.HOLD
        assert "moved" in loop.steps[-1].reason


@pytest.mark.parametrize("noise", [1e-4, 3e-4, 1e-3])
def test_the_noise_of_the_opening_changes_nothing(robot, noise):
    loop = Jaws(robot, noise=noise).grasped()
    loop.go(1.0)
    assert loop.controller.finished
    assert loop.controller.state.tasks == 1
    assert loop.held.opening == pytest.approx(WIDTH, abs=1e-3)


def test_by_hand_too_only_what_is_between_the_jaws_is_lifted(robot):
    for width, last in ((WIDTH, "carry"), (0.0, "hold")):
        loop = Jaws(robot, arbitration=LinearBlending(), grasp_within=None)
        loop.width = width
        loop.go(0.1)
        loop.press()
        loop.go(3.0)
        assert modes(loop.steps)[-1] == last


def test_a_jaw_that_is_not_measured_is_lifted_with_nothing(robot):
    loop = Jaws(robot)
    loop.noise = float("nan")
    loop.go(0.2)
    loop.press()
    loop.until(Mode.HOLD)
    assert "lift" not in modes(loop.steps)
    assert "is not measured" in loop.steps[-1].reason
