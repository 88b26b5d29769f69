"""The shared controller with a real arm, a real selector and a hand that is moved by the test."""

from dataclasses import replace

import numpy as np
import pytest

import optsc
from optsc.control.modes import Event, Mode
from optsc.control.servo import Status
from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.grasps import Candidates
from optsc.operators import OperatorSample
from optsc.operators.smoothing import Smoothing
from optsc.records import load_inputs
from optsc.robot import load_robot, model_from_urdf

PERIOD = 1 / 500.0
R_WS = tuple(rotation.exp([0.0, 0.0, 0.7]))


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def candidates_around(p, count=40, name="thing", seed=0):
    """Grasps of a thing at ``p`` from above, tilted by up to half a radian."""
    rng = np.random.default_rng(seed)
    down = np.array([0.0, 1.0, 0.0, 0.0])
    q = rotation.multiply(rotation.exp(rng.uniform(-0.3, 0.3, (count, 3))), down)
    return Candidates(
        object_names=(name,),
        object_index=np.zeros(count, dtype=int),
        grasp_index=np.arange(count),
        X_WG=Pose(q, np.asarray(p) + rng.uniform(-0.01, 0.01, (count, 3))),
        opening=np.full(count, 0.04),
        quality=np.ones(count),
        jaw_symmetric=True,
    )


class Rig:
    """A controller with an ideal arm, and a hand in the station frame."""

    def __init__(self, robot, rule=None, candidates=None):
        selector = optsc.GraspSelector(robot, rule)
        self.controller = optsc.SharedController(robot, selector, clutch=optsc.ClutchSettings(R_WS=R_WS))
        self.controller.reset(robot.home)
        self.follower = optsc.IdealFollower(robot, between=candidates)
        self.measured = self.follower.reset(robot.home)
        self.robot = robot
        tool = robot.forward(robot.home)
        self.hand = Pose(rotation.multiply(rotation.conjugate(R_WS), tool.quaternion), np.zeros(3))
        self.steps = []
        if candidates is not None:
            self.controller.observe(candidates)

    def sample(self, clutch=True, trigger=False):
        return OperatorSample(self.controller.time, self.hand, clutch, trigger)

    def step(self, sample=None):
        step = self.controller.step(sample, self.measured)
        self.measured = self.follower.apply(step.command.q, step.command.v, step.opening, PERIOD)
        self.steps.append(step)
        return step

    def go(self, seconds, clutch=True, trigger=False, move=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)):
        """Move the hand steadily by a displacement and a turn in the station's axes, sampled at 100 Hz."""
        ticks = round(seconds / PERIOD)
        for k in range(ticks):
            self.hand = Pose(
                rotation.multiply(rotation.exp(np.multiply(turn, 1 / ticks)), self.hand.quaternion),
                self.hand.translation + np.multiply(move, 1 / ticks),
            )
            self.step(self.sample(clutch, trigger) if k % 5 == 0 else None)
        return self.steps[-1]

    def press(self):
        self.step(self.sample(trigger=True))
        return self.go(0.1)

    def tool(self):
        return self.robot.forward(self.controller.servo.guard.q)


THING = (0.45, 0.05, 0.15)


def start(robot):
    rig = Rig(robot, candidates=candidates_around(THING))
    rig.go(0.3)
    return rig


def assert_no_step(rig):
    """Limits hold at every tick, and the reference never jumps: the tool's path has no step in position or velocity."""
    limits = rig.robot.limits
    v = np.array([step.command.v for step in rig.steps])
    a = np.array([step.command.a for step in rig.steps])
    assert np.all(np.abs(v) <= limits.velocity)
    assert np.all(np.abs(a) <= limits.acceleration)
    assert np.all(np.abs(np.diff(a, axis=0)) <= limits.jerk * PERIOD * (1 + 1e-9))


def test_the_tool_follows_the_hand_with_the_stations_rotation_applied(robot):
    rig = start(robot)
    before = rig.tool()
    rig.go(1.0, move=(0.1, 0.0, -0.05))
    rig.go(0.4)
    moved = rig.tool().translation - before.translation
    np.testing.assert_allclose(moved, rotation.rotate(R_WS, [0.1, 0.0, -0.05]), atol=1e-3)
    assert rig.controller.mode is Mode.MANUAL


