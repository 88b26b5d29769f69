"""Public reports of arms that moved by themselves, each in its own small form.

What was reported is retold in each test. Public trackers of other projects, read in November 2026.
"""

import numpy as np
import pytest

import optsc
from optsc.control.modes import Mode
from optsc.control.status import Status
from optsc.followers import FollowerState
from optsc.geometry import Pose, rotation
from optsc.operators import OperatorSample
from optsc.robot import load_robot

RATE = 250.0


@pytest.fixture(scope="module", params=["panda", "ur5"])
def robot(request):
    return load_robot(request.param)


class Arm:
    """A controller, and an arm that follows its commands while its drives are on."""

    def __init__(self, robot, q=None, drives=True):
        self.robot = robot
        self.controller = optsc.SharedController(robot, optsc.GraspSelector(robot))
        self.controller.reset(robot.home, RATE)
        self.q, self.drives = np.array(robot.home if q is None else q), drives
        self.steps = []
        self.take_hold()

    def take_hold(self):
        """Hold the hand as the tool is, so that nothing has to fade."""
        self.hand = Pose(self.robot.forward(self.controller.servo.guard.q).quaternion, np.zeros(3))

    def go(self, seconds, clutch=True, hand=None, reading=None, lost=False):
        for _ in range(round(seconds * RATE)):
            sample = OperatorSample(self.controller.time, self.hand if hand is None else hand, clutch, lost=lost)
            measured = FollowerState(0.0, self.q if reading is None else reading, 0.0 * self.q, 0.08)
            step = self.controller.step(sample, measured)
            if self.drives:
                self.q = step.command.q.copy()
            self.steps.append(step)
        return self.steps[-1]

    def moved(self, since):
        """How far the tool went from where it was at a step [m]."""
        p = self.robot.forward(np.array([step.command.q for step in self.steps[since:]])).translation
        return float(np.linalg.norm(p - p[0], axis=1).max())

    def jump(self):
        """The largest step of a command, in parts of what the velocity limits allow."""
        q = np.array([step.command.q for step in self.steps])
        return float((np.abs(np.diff(q, axis=0)) * RATE / self.robot.limits.velocity).max())


def elsewhere(robot, size):
    sign = np.where(robot.home > 0.5 * (robot.limits.lower + robot.limits.upper), -1.0, 1.0)
    return robot.home + size * sign


@pytest.mark.parametrize("size", [0.05, 0.25, 0.8])
def test_moveit2_1885_an_arm_moved_by_another_means_while_paused_does_not_go_back(robot, size):
    """moveit/moveit2#1885: "If joint positions move by some other method when servo is paused [...] upon receiving new
    commands that are zero it returns to last sent position. Hence, there is a sudden movement."
    """
    arm = Arm(robot)
    arm.go(0.5)
    arm.go(0.2, clutch=False)
    # A protective stop; another controller moves the arm.
    arm.drives = False
    for share in np.linspace(0.0, 1.0, round(4.0 * RATE)):
        arm.q = robot.home + share * (elsewhere(robot, size) - robot.home)
        arm.go(1.0 / RATE, lost=True)
    arm.go(5.0, clutch=False)
    there = arm.q.copy()
    arm.take_hold()
    arm.drives = True
    before = len(arm.steps)
    assert arm.go(1.0).mode is Mode.MANUAL
    assert np.abs(arm.q - there).max() < 0.021
    assert arm.moved(before) < 2e-3
    assert arm.jump() <= 1.0 + 1e-9


@pytest.mark.parametrize("size", [0.1, 1.0])
def test_moveit2_3378_the_first_command_does_not_lead_to_the_start_state(robot, size):
    """moveit/moveit2#3378: "servo twist cmd cause to jump robot previous start state"; expected: "Should start current
    state", seen: "robot arm jump to start state and getting servo commands at that point".
    """
    arm = Arm(robot, elsewhere(robot, size), drives=False)
    arm.go(6.0)
    first = next(k for k, step in enumerate(arm.steps) if step.mode is Mode.MANUAL)
    assert np.abs(arm.steps[first].command.q - elsewhere(robot, size)).max() < 0.01
    assert arm.jump() <= 1.0 + 1e-9


