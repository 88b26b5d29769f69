"""The contract: what holds for every arbitration policy, also for those of other people."""

from dataclasses import dataclass

import numpy as np
import pytest
from closed_loop import (
    PERIOD,
    PLACES,
    SAMPLE,
    Loop,
    Person,
    assert_limits_hold,
    controller,
    modes,
    scene,
)

import optsc
from optsc.control.approach import Approach
from optsc.control.arbitration import Arbitration, Blend, Trigger
from optsc.control.modes import Event, Mode
from optsc.control.policies import POLICIES, Continuous, make_policy
from optsc.geometry import Pose, rotation
from optsc.operators import Button, OperatorSample
from optsc.records import load_inputs
from optsc.robot import load_robot


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


ALL = [make_policy(name) for name in POLICIES]
ASSISTING = [policy for policy in [*ALL, Wild()] if policy.assists]
BY_NAME = {"ids": lambda policy: getattr(policy, "name", None)}


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def led(robot, policy, **settings):
    """A loop in which the hand has gone some way towards the left thing, and rests."""
    loop = Loop(robot, scene(), arbitration=policy, **settings)
    loop.go(0.1)
    loop.go(0.8, move=(0.03, 0.12, -0.08))
    return loop


@pytest.mark.parametrize("policy", [*ALL, Wild()], **BY_NAME)
def test_no_engagement_release_or_mode_change_makes_the_tool_jump(robot, policy):
    loop = led(robot, policy)
    for _ in range(2):
        loop.go(0.3, clutch=False)
        at_rest = loop.controller.mode is Mode.MANUAL
        before = loop.reference[-1]
        loop.go(PERIOD)
        # The tick at which the hand is coupled moves nothing at all.
        assert not at_rest or np.abs(loop.reference[-1] - before).max() < 1e-6
        loop.press()
        loop.go(0.2)
        loop.press()
        loop.go(0.1)
    # The pose that the tool is led along is never set elsewhere: it moves on at a hand's speed.
    assert np.abs(np.diff(loop.reference[1:], axis=0)).max() < 0.6 * PERIOD
    assert_limits_hold(robot, loop.steps)


@pytest.mark.parametrize("policy", ASSISTING, **BY_NAME)
def test_assistance_comes_in_smoothly_and_keeps_to_the_approachs_speed(robot, policy):
    loop = led(robot, policy)
    given = [step.assistance for step in loop.steps if step.assistance is not None]
    robot_part = np.array([a.robot for a in given])
    settings = Approach()
    for part, speed in ((slice(0, 3), settings.speed), (slice(3, 6), settings.angular_speed)):
        size = np.linalg.norm(robot_part[:, part], axis=1)
        assert size.max() <= speed + 1e-12
        hand = np.linalg.norm([a.hand[part] for a in given], axis=1)
        assert np.all(np.linalg.norm([a.carried_out[part] for a in given], axis=1) <= hand + speed + 1e-12)
        # From nothing, and at most by as much per tick as a low-pass of 0.15 s lets through.
        assert size[0] < 0.03 * speed
        steps = np.linalg.norm(np.diff(robot_part[:, part], axis=0), axis=1)
        assert steps.max() <= 2.0 * speed * PERIOD / 0.15 + 0.1 * speed


@pytest.mark.parametrize("policy", [*ALL, Wild()], **BY_NAME)
def test_limits_hold_under_hostile_input(robot, policy):
    loop = Loop(robot, scene(count=10), arbitration=policy)
    rng = np.random.default_rng(7)
    loop.go(0.1)
    for _ in range(40):
        kind = rng.integers(7)
        hand = loop.hand
        if kind == 0:
            hand = Pose(hand.quaternion, hand.translation + rng.uniform(-1, 1, 3))
        elif kind == 1:
            hand = Pose(hand.quaternion, hand.translation + rng.uniform(-0.09, 0.09, 3))
        elif kind == 2:
            turn = rotation.exp(rng.uniform(-0.3, 0.3, 3))
            hand = Pose(rotation.multiply(turn, hand.quaternion), hand.translation)
        elif kind == 3:
            hand = Pose(hand.quaternion, np.full(3, np.nan))
        stamp = loop.time if kind != 4 else 0.0
        buttons = frozenset(b for b in Button if rng.random() < 0.2)
        nudge = tuple(rng.uniform(-1.5, 1.5, 6)) if kind == 5 else None
        clutch, trigger = bool(rng.random() < 0.8), bool(rng.random() < 0.2)
        loop.tick(OperatorSample(stamp, hand, clutch, trigger, buttons, nudge))
        loop.hand = hand if kind < 3 else loop.hand
        for _ in range(int(rng.integers(1, 25))):
            loop.tick()
    assert_limits_hold(robot, loop.steps)


