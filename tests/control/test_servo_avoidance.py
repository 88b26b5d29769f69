"""The servo among things: nothing is touched, nothing vibrates, and every way out is free."""

from functools import lru_cache

import numpy as np
import pytest

from optsc.collision import CollisionAvoidance
from optsc.control.servo import Servo, Status
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.robot import load_robot
from optsc.sim import object_model

RATE = 500.0
CORNERS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
CUBE = TriangleMesh(0.05 * CORNERS, [[0, 1, 3]])
PLACES = {"mug": -0.25, "can": 0.0, "box": 0.25}


@lru_cache
def among_objects(name):
    robot = load_robot(name)
    objects = {o: (object_model(o).parts, Pose.from_translation([0.5, y, 0.0])) for o, y in PLACES.items()}
    return robot, CollisionAvoidance(robot, objects)


@lru_cache
def with_cube(name):
    robot = load_robot(name)
    return robot, CollisionAvoidance(robot, {"cube": (CUBE, Pose.from_translation([0, 0, 5.0]))})


def least(avoid, q):
    distances = avoid.model.distances(q)[0]
    return float(distances.min())


def assert_within(robot, commands):
    q, v, a = (np.array([getattr(c, name) for c in commands]) for name in "qva")
    limits = robot.limits
    assert np.all(q <= limits.upper + 1e-9)
    assert np.all(q >= limits.lower - 1e-9)
    assert np.all(np.abs(v) <= limits.velocity + 1e-9)
    assert np.all(np.abs(a) <= limits.acceleration * (1 + 1e-9))
    assert np.all(np.abs(np.diff(a, axis=0, prepend=0)) <= limits.jerk / RATE * (1 + 1e-9))


def hostile(rng):
    kind = rng.integers(4)
    if kind == 0:
        p = np.array([*rng.uniform(-0.6, 0.6, 2), -0.4])  # below the table
    elif kind == 1:
        p = rng.normal(size=3) * 0.15 + [0, 0, 0.3]  # inside the arm
    elif kind == 2:
        p = np.array([0.5, rng.choice(list(PLACES.values())), 0.05])  # inside an object
    else:
        p = rng.uniform(-1, 1, 3)
    return Pose(rotation.random(rng), p)


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_the_arm_never_touches_anything_whatever_the_targets(name):
    robot, avoid = among_objects(name)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        servo, commands, nearest = Servo(robot, RATE, avoid=avoid), [], []
        for _ in range(6):
            X, ticks = hostile(rng), int(rng.integers(100, 700))
            for k in range(ticks):
                commands.append(servo.step(X, servo.time) if ticks % 3 else servo.stop())
                if k % 4 == 0:
                    nearest.append(least(avoid, servo.guard.q))
        assert_within(robot, commands)
        assert min(nearest) > 0.002
        blocked = [c for c in commands if c.status is Status.BLOCKED]
        assert all(" mm from " in c.reason for c in blocked)


def changes_of_direction(commands):
    v = np.array([c.v for c in commands])
    sign = np.sign(np.where(np.abs(v) > 1e-6, v, 0.0))
    return int((np.abs(np.diff(sign, axis=0)) > 1).sum())


def rms_jerk(robot, commands):
    """Greatest of the joints, as a share of the limit."""
    jerk = np.diff([c.a for c in commands], axis=0) * RATE
    return float((np.sqrt((jerk**2).mean(axis=0)) / robot.limits.jerk).max())


@pytest.mark.parametrize("name", ["panda", "ur5"])
@pytest.mark.parametrize("against", ["table", "cube", "self"])
def test_pressing_does_not_vibrate(name, against):
    robot, avoid = with_cube(name)
    servo = Servo(robot, RATE, avoid=avoid)
    X = servo.X_WT
    start = X.translation
    goals = {"table": [*start[:2], -0.3], "cube": start + [0.4, 0, 0], "self": [0.0, 0.0, 0.3]}
    goal = np.array(goals[against])
    place = start + [0.15, 0, 0] if against == "cube" else [0, 0, 5.0]
    avoid.move("cube", Pose.from_translation(place))
    commands = []
    for _ in range(int(10 * RATE)):
        share = min(1.0, servo.time / 3.0)
        commands.append(servo.step(Pose(X.quaternion, start + share * (goal - start)), servo.time))
    assert_within(robot, commands)
    assert commands[-1].status in (Status.BLOCKED, Status.UNREACHABLE, Status.SINGULAR)
    last = commands[int(8 * RATE) :]
    assert changes_of_direction(last) <= 2
    assert rms_jerk(robot, last) < 1e-3
    assert least(avoid, servo.guard.q) > 0.003