def test_orientation_is_absolute(robot):
    rig = start(robot)
    rig.go(1.0, turn=(0.0, 0.0, 0.3))
    rig.go(0.6)
    expected = rotation.multiply(R_WS, rig.hand.quaternion)
    assert rotation.angle(rig.tool().quaternion, expected) < 5e-3


def test_engaging_releasing_or_re_engaging_the_clutch_never_moves_the_target(robot):
    rig = start(robot)
    rig.go(0.5, clutch=False)
    at_rest = rig.tool()
    # The hand wanders with an open clutch, and only its position counts anew when it closes.
    rig.hand = Pose(rig.hand.quaternion, rig.hand.translation + [0.3, -0.2, 0.1])
    rig.go(0.5, clutch=False)
    assert rig.tool().almost_equal(at_rest, 1e-9)
    rig.go(0.5)
    assert np.linalg.norm(rig.tool().translation - at_rest.translation) < 1e-4
    assert_no_step(rig)


def test_the_trigger_starts_the_robot_and_it_runs_through_all_modes(robot):
    rig = start(robot)
    rig.press()
    rig.go(9.0)
    seen = [step.mode for i, step in enumerate(rig.steps) if i == 0 or step.mode is not rig.steps[i - 1].mode]
    assert seen[-6:] == [Mode.MANUAL, Mode.APPROACH, Mode.ADVANCE, Mode.CLOSE, Mode.LIFT, Mode.CARRY]
    assert rig.controller.finished
    target = next(step.target for step in rig.steps if step.mode is Mode.APPROACH)
    arrival = next(step for step in rig.steps if step.mode is Mode.CLOSE)
    X = robot.forward(arrival.command.q)
    assert np.linalg.norm(X.translation - target.X_WG.translation) < 2e-3
    assert rotation.angle(X.quaternion, target.X_WG.quaternion) < 0.02
    assert_no_step(rig)


def test_automatic_motion_keeps_the_speed_that_is_asked_for(robot):
    rig = start(robot)
    rig.press()
    rig.go(2.0)
    q = np.array([step.command.q for step in rig.steps if step.mode is Mode.APPROACH])
    speed = np.linalg.norm(np.diff(robot.forward(q).translation, axis=0), axis=1) / PERIOD
    assert speed.max() == pytest.approx(0.1, rel=0.02)


def test_the_operator_steps_in_without_a_jump_and_the_new_grasp_follows_the_hand(robot):
    things = [candidates_around((0.45, y, 0.15), name=name) for name, y in (("left", 0.2), ("right", -0.2))]
    both = Candidates(
        object_names=("left", "right"),
        object_index=np.repeat([0, 1], 40),
        grasp_index=np.tile(np.arange(40), 2),
        X_WG=Pose.concatenate([thing.X_WG for thing in things]),
        opening=np.full(80, 0.04),
        quality=np.ones(80),
        jaw_symmetric=True,
    )
    rig = Rig(robot, candidates=both)
    rig.go(0.3)
    to_station = rotation.conjugate(R_WS)
    rig.go(1.0, move=rotation.rotate(to_station, [0.05, 0.12, -0.1]))
    assert rig.press().target.object_name == "left"
    rig.go(0.4)
    rig.press()
    assert rig.controller.mode is Mode.MANUAL
    rig.go(1.5, move=rotation.rotate(to_station, [0.0, -0.35, 0.0]))
    assert rig.press().target.object_name == "right"
    rig.go(0.5)
    assert_no_step(rig)


def test_no_mode_change_moves_the_target(robot):
    rig = start(robot)
    reference = [np.concatenate(rig.controller.servo.reference)]
    for k in range(10):
        rig.step(rig.sample(trigger=k % 2 == 0))
        reference.append(np.concatenate(rig.controller.servo.reference))
    assert np.abs(np.diff(reference, axis=0)).max() < 1e-5


