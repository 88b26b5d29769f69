"""Global inverse kinematics: what counts as a solution, where it lies, and what is said when there is none."""

import numpy as np
import pytest

from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.ik.arm import arm_search
from optsc.ik.batch import solve_ik
from optsc.kernels import compiler
from optsc.robot import ROBOT_NAMES, load_robot, model_from_urdf

PANDA, UR5 = load_robot("panda"), load_robot("ur5")
HALF_TURNS = Pose.from_quaternion(np.eye(4)[1:], np.zeros((3, 3)))

SLIDING_ARM = """
<robot name="sliding">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="tool"/>
  <joint name="first" type="continuous">
    <parent link="base"/><child link="a"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
    <limit velocity="1" effort="1"/>
  </joint>
  <joint name="second" type="prismatic">
    <parent link="a"/><child link="b"/><origin xyz="0.1 0 0"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-10" upper="10" velocity="1" effort="1"/>
  </joint>
  <joint name="third" type="revolute">
    <parent link="b"/><child link="c"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="3" velocity="1" effort="1"/>
  </joint>
  <joint name="fourth" type="revolute">
    <parent link="c"/><child link="tool"/><origin xyz="0.4 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-3.5" upper="3.5" velocity="1" effort="1"/>
  </joint>
</robot>
"""


def reachable(robot, count, seed=0):
    """Poses of random configurations, and the configurations."""
    q = robot.random_configuration(np.random.default_rng(seed), (count,))
    return robot.forward(q), q


def pose_error(robot, q, X_WT):
    """The larger of distance [m] and angle [rad], from pinocchio's kinematics."""
    found = robot.forward(q)
    turn = rotation.log(rotation.multiply(X_WT.quaternion, rotation.conjugate(found.quaternion)))
    distance = np.linalg.norm(X_WT.translation - found.translation, axis=-1)
    return np.maximum(distance, np.linalg.norm(turn, axis=-1))


def inside(robot, q):
    return np.all((q >= robot.limits.lower) & (q <= robot.limits.upper))


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_random_reachable_poses_are_solved_inside_the_limits(name):
    robot = load_robot(name)
    X_WT, _ = reachable(robot, 1000)
    middle = np.mean(robot.limits.sampling, axis=0)
    q, success, residual, reason, *_ = solve_ik(robot, X_WT, seeds=middle)
    assert np.count_nonzero(~success) <= 1
    assert inside(robot, q)
    error = pose_error(robot, q, X_WT)
    np.testing.assert_allclose(residual, error, rtol=1e-6, atol=1e-12)
    assert np.all(success == (error <= 1e-5))
    assert np.all((reason == "") == success)
    # Not at a singularity, where steps lead no nearer.
    assert np.count_nonzero(error[success] > 1e-9) <= 1


@pytest.mark.parametrize("kind", ["five joints", "sliding"])
def test_arms_of_other_kinds_are_solved_as_well(kind, tmp_path):
    if kind == "five joints":
        robot = load_robot(PANDA.urdf, tip="panda_link5")
    else:
        path = tmp_path / "sliding.urdf"
        path.write_text(SLIDING_ARM)
        robot = model_from_urdf(path, "tool")
    X_WT, _ = reachable(robot, 300)
    solutions = solve_ik(robot, X_WT)
    assert np.mean(solutions.success) >= 0.99
    assert inside(robot, solutions.q)
    assert np.all(pose_error(robot, solutions.q, X_WT)[solutions.success] <= 1e-9)


RAIL = """
<robot name="rail">
  <link name="base"/><link name="carriage"/><link name="tool"/>
  <joint name="slide" type="prismatic">
    <parent link="base"/><child link="carriage"/><origin xyz="0.1 0.2 0.3" rpy="{world}"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="carriage"/><child link="tool"/><origin xyz="0 0 0.1" rpy="{tool}"/>
  </joint>
</robot>
"""


@pytest.mark.parametrize("case", range(4))
def test_a_pose_is_judged_by_distance_and_angle_whatever_the_axes_of_world_and_tool(case, tmp_path):
    # A carriage can only slide, so that what a target is beside its rail, or turned by, stays.
    rng = np.random.default_rng(case)
    angles = {name: " ".join(map(repr, rng.uniform(-3, 3, 3).tolist())) for name in ("world", "tool")}
    path = tmp_path / "rail.urdf"
    path.write_text(RAIL.format(**angles))
    robot = model_from_urdf(path, "tool")
    along = robot.forward(np.array([0.5])).translation - robot.forward(np.array([-0.5])).translation
    beside = np.cross(along, rng.normal(size=(100, 3)))
    beside /= np.linalg.norm(beside, axis=1, keepdims=True)
    about = rng.normal(size=(100, 3))
    about /= np.linalg.norm(about, axis=1, keepdims=True)
    X_WT, _ = reachable(robot, 100, seed=case)
    for share in (0.9999, 1.0001):
        shifted = Pose(X_WT.quaternion, X_WT.translation + 1e-5 * share * beside)
        turned = Pose(rotation.multiply(rotation.exp(1e-5 * share * about), X_WT.quaternion), X_WT.translation)
        for target in (shifted, turned):
            solutions = solve_ik(robot, target, restarts=1)
            assert np.all(solutions.success == (share < 1.0))
            np.testing.assert_allclose(solutions.residual, 1e-5 * share, atol=1e-11)