@pytest.mark.parametrize("name", ["panda", "iiwa"])
def test_motion_away_from_what_was_pressed_is_as_free_as_without_it(name):
    robot, avoid = with_cube(name)
    avoid.move("cube", Pose.from_translation([0, 0, 5.0]))
    servo = Servo(robot, RATE, avoid=avoid)
    X = servo.X_WT
    down = Pose(X.quaternion, np.array([*X.translation[:2], -0.1]))
    for _ in range(1500):
        command = servo.step(down, servo.time)
    q, low = servo.guard.q.copy(), servo.X_WT.translation[2]
    assert "table" in command.reason
    heights = []
    for avoiding in (avoid, None):
        free = Servo(robot, RATE, avoid=avoiding)
        free.reset(q)
        up = Pose(X.quaternion, np.array([*X.translation[:2], low + 0.1]))
        heights.append([(free.step(up, free.time), free.X_WT.translation[2])[1] for _ in range(250)])
    np.testing.assert_allclose(heights[0], heights[1], atol=2e-3)
    assert heights[0][-1] > low + 0.05


@pytest.mark.parametrize(
    ("offset", "fastest"), [([0.0, 0.0, -0.06], 0.6), ([0.0, 0.02, -0.06], 0.6), ([0.0, 0.0, 0.03], 2.61)]
)
def test_an_overlap_at_the_start_is_left_without_a_jump(offset, fastest):
    robot, avoid = with_cube("panda")
    servo = Servo(robot, RATE, avoid=avoid)
    X = servo.X_WT
    avoid.move("cube", Pose.from_translation(X.translation + offset))
    before = least(avoid, servo.guard.q)
    assert before < 0.0
    commands = [servo.step(X, servo.time) for _ in range(2500)]
    assert_within(robot, commands)
    assert all(np.isfinite(c.q).all() for c in commands)
    assert max(np.abs(c.v).max() for c in commands) < fastest
    assert least(avoid, servo.guard.q) > 0.5 * avoid.settings.margin
    assert changes_of_direction(commands[-500:]) <= 2


@pytest.mark.parametrize("told", [True, False])
def test_an_obstacle_that_moves_pushes_the_arm_away(told):
    robot, avoid = with_cube("panda")
    servo = Servo(robot, RATE, avoid=avoid)
    X, speed, nearest, commands = servo.X_WT, (0.2 if told else 0.05), [], []
    for _ in range(int(0.25 / speed * RATE)):
        place = X.translation + [0.3 - speed * servo.time, 0.0, -0.02]
        avoid.move("cube", Pose.from_translation(place), [-speed, 0, 0, 0, 0, 0] if told else None)
        commands.append(servo.step(X, servo.time))
        nearest.append(least(avoid, servo.guard.q))
    assert_within(robot, commands)
    assert min(nearest) > 0.003
    assert servo.X_WT.translation[0] < X.translation[0] - 0.01
    assert any("cube" in c.reason for c in commands)


def test_distances_give_before_joint_limits_do_and_by_how_much_is_returned():
    robot, avoid = with_cube("panda")
    servo = Servo(robot, RATE, avoid=avoid)
    X, commands = servo.X_WT, []
    avoid.move("cube", Pose.from_translation([0, 0, 5.0]))
    for _ in range(20):
        commands.append(servo.step(X, servo.time))
    assert all(c.slack == 0.0 for c in commands)
    # Faster than any arm gets out of the way.
    avoid.move("cube", Pose.from_translation(X.translation + [0.1, 0.0, -0.02]), [-8.0, 0, 0, 0, 0, 0])
    for _ in range(20):
        commands.append(servo.step(X, servo.time))
    assert commands[-1].slack > 3.0
    assert_within(robot, commands)
    avoid.move("cube", Pose.from_translation([0, 0, 5.0]))


@pytest.mark.parametrize("solver", ["proxqp", "quadprog"])
def test_every_solver_avoids_alike(solver):
    pytest.importorskip("quadprog")
    robot, avoid = with_cube("panda")
    avoid.move("cube", Pose.from_translation([0, 0, 5.0]))
    servos = [Servo(robot, RATE, avoid=avoid), Servo(robot, RATE, solver=solver, avoid=avoid)]
    X = servos[0].X_WT
    down = Pose(X.quaternion, np.array([*X.translation[:2], -0.1]))
    for _ in range(1500):
        a, b = (servo.step(down, servo.time) for servo in servos)
        # Spare motion weighs little, so that solvers of finite accuracy may slowly drift apart in it.
        np.testing.assert_allclose(a.q, b.q, atol=2e-3)
        np.testing.assert_allclose(*(s.X_WT.translation for s in servos), atol=3e-4)
    assert "table" in a.reason


def test_without_anything_near_avoidance_changes_nothing():
    robot, avoid = with_cube("panda")
    avoid.move("cube", Pose.from_translation([0, 0, 5.0]))
    runs = []
    for avoiding in (avoid, None):
        servo = Servo(robot, RATE, avoid=avoiding)
        X = servo.X_WT
        moved = [Pose(X.quaternion, X.translation + [0, 0.1 * np.sin(0.01 * k), 0]) for k in range(400)]
        runs.append([servo.step(target, servo.time).q for target in moved])
    assert np.array_equal(*np.array(runs))
