"""An arm that cannot get nearer to a target at rest comes to rest; one that can, goes on."""

from itertools import pairwise

import numpy as np
import pytest

from optsc.collision import CollisionAvoidance
from optsc.control.servo import Servo, Status
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.kernels.kernel import Kernel
from optsc.kernels.settling import SettlingSettings, settled
from optsc.robot import load_robot


def slow(name):
    robot = load_robot(name)
    n = robot.n
    return load_robot(name, limits={"acceleration": np.full(n, 2.0), "jerk": np.full(n, 100.0)})


def unhurried(name):
    robot = load_robot(name)
    v = robot.limits.velocity
    return load_robot(name, limits={"acceleration": v / 0.2, "jerk": v / 0.2 / 0.05})


def fastest_after(servo, X, settled, observed):
    """Greatest joint speed from ``settled`` seconds on after a target that jumped, for ``observed`` seconds."""
    fastest, last = 0.0, int((settled + observed) * servo.rate)
    for k in range(last):
        command = servo.step(X, servo.time)
        if k >= settled * servo.rate:
            fastest = max(fastest, np.abs(command.v).max())
    return fastest, command


@pytest.mark.parametrize(
    ("robot", "p"),
    [
        (load_robot("xarm7"), [0.7, 0.0, 0.0]),
        (slow("ur5"), [0.9, 0.3, 0.5]),
        (slow("iiwa"), [0.9, -0.4, 0.6]),
        (unhurried("panda"), [0.8, 0.3, 0.6]),
    ],
    ids=["xarm7", "slow ur5", "slow iiwa", "unhurried panda"],
)
def test_at_and_beyond_the_end_of_its_reach_the_arm_comes_to_rest(robot, p):
    servo = Servo(robot, 500.0)
    # A jump of a metre takes a slow arm three seconds; then there are two to come to rest.
    fastest, command = fastest_after(servo, Pose(servo.X_WT.quaternion, np.array(p)), 5.0, 0.5)
    assert fastest < 0.01
    said = (Status.UNREACHABLE, Status.LIMITED, Status.SINGULAR)
    assert command.status in ((Status.FOLLOWING,) if np.linalg.norm(command.error) < 1e-3 else said)


def test_an_arm_that_is_freed_goes_on_at_once():
    robot = load_robot("panda")
    servo = Servo(robot, 250.0)
    X = servo.X_WT
    _, command = fastest_after(servo, Pose(X.quaternion, np.array([1.5, 0.0, 0.5])), 5.0, 0.5)
    assert command.status is Status.UNREACHABLE
    fastest_after(servo, X, 0.1, 0.1)
    assert np.abs(servo.guard.columns[1]).max() > 0.05
    _, command = fastest_after(servo, X, 4.0, 0.1)
    assert command.status is Status.FOLLOWING


def test_a_reachable_target_far_away_is_never_given_up():
    rng = np.random.default_rng(4)
    for robot in (slow("ur5"), unhurried("panda")):
        servo = Servo(robot, 250.0)
        X = servo.X_WT
        away = Pose(
            rotation.multiply(rotation.exp([0.0, 0.0, 1.2]), X.quaternion),
            rotation.rotate(rotation.exp([0.0, 0.0, 1.2]), X.translation),
        )
        _, command = fastest_after(servo, away, 9.0, 0.1)
        assert command.status is Status.FOLLOWING, rng


class Tick:
    """One tick of the kernel for an arm at rest: a wish of joint 1, and what it takes off the error."""

    def __init__(self):
        self.kernel = Kernel(settled(load_robot("panda").chain), compiled=False)
        _, self.wish, _, _, self.descent, self.target, self.waiting, interval, self.bound, values = self.kernel.inputs
        interval[:] = [-100.0, 100.0]
        values[SettlingSettings.PERIOD], values[SettlingSettings.SIZE :] = 0.002, 100.0
        self.wish[0] = 1.0
        self.target[3] = self.waiting[4] = 1.0

    def share(self, gained, *, waited=1.0, square=0.01, asked=1.0, pace=0.0, shift=0.0):
        self.descent[0], self.descent[-2:], self.target[13] = gained, (square, asked), pace
        self.waiting[0], self.target[0] = waited, shift
        self.kernel.run()
        return self.kernel.outputs[0][0], self.kernel.outputs[1][0]


def test_what_is_on_its_way_is_given_in_full_and_what_gains_nothing_less_and_less():
    tick = Tick()
    assert tick.share(0.6) == (1.0, 0.0)  # more than half of what is asked of the tool
    assert tick.share(0.0, pace=1.0) == (1.0, 0.0)  # the target moves
    assert tick.share(0.0, waited=0.2)[0] == 1.0  # it has just come to rest
    assert tick.share(0.0, waited=2.0, shift=0.006) == (1.0, 0.002)  # it is at another place
    assert tick.share(0.0, waited=2.0, shift=0.004)[0] == 0.0
    shares = [tick.share(0.006, waited=t)[0] for t in np.arange(0.3, 3.0, 0.1)]
    assert shares[0] == 1.0
    assert shares[-1] == 0.0
    assert shares == sorted(shares, reverse=True)


def test_what_leads_away_from_something_is_given_in_full():
    tick = Tick()
    tick.bound[0] = 1.0
    assert tick.share(0.0, waited=2.0)[0] == 1.0


def test_an_arm_that_was_blocked_goes_on_when_the_obstacle_leaves():
    robot = load_robot("panda")
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    cube = TriangleMesh(0.06 * corners, np.array([[0, 1, 3]]))
    tool = robot.forward(robot.home)
    target = Pose(tool.quaternion, tool.translation - [0.0, 0.0, 0.2])
    avoid = CollisionAvoidance(robot, {"cube": (cube, target)}, table_height=None)
    servo = Servo(robot, 250.0, avoid=avoid)
    fastest, command = fastest_after(servo, target, 4.0, 2.0)
    assert fastest < 0.01
    assert command.status in (Status.BLOCKED, Status.UNREACHABLE)
    assert "cube" in command.reason
    avoid.move("cube", Pose.from_translation([5.0, 5.0, 5.0]))
    _, command = fastest_after(servo, target, 3.0, 0.1)
    assert command.status is Status.FOLLOWING


def test_over_a_table_the_arm_comes_to_rest_with_few_changes_of_its_status():
    robot = unhurried("panda")
    servo = Servo(robot, 500.0, avoid=CollisionAvoidance(robot, {}, 0.0))
    X = servo.X_WT
    below = Pose(X.quaternion, np.array([*X.translation[:2], -0.1]))
    commands = [servo.step(below, servo.time) for _ in range(2000)]
    assert max(np.abs(c.v).max() for c in commands[1500:]) < 0.01
    assert sum(a.status is not b.status for a, b in pairwise(commands)) < 30
    assert "table" in commands[-1].reason