@pytest.mark.parametrize("policy", ALL, **BY_NAME)
def test_a_sample_that_is_not_a_number_leads_to_hold_and_only_the_operator_goes_on(robot, policy):
    loop = led(robot, policy)
    bad = OperatorSample(loop.time, Pose(np.full(4, np.nan), np.zeros(3)))
    assert loop.tick(bad).event is Event.FAULT
    loop.go(0.3)
    assert loop.controller.mode is Mode.HOLD
    assert np.abs(loop.steps[-1].command.v).max() < 1e-9
    loop.go(0.05, clutch=False)
    loop.go(0.05)
    assert loop.controller.mode is Mode.MANUAL
    assert_limits_hold(robot, loop.steps)


def run_of(robot, policy, duration=1.2):
    c = controller(robot, policy)
    person = Person(np.array(PLACES["middle"]) + [0, 0, 0.1])
    return optsc.run(
        c, operator=person, follower=optsc.IdealFollower(robot), candidates=scene(), duration=duration
    )


@pytest.mark.parametrize("policy", ALL, **BY_NAME)
def test_the_same_run_again_and_its_replay_from_a_file_are_the_same_bit_for_bit(robot, policy, tmp_path):
    run = run_of(robot, policy)
    assert Mode.MANUAL in run.modes
    run.save(tmp_path / "run.npz")
    inputs = load_inputs(tmp_path / "run.npz")
    again = optsc.replay(controller(robot, policy), inputs, scene())
    assert again.commands.tobytes() == run.commands.tobytes() == inputs.commands.tobytes()


@pytest.mark.parametrize("policy", ALL, **BY_NAME)
def test_a_hand_at_rest_keeps_still_where_nothing_can_be_meant(robot, policy):
    loop = Loop(robot, scene({"far": (3.0, 0.0, 0.2)}), arbitration=policy)
    at_rest = loop.tool()
    loop.go(1.0)
    assert loop.controller.mode is Mode.MANUAL
    assert loop.tool().almost_equal(at_rest, 1e-6)


@pytest.mark.parametrize("policy", ALL, **BY_NAME)
def test_without_anything_in_reach_the_tool_goes_where_the_hand_goes(robot, policy):
    loop = Loop(robot, scene({"far": (3.0, 0.0, 0.2)}), arbitration=policy)
    loop.go(0.1)
    before = loop.tool()
    loop.go(1.0, move=(0.05, 0.1, -0.05))
    loop.go(0.5)
    np.testing.assert_allclose(loop.tool().translation - before.translation, [0.05, 0.1, -0.05], atol=1e-3)


@pytest.mark.parametrize("policy", ALL, **BY_NAME)
def test_a_person_and_the_policy_grasp_the_thing_that_is_meant(robot, policy):
    high = policy.trigger is Trigger.HANDS_OVER
    name = "left"  # the one that home points at: so that the robot alone can know it too
    # Who is led elsewhere by continuous blending has to content themselves with the robot's grasp.
    near = (0.03, 0.5) if isinstance(policy, Continuous) else (0.012, 0.15)
    near_by = {name: (0.36, 0.12, 0.4), "right": (0.4, -0.25, 0.3)}
    person = Person(np.array(near_by[name]) + [0, 0, 0.1 * high], near)
    run = optsc.run(
        controller(robot, policy, grasp_within=(0.04, 0.6), approach=Approach(lift=0.02, carry_time=0.1)),
        operator=person,
        follower=optsc.IdealFollower(robot),
        candidates=scene(near_by),
        duration=12.0,
        rate=250.0,
    )
    assert modes(run.ticks)[-3:] == ["close", "lift", "carry"]
    assert next(tick for tick in run if tick.mode is Mode.CLOSE).step.target.object_name == name
    assert (Mode.APPROACH in run.modes) is high
    assert_limits_hold(robot, [tick.step for tick in run], 1 / 250.0)


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


def test_the_sampling_of_the_hand_does_not_change_where_it_leads(robot):
    """The steps of the prediction add up to the way of the hand, at whatever ticks its samples come."""
    assert SAMPLE > 1
    ends = []
    for every in (1, 7):
        loop = Loop(robot, scene({"far": (3.0, 0.0, 0.2)}), arbitration=make_policy("hindsight optimisation"))
        start = loop.hand
        for k in range(700):
            way = min(k / 500, 1.0) * np.array([0.1, 0.0, 0.0])
            loop.hand = Pose(start.quaternion, start.translation + way)
            loop.tick(OperatorSample(loop.time, loop.hand) if k % every == 0 else None)
        ends.append(loop.tool().translation)
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-4)