@pytest.mark.parametrize(
    "bad",
    [
        Pose(np.full(4, np.nan), np.zeros(3)),
        Pose(np.zeros(4), np.zeros(3)),
        Pose(np.array([1.0, 0, 0, 0]), np.array([np.nan, 0, 0])),
    ],
)
@pytest.mark.parametrize("automatic", [False, True])
def test_one_bad_sample_is_skipped_and_bad_samples_alone_stop_the_arm_with_their_reason(robot, bad, automatic):
    rig = start(robot)
    if automatic:
        rig.press()
    mode = rig.controller.mode
    step = rig.step(OperatorSample(rig.controller.time, bad))
    assert step.event is None
    assert "refused" in step.reason
    assert rig.controller.state.monitor.counts.refused == 1
    rig.go(0.1)
    assert rig.controller.mode is mode
    for _ in range(250):
        step = rig.step(OperatorSample(rig.controller.time, bad))
    assert rig.controller.mode is (Mode.HOLD if automatic else Mode.MANUAL)
    assert "samples have stopped" in step.reason
    assert "refused" in step.reason
    assert not step.command.v.any()
    rig.go(0.1)
    assert rig.controller.mode is (Mode.HOLD if automatic else Mode.MANUAL)
    rig.go(0.1, clutch=False)
    rig.go(0.1)
    assert rig.controller.mode is Mode.MANUAL
    assert_no_step(rig)


@pytest.mark.parametrize("automatic", [False, True])
def test_a_device_that_says_that_it_has_lost_the_hand_holds_at_once_and_the_reason_stays(robot, automatic):
    rig = start(robot)
    if automatic:
        rig.press()
    step = rig.step(OperatorSample(float("nan"), Pose(np.full(4, np.nan), np.zeros(3)), lost=True))
    assert step.event is Event.FAULT
    reasons = {step.reason}
    for _ in range(250):
        reasons.add(rig.step().reason)
    assert rig.controller.mode is Mode.HOLD
    assert all("no longer tracks the hand" in reason for reason in reasons)
    rig.go(0.1, clutch=False)
    assert rig.controller.mode is Mode.HOLD
    rig.go(0.1)
    assert rig.controller.mode is Mode.MANUAL
    assert rig.steps[-1].reason == ""
    assert_no_step(rig)


def test_a_lost_operator_stops_automatic_motion(robot):
    rig = start(robot)
    rig.press()
    for _ in range(100):
        step = rig.step()
    assert rig.controller.mode is Mode.HOLD
    assert any("stopped" in s.reason for s in rig.steps)
    assert step.command.v == pytest.approx(0, abs=1e-6)


def test_a_lost_hand_rests_in_manual_mode_and_is_coupled_anew_when_it_returns(robot):
    rig = start(robot)
    rig.go(0.4, move=(0.1, 0, 0))
    for _ in range(200):
        rig.step()
    assert rig.steps[-1].command.status is Status.STALE
    at_rest = rig.tool()
    rig.hand = Pose(rig.hand.quaternion, rig.hand.translation + 0.5)
    rig.go(0.5)
    assert np.linalg.norm(rig.tool().translation - at_rest.translation) < 1e-3
    assert_no_step(rig)


def test_a_hand_that_jumps_is_coupled_anew_and_the_target_stays(robot):
    rig = start(robot)
    at_rest = rig.tool()
    rig.hand = Pose(rig.hand.quaternion, rig.hand.translation + [0.0, 1.0, 0.0])
    rig.go(0.5)
    assert any("jumped" in step.reason for step in rig.steps)
    assert np.linalg.norm(rig.tool().translation - at_rest.translation) < 1e-3
    assert_no_step(rig)


def test_recentring_does_not_move_the_target_and_turns_what_forward_means(robot):
    rig = start(robot)
    rig.hand = Pose(rotation.multiply(rotation.exp([0, 0, 0.5]), rig.hand.quaternion), rig.hand.translation)
    rig.go(0.05, clutch=False)
    before = rig.tool()
    rig.controller.recentre()
    rig.go(0.6)
    assert rig.tool().almost_equal(before, 5e-3)
    rig.go(0.5, move=(0.05, 0.0, 0.0))
    rig.go(0.5)
    moved = rig.tool().translation - before.translation
    np.testing.assert_allclose(moved, rotation.rotate(rotation.exp([0, 0, 0.7 - 0.5]), [0.05, 0, 0]), atol=1e-3)