def test_moveit2_1036_motion_does_not_begin_on_readings_that_are_missing_or_old(robot):
    """moveit/moveit2#1036: "weird jumps at the start of the servoing", with "Didn't received robot state (joint angles)
    with recent timestamp within 1 seconds"; in moveit2#2954 the first joint angles were all zero.
    """
    arm = Arm(robot, drives=False)
    for missing in (np.full(robot.n, np.nan), None, np.zeros(robot.n)):
        if missing is None:
            arm.go(0.01, reading="nothing")
        else:
            arm.go(0.012, reading=missing)
    arm.drives = True
    assert arm.go(0.5).mode is Mode.MANUAL
    assert arm.moved(0) < 1e-3
    lost = Arm(robot)
    for _ in range(3):
        last = lost.go(0.5, reading=np.full(robot.n, np.nan))
    assert last.mode is Mode.HOLD
    assert "reading" in last.reason


def test_lerobot_4046_a_joint_a_little_beyond_its_limit_does_not_jump_when_the_clutch_closes_again(robot):
    """huggingface/lerobot#4046, NVIDIA/IsaacTeleop#790: "a downward elbow/wrist jump after releasing Grip, keeping the
    controller still, and pressing Grip again"; the arm was measured at -103 degrees, its lower limit is -100 degrees.
    """
    start = robot.home.copy()
    start[1] = robot.limits.lower[1] - np.radians(3.0)
    arm = Arm(robot, start, drives=False)
    arm.go(12.0, clutch=False)
    arm.take_hold()
    arm.drives = True
    arm.go(0.5, clutch=False)
    before = len(arm.steps)
    for _ in range(3):
        arm.go(0.3, clutch=False)
        assert arm.go(0.3).mode is Mode.MANUAL
    assert arm.moved(before) < 1e-3
    assert arm.jump() <= 1.0 + 1e-9


def test_xr_teleoperate_286_a_tracker_that_reports_identity_does_not_lead_the_arm(robot):
    """unitreerobotics/xr_teleoperate#286: "the robotic arm extends straight forward and upward [...] the rotation
    matrices are all identity matrices, and the x and z coordinates of the left and right hands remain equal".
    """
    arm = Arm(robot)
    arm.go(1.0)
    before = len(arm.steps)
    start = robot.forward(arm.q)
    arm.go(1.0, hand=Pose.from_quaternion([1.0, 0.0, 0.0, 0.0], [0.2, 0.0, 0.4]))
    arm.go(1.0)
    assert any("jumped" in step.reason for step in arm.steps[before:])
    assert arm.moved(before) < 1e-3
    assert rotation.angle(robot.forward(arm.q).quaternion, start.quaternion) < 2e-3


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
def test_questvr_7_axes_of_a_controller_that_jump_by_90_degrees_do_not_turn_the_arm(robot, axis):
    """agilexrobotics/questVR_ws#7: "the handle coordinates of VR in rviz will jump 90 degrees, causing me to twitch
    often" in teleoperation.
    """
    arm = Arm(robot)
    arm.go(1.0)
    before, start = len(arm.steps), robot.forward(arm.q)
    for k in range(1, 5):
        turn = rotation.exp(0.5 * np.pi * k * np.array(axis))
        arm.go(0.5, hand=Pose(rotation.multiply(turn, arm.hand.quaternion), arm.hand.translation))
    assert arm.moved(before) < 1e-3
    assert rotation.angle(robot.forward(arm.q).quaternion, start.quaternion) < 2e-3


def test_isaaclab_1569_a_target_out_of_range_is_said_to_be_so(robot):
    """isaac-sim/IsaacLab#1569: the differential IK "can get stuck when calculating a distant target position. It would
    be helpful to set up an alert for target points that are out of the working range."
    """
    servo = optsc.Servo(robot, rate=RATE)
    start = servo.X_WT
    for k in range(round(4.0 * RATE)):
        shift = np.array([0.0, 0.0, min(2.0, k / RATE)])
        command = servo.step(Pose(start.quaternion, start.translation + shift), stamp=servo.time)
    assert command.status is Status.UNREACHABLE
    assert command.reason