def test_a_solution_is_finished_also_alone_and_from_a_start_within_tolerance():
    X_WT, q = reachable(PANDA, 60, seed=14)
    beside = PANDA.limits.clip(q + 1e-6)
    assert np.all(pose_error(PANDA, beside, X_WT) < 1e-5)
    for i in range(60):
        alone = solve_ik(PANDA, X_WT[i], seeds=beside[i])
        assert pose_error(PANDA, alone.q, X_WT[i]) <= 1e-9
        assert np.max(np.abs(alone.q - q[i])) < 1e-4


def test_a_pose_that_the_seed_reaches_is_solved_by_the_seed_itself():
    X_WT, q = reachable(PANDA, 50)
    solutions = solve_ik(PANDA, X_WT, seeds=q)
    np.testing.assert_array_equal(solutions.q, q)
    assert np.all(solutions.residual < 1e-12)


def test_a_nearby_pose_is_solved_by_a_nearby_configuration():
    seeds = PANDA.random_configuration(np.random.default_rng(1), (200,))
    goals = PANDA.limits.clip(seeds + np.random.default_rng(2).uniform(-0.02, 0.02, seeds.shape))
    solutions = solve_ik(PANDA, PANDA.forward(goals), seeds=seeds)
    assert np.all(solutions.success)
    assert np.median(np.max(np.abs(solutions.q - seeds), axis=1)) < 0.02
    assert np.mean(np.max(np.abs(solutions.q - seeds), axis=1) < 0.2) > 0.95


def test_joints_that_can_turn_fully_end_within_half_a_turn_of_their_seed():
    X_WT, _ = reachable(UR5, 200)
    seeds = UR5.random_configuration(np.random.default_rng(3), (200,))
    solutions = solve_ik(UR5, X_WT, seeds=seeds)
    assert inside(UR5, solutions.q)
    turn = np.abs(solutions.q - seeds)
    # Beyond half a turn only where the nearer equal angle is outside the limits.
    nearer = solutions.q - 2 * np.pi * np.sign(solutions.q - seeds)
    outside = (nearer < UR5.limits.lower) | (nearer > UR5.limits.upper)
    assert np.all((turn <= np.pi + 1e-9) | outside)
    assert np.count_nonzero(turn <= np.pi) > 900


def test_a_tool_turned_by_exactly_half_a_turn_is_no_solution():
    X_WT = PANDA.forward(PANDA.home) @ HALF_TURNS
    solutions = solve_ik(PANDA, X_WT, seeds=PANDA.home, restarts=0)
    error = pose_error(PANDA, solutions.q, X_WT)
    np.testing.assert_allclose(solutions.residual, error, atol=1e-7)
    assert np.all(solutions.success == (error <= 1e-5))
    again = solve_ik(PANDA, X_WT)
    assert np.all(pose_error(PANDA, again.q, X_WT)[again.success] <= 1e-9)
    assert np.any(again.success)


def test_the_same_generator_gives_the_same_bytes():
    X_WT, _ = reachable(PANDA, 300, seed=4)
    shifted = Pose.from_translation([0.0, 0.0, 0.15]) @ X_WT  # some of them beyond reach
    runs = [solve_ik(PANDA, shifted, rng=np.random.default_rng(5)) for _ in range(2)]
    assert not np.all(runs[0].success)
    for a, b in zip(*runs, strict=True):
        assert a.tobytes() == b.tobytes()


def test_a_pose_is_solved_alike_alone_and_among_others():
    X_WT, _ = reachable(UR5, 150, seed=6)
    together = solve_ik(UR5, X_WT)
    for i in range(0, 150, 10):
        alone = solve_ik(UR5, X_WT[i : i + 1])
        np.testing.assert_allclose(alone.q[0], together.q[i], atol=1e-12)


@pytest.mark.parametrize("shape", [(), (0,), (1,), (2, 3)])
def test_results_have_the_batch_shape_of_the_poses(shape):
    q = PANDA.random_configuration(np.random.default_rng(7), shape)
    X_WT = Pose.identity(shape) if 0 in shape else PANDA.forward(q)
    solutions = solve_ik(PANDA, X_WT, seeds=q)
    assert solutions.q.shape == (*shape, 7)
    assert solutions.success.shape == solutions.residual.shape == solutions.reason.shape == shape
    assert np.all(solutions.success)


