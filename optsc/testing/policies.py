"""Contract tests of an arbitration policy: how the hand's wish and the robot's become one motion."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np

from optsc import session
from optsc.control.approach import Approach
from optsc.control.arbitration import HAND_ALONE, Arbitration, Goal, GraspPose, Moment, Trigger
from optsc.control.modes import Event, Mode
from optsc.control.status import Status
from optsc.followers import IdealFollower
from optsc.geometry import Pose, rotation
from optsc.grasps import Candidates
from optsc.operators import Button, OperatorSample
from optsc.records import load_inputs
from optsc.robot import load_robot
from optsc.testing.contract import Contract
from optsc.testing.loop import (
    PERIOD,
    PLACES,
    Loop,
    StraightOperator,
    assert_limits_hold,
    controller,
    modes,
    scene,
)

MOMENTS = range(30)
"""Seeds of random moments."""


class ArbitrationContract(Contract):
    """What `optsc.control.arbitration.Arbitration` promises of its answers, and of the motion that comes of them.

    Answers are finite and follow from the moment alone; nothing jumps, no limit is broken, a run can be replayed;
    where nothing is in reach the hand is free; and in the end the intended object is grasped.

    ::

        class TestMyPolicy(ArbitrationContract):
            def make_policy(self):
                return MyPolicy()

    Attributes:
        near: how near [m], [rad] the operator of the last test brings the tool to the grasp before the trigger; more
            for a policy that pulls to another grasp than that of the hand.
    """

    near: ClassVar[tuple[float, float]] = (0.012, 0.15)

    def make_policy(self) -> Arbitration:
        """Return the policy; to be overridden."""
        raise NotImplementedError

    def loop(self, candidates: Candidates) -> Loop:
        """Return a closed loop of a Panda with the policy."""
        return Loop(load_robot("panda"), candidates, arbitration=self.make_policy())

    def led(self) -> Loop:
        """Return a loop in which the hand has gone some way towards an object, and rests."""
        loop = self.loop(scene())
        loop.go(0.1)
        loop.go(0.8, move=(0.03, 0.12, -0.08))
        return loop

    def test_answers_are_finite_and_follow_from_the_moment_alone(self) -> None:
        policy, another = self.make_policy(), self.make_policy()
        answers = [policy.blend(moment(seed)) for seed in MOMENTS]
        for answer in answers:
            assert (np.shape(answer.hand), np.shape(answer.robot)) == ((6, 6), (6,)), f"wrong shapes: {answer}"
            assert np.all(np.isfinite([*np.ravel(answer.hand), *answer.robot])), f"not finite: {answer}"
            assert 0.0 <= answer.share <= 1.0, f"share {answer.share} is not in 0 to 1"
        for seed in reversed(MOMENTS):
            again = another.blend(moment(seed))
            np.testing.assert_array_equal(again.hand, answers[seed].hand)
            np.testing.assert_array_equal(again.robot, answers[seed].robot)

    def test_the_sign_of_a_quaternion_does_not_matter(self) -> None:
        policy = self.make_policy()
        for seed in MOMENTS:
            one, other = policy.blend(moment(seed)), policy.blend(moment(seed, sign=-1.0))
            np.testing.assert_allclose(one.hand, other.hand, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(one.robot, other.robot, rtol=0.0, atol=1e-9)

    def test_no_engagement_release_or_mode_change_makes_the_tool_jump(self) -> None:
        loop = self.led()
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
        # While it is led, the pose that the tool is led along is never set elsewhere: it moves on at a hand's speed. An
        # arm that comes to rest is led nowhere, and begins again from where it is.
        led = np.array([step.command.status not in (Status.STOPPING, Status.HOLDING) for step in loop.steps])
        moved = np.abs(np.diff(loop.reference, axis=0)).max(axis=1)
        assert moved[1:][(led[1:] & led[:-1])[1:]].max() < 0.6 * PERIOD
        assert_limits_hold(loop.robot, loop.steps)

    def test_assistance_comes_in_smoothly_and_keeps_to_the_approachs_speed(self) -> None:
        if not self.make_policy().assists:
            return
        given = [step.assistance for step in self.led().steps if step.assistance is not None]
        robot, hand, both = (np.array([getattr(one, f) for one in given]) for f in ("robot", "hand", "blended"))
        for part, speed in ((slice(0, 3), Approach().speed), (slice(3, 6), Approach().angular_speed)):
            size, wish, sum_ = (np.linalg.norm(twist[:, part], axis=1) for twist in (robot, hand, both))
            assert size.max() <= speed + 1e-12
            assert np.all(sum_ <= wish + speed + 1e-12)
            # From nothing, and at most by as much per tick as a low-pass of 0.15 s lets through.
            assert size[0] < 0.03 * speed
            steps = np.linalg.norm(np.diff(robot[:, part], axis=0), axis=1)
            assert steps.max() <= 2.0 * speed * PERIOD / 0.15 + 0.1 * speed

    def test_limits_hold_under_hostile_input(self) -> None:
        loop = self.loop(scene(count=10))
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
            nudge: Any = tuple(rng.uniform(-1.5, 1.5, 6)) if kind == 5 else None
            clutch, trigger = bool(rng.random() < 0.8), bool(rng.random() < 0.2)
            loop.tick(OperatorSample(stamp, hand, clutch, trigger, buttons, nudge))
            loop.hand = hand if kind < 3 else loop.hand
            for _ in range(int(rng.integers(1, 25))):
                loop.tick()
        assert_limits_hold(loop.robot, loop.steps)

    def test_a_sample_that_is_not_a_number_is_skipped_and_a_lost_hand_leads_to_hold(self) -> None:
        loop = self.led()
        mode = loop.controller.mode
        loop.tick(OperatorSample(loop.time, Pose(np.full(4, np.nan), np.zeros(3))))
        assert loop.controller.mode is mode
        assert loop.tick(OperatorSample(loop.time, loop.hand, lost=True)).event is Event.FAULT
        loop.go(0.3)
        assert loop.controller.mode is Mode.HOLD
        assert np.abs(loop.steps[-1].command.v).max() < 1e-9
        loop.go(0.05, clutch=False)
        loop.go(0.05)
        assert loop.controller.mode is Mode.MANUAL
        assert_limits_hold(loop.robot, loop.steps)

    def test_the_same_run_again_and_its_replay_from_a_file_are_the_same_bit_for_bit(self) -> None:
        robot = load_robot("panda")
        operator = StraightOperator(np.array(PLACES["middle"]) + [0, 0, 0.1])
        run = session.run(
            controller(robot, self.make_policy()),
            operator=operator,
            follower=IdealFollower(robot),
            candidates=scene(),
            duration=1.2,
        )
        assert Mode.MANUAL in run.modes
        with TemporaryDirectory() as folder:
            run.save(Path(folder) / "run.npz")
            inputs = load_inputs(Path(folder) / "run.npz")
        again = session.replay(controller(robot, self.make_policy()), inputs, scene())
        assert again.commands.tobytes() == run.commands.tobytes() == inputs.commands.tobytes()

    def test_a_hand_at_rest_keeps_still_where_nothing_is_in_reach(self) -> None:
        loop = self.loop(scene({"far": (3.0, 0.0, 0.2)}))
        at_rest = loop.tool()
        loop.go(1.0)
        assert loop.controller.mode is Mode.MANUAL
        assert loop.tool().almost_equal(at_rest, 1e-6)

    def test_without_anything_in_reach_the_tool_goes_where_the_hand_goes(self) -> None:
        loop = self.loop(scene({"far": (3.0, 0.0, 0.2)}))
        loop.go(0.1)
        before = loop.tool().translation
        loop.go(1.0, move=(0.05, 0.1, -0.05))
        loop.go(0.5)
        np.testing.assert_allclose(loop.tool().translation - before, [0.05, 0.1, -0.05], atol=1e-3)

    def test_an_operator_and_the_policy_grasp_the_intended_object(self) -> None:
        robot, hands_over = load_robot("panda"), self.make_policy().trigger is Trigger.HANDS_OVER
        # Intended is the object that home points at, so that the robot alone can know it too.
        places = {"left": (0.36, 0.12, 0.4), "right": (0.4, -0.25, 0.3)}
        operator = StraightOperator(np.array(places["left"]) + [0, 0, 0.1 * hands_over], self.near)
        run = session.run(
            controller(
                robot,
                self.make_policy(),
                grasp_within=(0.04, 0.6),
                approach=Approach(lift=0.02, carry_time=0.1),
            ),
            operator=operator,
            follower=IdealFollower(robot, between=scene(places)),
            candidates=scene(places),
            duration=12.0,
            rate=250.0,
        )
        assert modes(run.ticks)[-3:] == ["close", "lift", "carry"], f"modes were {modes(run.ticks)}"
        target = next(tick.step.target for tick in run if tick.mode is Mode.CLOSE)
        assert target is not None
        assert target.object_name == "left"
        assert (Mode.APPROACH in run.modes) is hands_over
        assert_limits_hold(robot, [tick.step for tick in run], 1 / 250.0)


def moment(seed: int, sign: float = 1.0) -> Moment:
    """Return a random moment with up to three goals; with ``sign`` -1 all quaternions have the other sign."""
    rng = np.random.default_rng(seed)

    def grasp(candidate: int) -> GraspPose:
        x, y, z = rng.uniform(-0.3, 0.3, 3).tolist()
        w, i, j, k = (sign * rotation.random(rng)).tolist()
        return GraspPose((x, y, z), (w, i, j, k), candidate)

    tool, probability = grasp(-1), rng.dirichlet(np.ones(1 + seed % 3)) if seed % 4 else np.zeros(0)
    goals = tuple(Goal(f"object {i}", p, grasp(2 * i), grasp(2 * i + 1)) for i, p in enumerate(probability.tolist()))
    first, second, *_ = sorted([*probability.tolist(), 0.0, 0.0], reverse=True)
    hand = rng.uniform(-0.2, 0.2, 6) * (seed % 5 > 0)
    return Moment(tool.p, tool.q, hand, goals, first - second, HAND_ALONE, PERIOD, Approach())
