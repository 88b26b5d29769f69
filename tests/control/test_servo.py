"""The laws of motion, held by the servo for arms of the catalogue and for hostile streams of targets."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optsc.control.servo import Servo, ServoSettings, Status
from optsc.control.status import held_back, within
from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose, rotation
from optsc.ik import IkSettings
from optsc.kernels.kernel import Kernel
from optsc.kernels.reference import reference_model
from optsc.operators import prediction
from optsc.robot import ROBOT_NAMES, load_robot
from optsc.shaping import JointGuard

TOLERANCE = 1e-9


def assert_within(robot, period, commands):
    q, v, a = (np.array([getattr(c, name) for c in commands]) for name in "qva")
    limits = robot.limits
    assert np.all(q <= limits.upper + TOLERANCE)
    assert np.all(q >= limits.lower - TOLERANCE)
    assert np.all(np.abs(v) <= limits.velocity + TOLERANCE)
    assert np.all(np.abs(a) <= limits.acceleration * (1 + TOLERANCE))
    assert np.all(np.abs(np.diff(a, axis=0, prepend=0)) <= limits.jerk * period * (1 + TOLERANCE))


def hostile(kind, rng, X, t):
    if kind == "jumps":
        return Pose(rotation.random(rng), X.translation + rng.normal(size=3)), t
    if kind == "not a number":
        return (Pose(np.full(4, np.nan), X.translation) if rng.random() < 0.5 else X), t
    if kind == "a clock that stands still":
        return Pose(X.quaternion, X.translation + 0.2 * rng.normal(size=3)), 0.0
    if kind == "a clock that runs back":
        return X, t - rng.uniform(0, 0.05)
    return Pose(X.quaternion, X.translation * 1e6), t


KINDS = ["jumps", "not a number", "a clock that stands still", "a clock that runs back", "far away"]


@settings(deadline=None, max_examples=20)
@given(
    st.sampled_from(ROBOT_NAMES),
    st.sampled_from([250.0, 1000.0]),
    st.integers(0, 2**32 - 1),
    st.sampled_from(KINDS),
)
def test_every_tick_returns_a_command_within_all_limits_and_a_status_for_every_input(name, rate, seed, kind):
    robot, rng = load_robot(name), np.random.default_rng(seed)
    servo = Servo(robot, rate)
    servo.reset(robot.random_configuration(rng))
    X, commands = servo.X_WT, []
    for _ in range(250):
        commands.append(servo.step(*hostile(kind, rng, X, servo.time)) if rng.random() < 0.2 else servo.step())
    assert all(isinstance(c.status, Status) for c in commands)
    assert all(c.reason for c in commands if c.status not in (Status.FOLLOWING, Status.STOPPING, Status.HOLDING))
    assert_within(robot, servo.period, commands)


def circle(X, t):
    shift = 0.08 * np.array([np.cos(2 * t) - 1, np.sin(2 * t), 0.3 * np.sin(t)])
    return Pose(rotation.multiply(rotation.exp([0, 0, 0.3 * np.sin(t)]), X.quaternion), X.translation + shift)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_smooth_target_is_followed_closely_at_the_lag_that_was_asked_for(name):
    robot = load_robot(name)
    servo = Servo(robot, 500.0)
    X = servo.X_WT
    for k in range(1500):
        t = servo.time
        command = servo.step(circle(X, t), t) if k % 5 == 0 else servo.step()
    assert command.status is Status.FOLLOWING
    wanted = circle(X, servo.time - servo.settings.lag)
    assert np.linalg.norm(servo.X_WT.translation - wanted.translation) < 1e-3
    assert rotation.angle(servo.X_WT.quaternion, wanted.quaternion) < 5e-3


def test_an_unreachable_target_neither_freezes_the_arm_nor_makes_it_lurch_when_it_comes_back():
    robot = load_robot("panda")
    servo = Servo(robot, 500.0)
    X = servo.X_WT
    away = Pose(X.quaternion, X.translation + [2.0, 0, 0])
    commands = [servo.step(away, servo.time) for _ in range(2000)]
    assert commands[-1].status is Status.UNREACHABLE or np.linalg.norm(commands[-1].error[:3]) > 0.05
    reached = servo.X_WT.translation[0]
    assert reached > X.translation[0] + 0.2
    # Still responsive out there: the arm follows sideways.
    sideways = Pose(X.quaternion, X.translation + [2.0, 1.0, 0])
    y = servo.X_WT.translation[1]
    commands += [servo.step(sideways, servo.time) for _ in range(500)]
    assert servo.X_WT.translation[1] > y + 0.05
    back = [servo.step(X, servo.time) for _ in range(2500)]
    assert_within(robot, servo.period, commands + back)
    assert np.linalg.norm(servo.X_WT.translation - X.translation) < 2e-3


def test_an_angle_out_of_reach_does_not_keep_the_tool_from_its_place():
    servo = Servo(load_robot("panda"), 500.0, ServoSettings(far=(0.05, 0.02)))
    X = servo.X_WT
    # Turned by more than half a turn about the vertical: joint 7 ends before.
    for k in range(3000):
        turned = rotation.multiply(rotation.exp([0, 0, min(0.001 * k, 3.0)]), X.quaternion)
        shift = [0.0, 0.0, 0.05 * min(servo.time / 3.0, 1.0)]
        servo.step(Pose(turned, X.translation + shift), servo.time)
    assert servo.X_WT.translation[2] > X.translation[2] + 0.04


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_joint_at_either_end_of_its_range_is_named_where_it_holds_the_motion_back(side):
    robot = load_robot("panda")
    guard, q, wanted = JointGuard(robot.limits, 0.002), robot.home.copy(), np.zeros(robot.n)
    q[3] = getattr(robot.limits, side)[3]
    guard.reset(q)
    wanted[3] = guard.lowest[3] if side == "lower" else guard.highest[3]
    assert held_back(robot, guard, wanted, None) == (Status.LIMITED, "panda_joint4: position")
    wanted[3] += (1e-9 if side == "lower" else -1e-9) * robot.limits.velocity[3]  # rounding makes no difference
    assert held_back(robot, guard, wanted, None) == (Status.LIMITED, "panda_joint4: position")
    wanted[3] = 0.5 * (guard.lowest[3] + guard.highest[3])
    assert held_back(robot, guard, wanted, None) is None


@pytest.mark.parametrize("part", [0, 1])
def test_following_is_a_distance_and_an_angle_that_grow_with_the_speed_of_the_target(part):
    most = (1e-3, 5e-3)[part]
    for speed in (0.0, 0.3):
        sizes, speeds = [0.0, 0.0], [0.0, 0.0]
        speeds[part] = speed
        sizes[part] = most + 0.02 * speed
        assert within(*sizes, *speeds)  # also at the bound itself
        sizes[part] *= 1.001
        assert not within(*sizes, *speeds)


def test_a_target_that_jumps_is_not_taken_for_one_that_moves():
    servo = Servo(load_robot("panda"), 500.0)
    X = servo.X_WT
    servo.step(X, servo.time)
    fastest = 0.0
    for _ in range(1000):
        before = servo.X_WT.translation
        servo.step(Pose(X.quaternion, X.translation + [0.2, 0, 0]), servo.time)
        fastest = max(fastest, np.linalg.norm(servo.X_WT.translation - before) * 500.0)
    assert fastest < 1.05 * servo.settings.catching_up[0]
    assert servo.X_WT.translation[0] == pytest.approx(X.translation[0] + 0.2, abs=1e-3)


def test_how_far_a_joint_is_outside_is_returned_until_it_is_back():
    robot = load_robot("panda")
    servo, q = Servo(robot, 500.0), robot.home.copy()
    q[5] = robot.limits.upper[5] + 0.05
    servo.reset(q)
    X = servo.X_WT
    outside = [servo.step(X, servo.time).outside for _ in range(1500)]
    assert outside[0] == pytest.approx(0.05, abs=1e-4)
    assert np.all(np.diff(outside) <= 1e-9)
    assert outside[-1] == 0.0
    assert servo.spent > 0.0


def test_without_new_targets_the_arm_comes_to_rest_and_says_so():
    robot = load_robot("ur5")
    servo = Servo(robot, 500.0)
    X = servo.X_WT
    for _ in range(200):
        servo.step(circle(X, servo.time), servo.time)
    commands = [servo.step() for _ in range(300)]
    stale = [c for c in commands if c.status is Status.STALE]
    assert "old" in stale[0].reason
    assert commands[-1].v == pytest.approx(0, abs=1e-9)
    assert_within(robot, servo.period, commands[1:])
    # and goes on when they come back
    X = servo.X_WT
    for _ in range(300):
        command = servo.step(Pose(X.quaternion, X.translation + [0, 0, 0.02]), servo.time)
    assert command.status is Status.FOLLOWING


FOUR_JOINTS = """<robot name="four">
<link name="base"/>
<link name="l1"/>
<link name="l2"/>
<link name="l3"/>
<link name="l4"/>
<link name="tool"/>
<joint name="j1" type="revolute">
<parent link="base"/>
<child link="l1"/>
<origin xyz="0 0 0.2"/>
<axis xyz="0 0 1"/>
<limit effort="1" velocity="2" lower="-3" upper="3"/>
</joint>
<joint name="j2" type="revolute">
<parent link="l1"/>
<child link="l2"/>
<axis xyz="0 1 0"/>
<limit effort="1" velocity="2" lower="-2" upper="2"/>
</joint>
<joint name="j3" type="revolute">
<parent link="l2"/>
<child link="l3"/>
<origin xyz="0 0 0.3"/>
<axis xyz="0 1 0"/>
<limit effort="1" velocity="2" lower="-2.5" upper="2.5"/>
</joint>
<joint name="j4" type="revolute">
<parent link="l3"/>
<child link="l4"/>
<origin xyz="0 0 0.3"/>
<axis xyz="0 1 0"/>
<limit effort="1" velocity="2" lower="-2" upper="2"/>
</joint>
<joint name="t" type="fixed">
<parent link="l4"/>
<child link="tool"/>
<origin xyz="0 0 0.1"/>
</joint></robot>"""


def test_an_arm_of_four_joints_follows_in_position(tmp_path):
    (tmp_path / "four.urdf").write_text(FOUR_JOINTS)
    robot = load_robot(tmp_path / "four.urdf", tip="tool", home=[0.2, 0.5, 0.9, 0.4])
    servo = Servo(robot, 500.0, ServoSettings(ik=IkSettings(orientation_weight=(0.0, 0.0, 0.0)), far=(0.05, 4.0)))
    X, commands = servo.X_WT, []
    for _ in range(1500):
        commands.append(servo.step(circle(X, servo.time), servo.time))
    wanted = circle(X, servo.time - servo.settings.lag)
    assert np.linalg.norm(servo.X_WT.translation - wanted.translation) < 2e-3
    assert commands[-1].status is Status.FOLLOWING
    assert_within(robot, servo.period, commands)


def test_near_a_singularity_the_lost_direction_slows_the_others_go_on_and_the_status_says_so():
    robot = load_robot("ur5")
    stretched = robot.home.copy()
    stretched[2] = 0.05  # the elbow is almost straight: the way outwards is lost
    servo = Servo(robot, 500.0)
    servo.reset(stretched)
    X = servo.X_WT
    outwards = X.translation / np.linalg.norm(X.translation)
    sideways = np.cross([0.0, 0.0, 1.0], outwards)
    sideways /= np.linalg.norm(sideways)
    commands = []
    for _ in range(1500):
        shift = min(servo.time, 2.0) * (0.04 * outwards + 0.1 * sideways)
        commands.append(servo.step(Pose(X.quaternion, X.translation + shift), servo.time))
    moved = servo.X_WT.translation - X.translation
    assert sideways @ moved > 0.12
    assert outwards @ moved < 0.05
    told = [
        c for c in commands if c.status in (Status.SINGULAR, Status.UNREACHABLE) and "of the tool is lost" in c.reason
    ]
    assert told
    assert_within(robot, servo.period, commands)


def test_a_stop_is_smooth_and_ends_at_rest():
    robot = load_robot("iiwa")
    servo = Servo(robot, 1000.0)
    X = servo.X_WT
    moving = [servo.step(circle(X, servo.time), servo.time) for _ in range(400)]
    stopping = [servo.stop() for _ in range(400)]
    assert stopping[0].status is Status.STOPPING
    assert stopping[-1].status is Status.HOLDING
    assert_within(robot, servo.period, moving + stopping)


@pytest.mark.parametrize("solver", ["daqp", "proxqp", "quadprog"])
def test_every_solver_gives_the_same_motion(solver):
    pytest.importorskip("quadprog")
    robot = load_robot("panda")
    servo, other = Servo(robot, 500.0), Servo(robot, 500.0, solver=solver)
    X = servo.X_WT
    for _ in range(200):
        target = circle(X, servo.time)
        a, b = servo.step(target, servo.time), other.step(target, other.time)
        np.testing.assert_allclose(a.q, b.q, atol=1e-6)


def test_the_same_input_gives_the_same_bytes():
    robot = load_robot("panda")
    runs = []
    for _ in range(2):
        servo = Servo(robot, 500.0)
        X = servo.X_WT
        runs.append(np.array([servo.step(circle(X, servo.time), servo.time).q for _ in range(300)]).tobytes())
    assert runs[0] == runs[1]


def led_to(e0, v0, bandwidth, period, count, braking=3.0):
    """Positions of the reference model on its way from ``e0`` at ``v0`` to a target at rest at zero."""
    kernel = Kernel(reference_model(prediction.FADING), compiled=False)
    reference, target, elapsed, values, T, share = kernel.inputs
    reference[:], target[:], elapsed[:], T[:], share[:] = 0.0, 0.0, 0.0, period, 1.0
    reference[3] = target[3] = 1.0
    reference[0], reference[7] = e0, v0
    values[:] = bandwidth, braking, 0.5, braking, 1.5
    out = []
    for _ in range(count):
        kernel.run()
        reference[:] = kernel.outputs[0]
        out.append((reference[0], reference[7], reference[13]))
    return np.array(out)


def test_the_reference_model_is_the_exact_step_of_its_differential_equation():
    w, h, e0 = 40.0, 4e-3, 2e-3
    t = h * np.arange(1, 101)
    exact = e0 * np.exp(-w * t) * (1 + w * t + 0.5 * (w * t) ** 2)
    np.testing.assert_allclose(led_to(e0, 0.0, w, h, 100)[:, 0], exact, atol=1e-12)


@pytest.mark.parametrize("bandwidth", [45.0, 80.0])
@pytest.mark.parametrize("start", [(0.01, 0.0), (0.1, 0.0), (0.5, 0.0), (0.1, 0.3)])
def test_from_far_the_reference_catches_up_without_overshoot_and_no_harder_than_the_arm_can(start, bandwidth):
    e, v, a = led_to(*start, bandwidth, 2e-3, 1000).T
    assert np.all(e >= -1e-9)
    assert abs(e[-1]) < 1e-4
    assert np.abs(v).max() <= 0.5
    assert np.abs(a).max() <= (2.0 if start[1] == 0.0 else 3.5) * 3.0


def test_bad_settings_are_refused():
    robot = load_robot("panda")
    with pytest.raises(InvalidValue, match="rate"):
        Servo(robot, 0.0)
    with pytest.raises(UnknownName, match="solver"):
        Servo(robot, solver="abacus")
    with pytest.raises(InvalidValue):
        Servo(robot).reset(np.full(7, np.nan))