def test_the_quaternions_sign_does_not_matter():
    X_WT, _ = reachable(PANDA, 100, seed=8)
    flipped = Pose(-X_WT.quaternion, X_WT.translation)
    np.testing.assert_array_equal(solve_ik(PANDA, X_WT).q, solve_ik(PANDA, flipped).q)


def test_seeds_outside_the_limits_are_moved_inside():
    X_WT, _ = reachable(PANDA, 20, seed=9)
    far = solve_ik(PANDA, X_WT, seeds=np.full(7, 9.0))
    at_limit = solve_ik(PANDA, X_WT, seeds=PANDA.limits.upper)
    np.testing.assert_array_equal(far.q, at_limit.q)


def test_a_tighter_tolerance_is_met():
    X_WT, _ = reachable(PANDA, 100, seed=10)
    solutions = solve_ik(PANDA, X_WT, tolerance=1e-10)
    assert np.all(solutions.success)
    assert np.max(pose_error(PANDA, solutions.q, X_WT)) <= 1.1e-10


def test_restarts_find_what_the_seed_does_not():
    X_WT, _ = reachable(PANDA, 300, seed=11)
    once, more = (np.mean(solve_ik(PANDA, X_WT, restarts=n).success) for n in (0, 8))
    assert 0.5 < once < 0.98 < more


@pytest.mark.parametrize("seed", [0, 1, 2307])
def test_further_tables_of_starts_do_not_repeat_the_first(seed):
    solver = arm_search(PANDA)
    drawn = solver.table(np.random.default_rng(seed))
    assert not np.isin(drawn.q, solver.first_table.q).any()


def test_a_pose_further_away_than_the_arm_is_long_is_out_of_reach():
    X_WT = Pose.from_translation([[2.0, 0.0, 0.5], [0.0, 0.0, 3.0]]) @ PANDA.forward(PANDA.home)
    solutions = solve_ik(PANDA, X_WT)
    assert solutions.reason.tolist() == ["out of reach"] * 2
    assert not np.any(solutions.success)
    assert inside(PANDA, solutions.q)
    np.testing.assert_allclose(solutions.residual, pose_error(PANDA, solutions.q, X_WT), rtol=1e-6)


def test_poses_behind_the_limits_are_distinguished_from_poses_that_no_configuration_has():
    # The elbow alone sets how far the wrist is from the shoulder, so its limits exclude what it would have to do.
    limits = {"lower": UR5.limits.lower.copy(), "upper": UR5.limits.upper.copy()}
    limits["lower"][2], limits["upper"][2] = 0.3, 1.2
    tight = load_robot("ur5", limits=limits, home=[0.0, -1.5, 0.8, -1.5, -1.5, 0.0])
    q = UR5.random_configuration(np.random.default_rng(12), (20,))
    q[:, 2] = 2.0
    behind = solve_ik(tight, UR5.forward(q))
    assert behind.reason.tolist() == ["joint limits"] * 20
    assert inside(tight, behind.q)
    # The wrist of this arm never comes nearer to the first axis than its shoulder is wide.
    nowhere = Pose(UR5.forward(UR5.home).quaternion, np.array([0.0, 0.0, 0.3]))
    assert solve_ik(UR5, nowhere).reason == "out of reach"
    assert solve_ik(UR5, nowhere, restarts=0).reason == "not found"


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_interpreted_and_compiled_solutions_agree(monkeypatch):
    X_WT, _ = reachable(PANDA, 20, seed=13)
    compiled = solve_ik(PANDA, X_WT)
    monkeypatch.setenv("OPTSC_COMPILER", "none")
    interpreted = solve_ik(load_robot("panda"), X_WT)
    np.testing.assert_array_equal(interpreted.success, compiled.success)
    np.testing.assert_allclose(interpreted.q, compiled.q, atol=1e-6)


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("tolerance", {"tolerance": 0.0}),
        ("tolerance", {"tolerance": float("nan")}),
        ("restarts", {"restarts": -1}),
        ("seeds", {"seeds": np.zeros(6)}),
        ("seeds", {"seeds": np.zeros((3, 7))}),
        ("seeds", {"seeds": np.full(7, np.nan)}),
    ],
)
def test_impossible_arguments_are_refused_by_name(field, arguments):
    with pytest.raises(InvalidValue, match=field):
        solve_ik(PANDA, Pose.identity((2,)), **arguments)


def test_a_pose_that_is_not_finite_is_refused():
    broken = Pose(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, np.nan, 0.0]]))
    with pytest.raises(InvalidValue, match="X_WT"):
        solve_ik(PANDA, broken)
