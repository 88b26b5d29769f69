"""Global inverse kinematics with room to choose: tolerances by component, choices among configurations, collisions."""

import casadi
import numpy as np
import pytest

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose, rotation
from optsc.ik import arm
from optsc.ik.batch import REASONS, IkStatus, deviation, solve_ik
from optsc.kernels.newton import tool_deviation
from optsc.robot import ROBOT_NAMES, load_robot
from optsc.robot.manipulability import Manipulability

PANDA, UR5 = load_robot("panda"), load_robot("ur5")
TIGHT = 1e-5
ROLL_FREE = [TIGHT] * 5 + [np.inf]


def reachable(robot, count, seed=0):
    q = robot.random_configuration(np.random.default_rng(seed), (count,))
    return robot.forward(q), q


def inside(robot, q):
    return np.all((q >= robot.limits.lower) & (q <= robot.limits.upper))


def distance(q, seed):
    return np.linalg.norm(q - seed, axis=-1)


def turned(X, axis, angle):
    vectors = np.zeros((*np.shape(angle), 3))
    vectors[..., axis] = angle
    return X @ Pose.from_rotation_vector(vectors, np.zeros(3))


# Deviations ---------------------------------------------------------------------------------------------------------


def test_the_deviation_of_a_tool_is_its_shift_tilt_and_roll_in_the_targets_axes():
    rng = np.random.default_rng(0)
    X_WG = Pose.from_rotation_vector(rng.uniform(-2, 2, (50, 3)), rng.uniform(-1, 1, (50, 3)))
    shift, roll = rng.uniform(-1, 1, (50, 3)), rng.uniform(-3.1, 3.1, 50)
    tilt = np.concatenate([rng.uniform(-2, 2, (50, 2)), np.zeros((50, 1))], axis=1)
    tool = X_WG @ Pose.from_rotation_vector(tilt, shift)
    found = deviation(X_WG, turned(tool, 2, roll))
    np.testing.assert_allclose(found, np.column_stack([shift, tilt[:, :2], roll]), atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 1.0, 2.9])
def test_the_compiled_deviation_and_its_rates_agree_with_the_other_and_with_differences(angle):
    arguments = [casadi.SX.sym(*size) for size in [("R", 3, 3), ("p", 3), ("R_goal", 3, 3), ("p_goal", 3)]]
    compiled = casadi.Function("deviation", arguments, [casadi.densify(x) for x in tool_deviation(*arguments)])
    rng = np.random.default_rng(1)
    for _ in range(20):
        goal = Pose.from_rotation_vector(rng.uniform(-2, 2, 3), rng.uniform(-1, 1, 3))
        direction = rng.uniform(0, 2 * np.pi)
        tilt = angle * np.array([np.cos(direction), np.sin(direction), 0.0])
        tool = turned(goal @ Pose.from_rotation_vector(tilt, rng.uniform(-1, 1, 3)), 2, rng.uniform(-2, 2))

        def at(X, goal=goal):
            found = compiled(X.rotation_matrix(), X.translation, goal.rotation_matrix(), goal.translation)
            return found[0].full().ravel(), found[1].full()

        value, rates = at(tool)
        np.testing.assert_allclose(value, deviation(goal, tool), atol=1e-9)
        for i in range(3):
            step = np.zeros(3)
            step[i] = 1e-6
            after, before = (
                at(Pose(rotation.multiply(rotation.exp(s), tool.quaternion), tool.translation))[0]
                for s in (rotation.rotate(goal.quaternion, step), rotation.rotate(goal.quaternion, -step))
            )
            np.testing.assert_allclose((after - before)[3:] / 2e-6, rates[:, i], rtol=1e-4, atol=1e-5)


def test_opposite_approach_axes_are_half_a_turn_apart():
    opposite = turned(Pose.identity(), 0, np.pi)
    assert np.linalg.norm(deviation(Pose.identity(), opposite)[3:5]) == pytest.approx(np.pi)


# Tolerances ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize(
    "tolerance",
    [
        ROLL_FREE,
        [TIGHT] * 3 + [np.inf] * 3,
        [np.inf, TIGHT, TIGHT, 0.1, 0.05, 0.5],
        [1e-4, 0.02, 0.01, 0.1, 0.2, 0.5],
    ],
    ids=["roll free", "position only", "along a line", "boxes"],
)
def test_every_component_is_within_its_own_tolerance_and_within_the_limits(name, tolerance):
    robot = load_robot(name)
    X_WT, _ = reachable(robot, 200, seed=1)
    solutions = solve_ik(robot, X_WT, tolerance=tolerance)
    excess = np.abs(deviation(X_WT, robot.forward(solutions.q))) - np.array(tolerance)
    assert np.all(solutions.success)
    assert np.max(excess) <= 1e-12
    assert inside(robot, solutions.q)
    assert np.all(solutions.residual == 0.0)


