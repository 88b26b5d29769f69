"""What the status of a tick says of the tool and its target is true, on arms and targets drawn at random."""

import numpy as np
import pytest

from optsc.control.servo import Servo, ServoSettings, Status
from optsc.geometry import Pose, rotation
from optsc.ik import IkSettings
from optsc.robot import load_robot
from optsc.robot.manipulability import typical_volume

SAYS_WHY = (Status.UNREACHABLE, Status.LIMITED, Status.BLOCKED, Status.SINGULAR, Status.CATCHING_UP)


def led(servo, X, seconds):
    """Commands on the way to a target that comes in over a second and rests."""
    start = servo.X_WT
    turn = rotation.log(rotation.multiply(X.quaternion, rotation.conjugate(start.quaternion)))
    commands = []
    for k in range(int(seconds * servo.rate)):
        s = min(k * servo.period, 1.0)
        p = start.translation + s * (X.translation - start.translation)
        commands.append(servo.step(Pose(rotation.multiply(rotation.exp(s * turn), start.quaternion), p), servo.time))
    return commands


def misses(servo, X):
    """Distance and angle of the commanded tool to the target."""
    tool = servo.X_WT
    return np.linalg.norm(tool.translation - X.translation), float(rotation.angle(tool.quaternion, X.quaternion))


@pytest.mark.parametrize("name", ["panda", "ur5", "iiwa", "xarm7"])
def test_at_rest_following_is_said_exactly_within_a_millimetre_and_five_milliradians_of_the_target(name):
    robot, rng, said = load_robot(name), np.random.default_rng(0), []
    servo = Servo(robot, 250.0)
    for k in range(6):
        servo.reset(robot.home)
        near = robot.forward(robot.limits.clip(robot.home + 0.3 * rng.normal(size=robot.n)))
        far = Pose(rotation.random(rng), rng.normal(size=3))
        X = (near, far)[k % 2]
        command = led(servo, X, 3.0)[-1]
        distance, angle = misses(servo, X)
        assert (command.status is Status.FOLLOWING) == (distance <= 1e-3 and angle <= 5e-3)
        assert command.status is Status.FOLLOWING or (command.status in SAYS_WHY and command.reason)
        said.append(command.status)
    assert Status.FOLLOWING in said
    assert any(status is not Status.FOLLOWING for status in said)


def test_the_error_is_from_the_commanded_tool_to_the_target_itself():
    robot = load_robot("panda")
    servo = Servo(robot, 500.0, ServoSettings(lag=0.0))
    start = servo.X_WT
    X = Pose(start.quaternion, start.translation + [0.3, -0.2, 0.1])
    for _ in range(50):
        command = servo.step(X, servo.time)
        tool = robot.forward(command.q)
        expected = tool.rotation_matrix().T @ (X.translation - tool.translation)
        np.testing.assert_allclose(command.error[:3], expected, atol=1e-9)
    assert np.linalg.norm(command.error[:3]) > 0.3
    assert command.status in (Status.CATCHING_UP, Status.LIMITED)
    assert command.reason


def five_joints(tmp_path):
    """UR5 whose last joint is fixed."""
    robot = load_robot("ur5")
    text = robot.urdf.read_text().replace(
        '<joint name="wrist_3_joint" type="revolute">', '<joint name="wrist_3_joint" type="fixed">'
    )
    path = tmp_path / "five.urdf"
    path.write_text(text)
    return load_robot(path, tip="panda_hand_tcp", home=robot.home[:5])


def test_an_arm_of_five_joints_follows_in_the_components_that_have_a_weight_and_says_so_in_no_others(tmp_path):
    robot = five_joints(tmp_path)
    assert robot.n == 5
    rng = np.random.default_rng(1)
    turned, free = (
        Servo(robot, 250.0),
        Servo(robot, 250.0, ServoSettings(ik=IkSettings(orientation_weight=(0.0, 0.0, 0.0)))),
    )
    X = robot.forward(robot.home)
    X = Pose(rotation.multiply(rotation.exp(0.4 * rng.normal(size=3)), X.quaternion), X.translation + [0.05, 0.0, 0.03])
    command = led(turned, X, 3.0)[-1]
    assert command.status is not Status.FOLLOWING
    command = led(free, X, 3.0)[-1]
    assert command.status is Status.FOLLOWING
    assert misses(free, X)[0] < 1e-3
    np.testing.assert_array_equal(command.error[3:], 0.0)


def test_within_a_dead_band_the_tool_is_following():
    robot = load_robot("panda")
    servo = Servo(robot, 250.0, ServoSettings(ik=IkSettings(position_tolerance=(0.05, 0.05, 0.05))))
    X = servo.X_WT
    command = led(servo, Pose(X.quaternion, X.translation + [0.02, 0.01, -0.02]), 2.0)[-1]
    assert command.status is Status.FOLLOWING
    assert misses(servo, X)[0] < 0.05


def test_the_scale_of_manipulability_comes_from_the_workspace_and_not_from_home():
    robot = load_robot("ur5")
    straight = load_robot("ur5", home=np.zeros(6))
    J = straight.jacobian(straight.home)
    assert np.sqrt(max(np.linalg.det(J @ J.T), 0.0)) < 1e-6
    assert typical_volume(straight) == typical_volume(robot) > 0.01


@pytest.mark.parametrize("name", ["panda", "iiwa"])
def test_with_a_still_hand_the_elbow_rests_and_while_it_moves_the_status_says_so(name):
    robot, rng = load_robot(name), np.random.default_rng(2)
    servo = Servo(robot, 250.0)
    servo.reset(robot.limits.clip(robot.home + 0.5 * rng.normal(size=robot.n)))
    X = servo.X_WT
    start = servo.guard.q.copy()
    for _ in range(1000):
        command = servo.step(X, servo.time)
        assert command.reason or np.abs(command.v / robot.limits.velocity).max() < 0.021
    assert np.abs(command.q - start).max() < 1e-3
    assert command.status is Status.FOLLOWING


def test_spare_motion_that_stays_keeps_the_configuration_in_which_the_arm_began_to_be_led():
    robot = load_robot("panda")
    q = robot.home
    turned = []
    for spare in ("preferred", "stay"):
        servo = Servo(robot, 250.0, ServoSettings(spare_motion=spare))
        servo.prefer(robot.home + [0.9, 0.0, -0.9, 0.0, 0.5, 0.0, 0.0])
        X = servo.X_WT
        for k in range(1572):  # two whole periods
            s = 0.1 * np.sin(2.0 * k * servo.period)
            servo.step(Pose(X.quaternion, X.translation + [0.0, s, 0.0]), servo.time)
        turned.append(np.abs(servo.guard.q - q).max())
    assert turned[1] < 0.5 * turned[0], turned


def test_spare_motion_is_no_faster_than_its_bound():
    robot = load_robot("panda")
    for bound in (0.05, 0.2):
        servo = Servo(robot, 250.0, ServoSettings(ik=IkSettings(posture_speed=bound)))
        q = robot.home.copy()
        q[0] += 1.0
        servo.reset(q)
        X = servo.X_WT
        fastest = 0.0
        for k in range(1500):
            s = 0.02 * np.sin(k * servo.period)  # slow, so that nearly all motion is spare
            command = servo.step(Pose(X.quaternion, X.translation + [0.0, s, 0.0]), servo.time)
            fastest = max(fastest, np.linalg.norm(command.v))
        assert fastest < bound + 0.1
