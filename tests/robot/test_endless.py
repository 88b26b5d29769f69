"""Endless joints: whole turns of a joint without position limits change nothing but its number."""

from types import SimpleNamespace

import numpy as np
import pytest

from optsc.control.servo import Servo
from optsc.geometry import Pose, rotation
from optsc.ik.batch import solve_ik
from optsc.robot import load_robot
from optsc.selection.costs import JointTravel

ENDLESS = (0, 2, 4, 6)


@pytest.fixture(scope="module")
def robot():
    """An arm like Kinova's Gen3: every other joint turns without end."""
    panda = load_robot("panda")
    lower, upper = (np.array(limit) for limit in panda.limits.positions)
    lower[list(ENDLESS)], upper[list(ENDLESS)] = -np.inf, np.inf
    return load_robot("panda", limits={"lower": lower, "upper": upper})


def turns_of(rng, most):
    turns = np.zeros(7)
    turns[list(ENDLESS)] = 2.0 * np.pi * rng.integers(-most, most + 1, len(ENDLESS))
    return turns


def test_which_joints_turn_without_end(robot):
    assert np.flatnonzero(robot.endless).tolist() == list(ENDLESS)
    assert not load_robot("ur5").endless.any()


def test_a_difference_of_configurations_leaves_out_whole_turns_of_endless_joints_alone(robot):
    rng = np.random.default_rng(0)
    for _ in range(50):
        a, b, turns = robot.random_configuration(rng), robot.random_configuration(rng), turns_of(rng, 20)
        gap = robot.difference(a + turns, b)
        np.testing.assert_allclose(gap, robot.difference(a, b), atol=1e-12)
        assert np.abs(gap[list(ENDLESS)]).max() <= np.pi
        np.testing.assert_array_equal(gap[[1, 3, 5]], (a - b)[[1, 3, 5]])


@pytest.mark.parametrize("most", [1, 20])
@pytest.mark.parametrize("seed", range(3))
def test_whole_turns_of_endless_joints_change_no_command(robot, most, seed):
    rng = np.random.default_rng(seed)
    q, turns = robot.random_configuration(rng), turns_of(rng, most)
    servos = [Servo(robot, 500.0), Servo(robot, 500.0)]
    servos[0].reset(q)
    servos[1].reset(q + turns)
    X, turn, shift = servos[0].X_WT, rng.normal(size=3), 0.1 * rng.normal(size=3)
    for k in range(600):
        s = min(k / 400.0, 1.0)
        target = Pose(rotation.multiply(rotation.exp(s * turn), X.quaternion), X.translation + s * shift)
        a, b = (servo.step(target, servo.time) for servo in servos)
        np.testing.assert_allclose(b.q - turns, a.q, atol=1e-5)  # the QP solver ends at 1e-6
    assert b.status is a.status
    assert np.abs(a.q - q).max() > 0.05  # it did move


def test_the_nearest_configuration_to_a_seed_is_as_many_turns_away_as_the_seed(robot):
    rng = np.random.default_rng(3)
    q = robot.random_configuration(rng, (5,))
    X, seeds = robot.forward(robot.random_configuration(rng, (5,))), q
    turns = turns_of(rng, 3)
    near, far = (
        solve_ik(robot, X, rng=np.random.default_rng(0), seeds=s, choice="nearest") for s in (seeds, seeds + turns)
    )
    np.testing.assert_allclose(far.q - turns, near.q, atol=1e-6)


def test_joint_travel_leaves_out_whole_turns_of_endless_joints():
    rng = np.random.default_rng(0)
    q, grasps, turns = rng.uniform(-3.0, 3.0, 7), rng.uniform(-3.0, 3.0, (7, 1, 4, 5)), turns_of(rng, 20)
    seen = [
        SimpleNamespace(grid=SimpleNamespace(q_grasp=grasps), q=here, endless=ENDLESS, chosen=lambda x: x[0])
        for here in (q, q + turns)
    ]
    a, b = (JointTravel().values(s) for s in seen)
    np.testing.assert_allclose(a, b, atol=1e-12)