@pytest.mark.parametrize("roll", [0.0, 1.0, np.pi, -2.5])
def test_a_free_roll_takes_no_part_in_the_solution(roll):
    X_WT, q = reachable(PANDA, 50, seed=2)
    solutions = solve_ik(PANDA, turned(X_WT, 2, np.full(50, roll)), seeds=q, tolerance=ROLL_FREE)
    np.testing.assert_array_equal(solutions.q, q)


def test_a_free_roll_solves_poses_that_a_bound_one_does_not():
    limits = {"lower": PANDA.limits.lower.copy(), "upper": PANDA.limits.upper.copy()}
    limits["lower"][6], limits["upper"][6] = 0.5, 1.0
    stiff = load_robot("panda", limits=limits)
    X_WT, _ = reachable(stiff, 100, seed=3)
    rolled = turned(X_WT, 2, np.full(100, np.pi))
    bound, free = solve_ik(stiff, rolled), solve_ik(stiff, rolled, tolerance=ROLL_FREE)
    assert np.count_nonzero(bound.reason == "joint limits") > 10
    assert np.all(free.success)


def test_six_equal_tolerances_solve_what_one_solves():
    X_WT, _ = reachable(UR5, 300, seed=4)
    one, six = solve_ik(UR5, X_WT), solve_ik(UR5, X_WT, tolerance=[TIGHT] * 6)
    assert np.all(one.success)
    assert np.all(six.success)


def test_room_is_used_no_further_than_is_needed():
    X_WT, q = reachable(PANDA, 100, seed=5)
    shifted = X_WT @ Pose.from_translation([0.0, 0.004, 0.0])
    solutions = solve_ik(PANDA, shifted, seeds=q, tolerance=[TIGHT, 0.01, TIGHT, TIGHT, TIGHT, TIGHT])
    np.testing.assert_array_equal(solutions.q, q)


# Choices ------------------------------------------------------------------------------------------------------------


def test_the_nearest_of_an_arms_discrete_configurations_is_found():
    # Six joints: a pose has finitely many configurations, so many random seeds find them all.
    X_WT, _ = reachable(UR5, 40, seed=6)
    chosen = solve_ik(UR5, X_WT, seeds=UR5.home, choice="nearest")
    assert np.all(chosen.success)
    least = np.full(40, np.inf)
    for start in UR5.random_configuration(np.random.default_rng(7), (100,)):
        found = solve_ik(UR5, X_WT, seeds=start, restarts=0)
        # The start was their seed, so full turns are taken off towards home afterwards.
        wound = found.q - 2 * np.pi * np.round((found.q - UR5.home) / (2 * np.pi))
        near = np.where(np.abs(wound) <= UR5.limits.upper, wound, found.q)
        least = np.where(found.success, np.minimum(least, distance(near, UR5.home)), least)
    assert np.mean(distance(chosen.q, UR5.home) <= least + 1e-4) >= 0.95


@pytest.mark.parametrize("tolerance", [TIGHT, ROLL_FREE], ids=["one", "roll free"])
def test_redundancy_is_used_for_what_is_chosen(tolerance):
    X_WT, _ = reachable(PANDA, 100, seed=8)
    measure = Manipulability()
    first, nearest, best = (
        solve_ik(PANDA, X_WT, tolerance=tolerance, choice=choice) for choice in ("first", "nearest", "manipulability")
    )
    assert np.all(first.success & nearest.success & best.success)
    near = [distance(s.q, PANDA.home) for s in (first, nearest, best)]
    able = [measure.evaluate(PANDA, s.q) for s in (first, nearest, best)]
    assert np.all(near[1] <= near[0] + 1e-9)
    assert np.all(able[2] >= able[0] - 1e-12)
    assert np.mean(near[1]) < 0.95 * np.mean(near[0])
    assert np.mean(able[2]) > 1.2 * np.mean(able[0])
    assert inside(PANDA, nearest.q)
    assert inside(PANDA, best.q)
    assert np.mean(nearest.found) > 4.0


