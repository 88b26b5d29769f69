"""Straight-line rollouts: the arm holds the tool on the line, stays in its branch, and stops where it cannot go on."""

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.kernels import compiler
from optsc.kernels.rollout import END_TOLERANCE, STEP_TOLERANCE, STEPS
from optsc.robot import ROBOT_NAMES, load_robot
from optsc.robot.rollout import ROLLOUT_ENDS, straight_line_rollout

SPEEDS = {"speed": 0.1, "angular_speed": 0.5}


def ends_near(robot, count, rng, size=0.15):
    start = robot.forward(robot.home)
    shift = rng.uniform(-size, size, (count, 3))
    turn = rotation.exp(rng.uniform(-size, size, (count, 3)))
    return start, Pose(rotation.multiply(turn, np.tile(start.quaternion, (count, 1))), start.translation + shift)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_every_configuration_holds_the_tool_on_the_line_as_pinocchio_sees_it(name):
    robot = load_robot(name)
    start, end = ends_near(robot, 12, np.random.default_rng(1))
    rollout = straight_line_rollout(robot, robot.home, start, end, **SPEEDS)
    assert rollout.completed.sum() >= 6
    for k in np.flatnonzero(rollout.completed):
        count = rollout.steps[k]
        share = np.arange(1, count + 1) / count
        wanted, found = start.interpolate(end[k], share), robot.forward(rollout.configurations[k, :count])
        assert np.abs(wanted.translation - found.translation).max() <= STEP_TOLERANCE
        assert rotation.angle(wanted.quaternion, found.quaternion).max() <= 2 * STEP_TOLERANCE
        assert np.linalg.norm(end[k].translation - found.translation[-1]) <= END_TOLERANCE + 1e-9
        assert rotation.angle(end[k].quaternion, found.quaternion[-1]) <= 2 * END_TOLERANCE
        assert np.array_equal(rollout.q[k], rollout.configurations[k, count - 1])
        assert np.array_equal(rollout.configurations[k, count:], np.tile(rollout.q[k], (STEPS - count, 1)))
    assert np.all(rollout.configurations >= robot.limits.lower)
    assert np.all(rollout.configurations <= robot.limits.upper)


def test_no_joint_is_asked_for_more_than_its_speed_and_the_greatest_share_is_reported():
    robot = load_robot("panda")
    start, end = ends_near(robot, 20, np.random.default_rng(2))
    rollout = straight_line_rollout(robot, robot.home, start, end, **SPEEDS)
    for k in np.flatnonzero(rollout.completed):
        shift = np.linalg.norm(end.translation[k] - start.translation)
        turn = rotation.angle(end.quaternion[k], start.quaternion)
        pace = max(shift / 0.1, turn / 0.5) / rollout.steps[k]
        path = np.vstack([robot.home, rollout.configurations[k, : rollout.steps[k]]])
        speed = (np.abs(np.diff(path, axis=0)) / (robot.limits.velocity * pace)).max()
        assert rollout.speed[k] == pytest.approx(speed, rel=1e-9)
        assert speed <= 1.0


def test_a_rollout_ends_where_the_arm_is_too_short_with_the_part_that_was_completed():
    robot = load_robot("panda")
    start = robot.forward(robot.home)
    end = Pose.from_translation([2.0, 0.0, 0.0]) @ start
    rollout = straight_line_rollout(robot, robot.home, start, end[None], **SPEEDS)
    assert ROLLOUT_ENDS[rollout.end[0]] in ("joint limits", "joint speed")
    assert 0.0 < rollout.share[0] < 0.5
    reached = robot.forward(rollout.q[0])
    shift = rollout.share[0] * (end.translation - start.translation)
    assert np.abs(reached.translation - start.translation - shift).max() <= STEP_TOLERANCE


def test_a_joint_that_cannot_keep_up_ends_the_rollout():
    robot = load_robot("panda")
    start, end = ends_near(robot, 6, np.random.default_rng(3))
    rollout = straight_line_rollout(robot, robot.home, start, end, speed=50.0, angular_speed=200.0)
    assert np.all(rollout.end == ROLLOUT_ENDS.index("joint speed"))
    assert np.all(rollout.speed > 1.0)
    assert np.all(rollout.q == robot.home)


def test_a_path_of_no_length_is_completed_at_once():
    robot = load_robot("panda")
    start = robot.forward(robot.home)
    rollout = straight_line_rollout(robot, robot.home, start, start[None], **SPEEDS)
    assert rollout.completed[0]
    np.testing.assert_allclose(rollout.q[0], robot.home, atol=1e-6)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_many_rollouts_equal_each_alone(count):
    robot = load_robot("ur5")
    start, end = ends_near(robot, count, np.random.default_rng(4))
    together = straight_line_rollout(robot, robot.home, start, end, **SPEEDS)
    assert together.q.shape == (count, 6)
    for k in range(count):
        alone = straight_line_rollout(robot, robot.home, start, end[k : k + 1], **SPEEDS)
        assert np.array_equal(alone.configurations[0], together.configurations[k])


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_interpreted_rollouts_equal_compiled_ones(monkeypatch):
    robot = load_robot("panda")
    start, end = ends_near(robot, 6, np.random.default_rng(5))
    compiled = straight_line_rollout(robot, robot.home, start, end, **SPEEDS)
    monkeypatch.setenv("OPTSC_COMPILER", "none")
    interpreted = straight_line_rollout(load_robot("panda"), robot.home, start, end, **SPEEDS)
    for a, b in zip(compiled, interpreted, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)


def test_impossible_rollouts_are_refused():
    robot = load_robot("panda")
    start = robot.forward(robot.home)
    with pytest.raises(InvalidValue, match="speed"):
        straight_line_rollout(robot, robot.home, start, start[None], speed=0.0, angular_speed=1.0)
    with pytest.raises(InvalidValue):
        straight_line_rollout(robot, np.full(7, np.nan), start, start[None], **SPEEDS)
    nowhere = Pose(start.quaternion, np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(InvalidValue, match="poses"):
        straight_line_rollout(robot, robot.home, start, nowhere[None], **SPEEDS)