def test_changing_the_scale_or_the_smoothing_while_the_hand_moves_does_not_move_the_target(robot):
    rig = start(robot)
    rig.go(0.4, move=(0.05, 0, 0))
    rig.go(0.4)
    before = rig.tool()
    rig.controller.couple_by(replace(rig.controller.clutch, scale=2.0), Smoothing.low_pass(0.05))
    rig.go(1.0)
    assert np.linalg.norm(rig.tool().translation - before.translation) < 1e-3
    rig.go(1.0, move=(0.02, 0, 0))
    rig.go(1.0)
    moved = rig.tool().translation - before.translation
    assert np.linalg.norm(moved) == pytest.approx(0.04, abs=2e-3)
    assert_no_step(rig)


def test_smoothing_makes_a_trembling_hand_calmer(robot):
    rough, calm = Rig(robot), Rig(robot)
    calm.controller = optsc.SharedController(
        robot,
        optsc.GraspSelector(robot),
        clutch=optsc.ClutchSettings(R_WS=R_WS),
        smoothing=Smoothing(cutoff=0.3, slope=2.0),
    )
    calm.controller.reset(robot.home)
    for rig in (rough, calm):
        rng = np.random.default_rng(0)
        for _ in range(100):
            rig.hand = Pose(rig.hand.quaternion, 5e-4 * rng.normal(size=3))
            rig.go(0.01)
    still = [np.std([step.command.q for step in rig.steps[100:]], axis=0).max() for rig in (rough, calm)]
    assert still[1] < 0.5 * still[0]


def test_an_arm_that_does_not_follow_is_a_fault(robot):
    rig = start(robot)
    away = rig.measured._replace(q=rig.measured.q - 0.5)
    assert any("off its command" in rig.controller.step(None, away).reason for _ in range(20))
    assert rig.controller.mode is Mode.HOLD
    nowhere = rig.measured._replace(q=rig.measured.q * np.nan)
    assert any("not finite" in rig.controller.step(None, nowhere).reason for _ in range(60))
    assert rig.controller.mode is Mode.HOLD


def test_an_arm_that_lags_a_little_is_none(robot):
    for lag, mode in ((0.29, Mode.MANUAL), (-0.29, Mode.MANUAL), (0.31, Mode.HOLD), (-0.31, Mode.HOLD)):
        rig = start(robot)
        for _ in range(20):
            rig.controller.step(None, rig.measured._replace(q=rig.controller.servo.guard.q + [0, 0, 0, lag, 0, 0, 0]))
        assert rig.controller.mode is mode


def test_the_trigger_without_a_grasp_in_reach_says_so_and_stays_manual(robot):
    rig = Rig(robot, candidates=candidates_around((3.0, 0.0, 0.2)))
    rig.go(0.3)
    step = rig.step(rig.sample(trigger=True))
    assert rig.controller.mode is Mode.MANUAL
    assert "no grasp" in step.reason


def test_a_recorded_run_replayed_gives_the_same_commands_bit_for_bit(robot, tmp_path):
    candidates = candidates_around(THING)

    class Hand:
        """Goes down towards the thing and presses the trigger."""

        def read(self, view):
            k = round(view.time / PERIOD)
            if k % 6:
                return None
            X = Pose(
                rotation.multiply(rotation.conjugate(R_WS), [0, 1, 0, 0]),
                np.array([0, 0, -0.1 * min(view.time, 1.0)]),
            )
            return OperatorSample(view.time, X, True, 1.0 < view.time < 1.2)

    def controller():
        return optsc.SharedController(robot, optsc.GraspSelector(robot), clutch=optsc.ClutchSettings(R_WS=R_WS))

    run = optsc.run(
        controller(),
        operator=Hand(),
        follower=optsc.IdealFollower(robot),
        candidates=candidates,
        duration=4.0,
    )
    assert Mode.ADVANCE in run.modes
    run.save(tmp_path / "run.npz")
    inputs = load_inputs(tmp_path / "run.npz")
    again = optsc.replay(controller(), inputs, candidates)
    assert again.commands.tobytes() == run.commands.tobytes() == inputs.commands.tobytes()


def test_a_robot_without_a_gripper_is_refused(robot):
    bare = model_from_urdf(robot.urdf, robot.tip)
    with pytest.raises(InvalidValue, match="gripper"):
        optsc.SharedController(bare, optsc.GraspSelector(bare))