def test_the_chosen_configuration_cannot_be_improved_within_the_pose():
    # At the nearest configuration the direction to the seed has no part along the surface, unless a limit holds.
    X_WT, _ = reachable(PANDA, 60, seed=9)
    q = solve_ik(PANDA, X_WT, choice="nearest").q
    free = np.all((q > PANDA.limits.lower + 1e-6) & (q < PANDA.limits.upper - 1e-6), axis=1)
    assert np.count_nonzero(free) > 15
    along = []
    for row in q[free]:
        null = np.linalg.svd(PANDA.jacobian(row))[2][-1]
        along.append(abs(null @ (PANDA.home - row)))
    assert np.median(along) < 0.02


def test_a_given_measure_is_what_is_maximised():
    class Elbow:
        def evaluate(self, robot, q):
            return -np.abs(np.asarray(q)[..., 2])

    X_WT, _ = reachable(PANDA, 50, seed=10)
    chosen = solve_ik(PANDA, X_WT, choice="manipulability", measure=Elbow()).q
    assert np.median(np.abs(chosen[:, 2])) < 0.5 * np.median(np.abs(solve_ik(PANDA, X_WT).q[:, 2]))


def test_several_seeds_of_a_pose_are_tried_in_turn():
    X_WT, q = reachable(PANDA, 60, seed=11)
    middle = np.mean(PANDA.limits.sampling, axis=0)
    lost = ~solve_ik(PANDA, X_WT, seeds=middle, restarts=0).success
    assert np.count_nonzero(lost) > 3
    both = solve_ik(PANDA, X_WT, seeds=np.stack([np.tile(middle, (60, 1)), q], axis=1), restarts=0)
    assert np.all(both.success)
    np.testing.assert_array_equal(both.q[lost], q[lost])


def test_a_single_pose_takes_several_seeds_as_well():
    X_WT, q = reachable(PANDA, 1, seed=12)
    solution = solve_ik(PANDA, X_WT[0], seeds=np.stack([PANDA.home, q[0]]), restarts=0)
    assert solution.success
    assert solution.q.shape == (7,)


@pytest.mark.parametrize("choice", ["first", "nearest", "manipulability"])
def test_choices_give_the_same_bytes_again(choice):
    X_WT, _ = reachable(PANDA, 40, seed=13)
    runs = [
        solve_ik(PANDA, X_WT, choice=choice, clear=lambda q: q[:, 0] > 0.0, rng=np.random.default_rng(1))
        for _ in range(2)
    ]
    for a, b in zip(*runs, strict=True):
        assert a.tobytes() == b.tobytes()


# Reasons ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("choice", ["first", "nearest", "manipulability"])
def test_a_solution_passes_the_collision_check_where_any_configuration_does(choice):
    X_WT, _ = reachable(PANDA, 100, seed=14)

    def clear(q):
        assert q.ndim == 2
        return q[:, 0] > 0.3

    solutions = solve_ik(PANDA, X_WT, choice=choice, clear=clear)
    assert np.all(solutions.q[solutions.success][:, 0] > 0.3)
    assert set(solutions.reason[~solutions.success]) == {"collision"}
    assert 0.2 < np.mean(solutions.success) < 1.0
    plain = solve_ik(PANDA, X_WT)
    assert np.all(solutions.success[clear(plain.q)])
    assert np.count_nonzero(solutions.success) > np.count_nonzero(clear(plain.q)) + 5


def test_a_pose_whose_every_configuration_touches_something_is_in_collision():
    X_WT, _ = reachable(PANDA, 20, seed=15)
    solutions = solve_ik(PANDA, X_WT, clear=lambda q: np.zeros(len(q), dtype=bool))
    assert np.all(solutions.status == IkStatus.COLLISION)
    assert np.all(solutions.found >= 1)
    assert np.all(solutions.residual <= TIGHT)


@pytest.mark.parametrize("name", ["panda", "iiwa"])
def test_poses_of_configurations_outside_the_limits_are_never_called_out_of_reach(name):
    robot = load_robot(name)
    q = np.random.default_rng(16).uniform(-np.pi, np.pi, (300, robot.n))
    solutions = solve_ik(robot, robot.forward(q))
    assert set(solutions.reason) == {"", "joint limits"}
    assert np.count_nonzero(~solutions.success) > 30


def test_poses_just_beyond_the_stretched_arm_are_out_of_reach():
    # The shoulder and the wrist of this arm are 0.95 m apart at most, and the bound by link lengths is longer.
    q = np.array([0.3, -0.4, 0.0, 0.0, -1.2, 0.5])
    outward = np.array([np.cos(0.3 + 0.0), np.sin(0.3), 0.0])
    X_WT = UR5.forward(q)
    further = [X_WT.translation + d * outward for d in (0.3, 0.5, 2.0)]
    poses = Pose(np.tile(X_WT.quaternion, (3, 1)), np.array(further))
    solutions = solve_ik(UR5, poses)
    assert solutions.reason.tolist() == ["out of reach"] * 3
    assert solutions.status.tolist() == [IkStatus.OUT_OF_REACH] * 3


def test_words_and_numbers_of_reasons_agree():
    assert len(REASONS) == len(IkStatus)
    X_WT, _ = reachable(PANDA, 50, seed=17)
    solutions = solve_ik(PANDA, Pose.from_translation([0.3, 0.0, 0.0]) @ X_WT)
    assert solutions.reason.tolist() == [REASONS[s] for s in solutions.status]
    assert np.all((solutions.status == IkStatus.SOLVED) == solutions.success)


# One pose -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("restarts", [0, 3, 32])
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_one_pose_is_solved_like_a_batch_of_it(name, restarts):
    robot = load_robot(name)
    X_WT, _ = reachable(robot, 60, seed=18)
    shifted = Pose.from_translation([0.0, 0.0, 0.1]) @ X_WT
    middle = np.mean(robot.limits.sampling, axis=0)
    together = solve_ik(robot, shifted, seeds=middle, restarts=restarts)
    for i in range(60):
        alone = solve_ik(robot, shifted[i], seeds=middle, restarts=restarts)
        for a, b in zip(alone, together, strict=True):
            assert a.shape == b[i].shape
            assert a.dtype == b.dtype
        assert alone.reason == together.reason[i]
        np.testing.assert_allclose(alone.q, together.q[i], atol=1e-9)


@pytest.mark.parametrize("choice", ["nearest", "manipulability"])
def test_one_pose_is_given_the_choice_that_a_batch_of_it_is(choice):
    X_WT, _ = reachable(PANDA, 10, seed=8)
    together = solve_ik(PANDA, X_WT, choice=choice)
    assert np.any(distance(together.q, solve_ik(PANDA, X_WT).q) > 0.1)
    for i in range(10):
        alone = solve_ik(PANDA, X_WT[i], choice=choice)
        assert alone.found == together.found[i]
        np.testing.assert_allclose(alone.q, together.q[i], atol=1e-9)


def test_the_memory_of_one_call_is_not_that_of_the_next():
    X_WT, _ = reachable(PANDA, 2, seed=19)
    first = solve_ik(PANDA, X_WT[0])
    kept = first.q.copy()
    solve_ik(PANDA, X_WT[1])
    np.testing.assert_array_equal(first.q, kept)
    assert arm.arm_search(PANDA) is arm.arm_search(PANDA)


# Errors -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("tolerance", {"tolerance": [TIGHT] * 5}),
        ("tolerance", {"tolerance": [TIGHT] * 5 + [0.0]}),
        ("tolerance", {"tolerance": [TIGHT] * 5 + [np.nan]}),
        ("tolerance", {"tolerance": [np.inf] * 6}),
        ("tolerance", {"tolerance": np.inf}),
        ("samples", {"samples": 0}),
        ("samples", {"samples": 512}),
        ("shape of seeds", {"seeds": np.zeros((2, 0, 7))}),
    ],
)
def test_impossible_settings_are_refused_by_name(field, arguments):
    with pytest.raises(InvalidValue, match=field):
        solve_ik(PANDA, Pose.identity((2,)), **arguments)


def test_an_unknown_choice_is_refused_with_those_there_are():
    with pytest.raises(UnknownName, match="first, manipulability, nearest"):
        solve_ik(PANDA, Pose.identity((2,)), choice="best")


@pytest.mark.parametrize("shape", [(), (1,)])
def test_a_single_broken_pose_or_seed_is_refused_as_well(shape):
    broken = Pose(np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*shape, 4)), np.full((*shape, 3), np.nan))
    with pytest.raises(InvalidValue, match="X_WT"):
        solve_ik(PANDA, broken)
    with pytest.raises(InvalidValue, match="seeds"):
        solve_ik(PANDA, Pose.identity(shape), seeds=np.full(7, np.inf))
