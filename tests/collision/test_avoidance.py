"""Soft rows behind every solver, and the rows that keep an arm clear."""

from dataclasses import replace

import numpy as np
import pytest

from optsc.collision import AvoidanceSettings, CollisionAvoidance
from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose, TriangleMesh
from optsc.ik import Rows, make_solver, solver_names
from optsc.robot import load_robot

NAMES = [name for name in ("daqp", "proxqp", "quadprog", "osqp") if name in solver_names()]
CORNERS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
CUBE = TriangleMesh(0.04 * CORNERS, [[0, 1, 3]])  # the hull counts, so one face will do


@pytest.fixture(params=NAMES)
def solver(request):
    return make_solver(request.param)


def problem(seed, n=7, m=4):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    box = np.full(n, 0.5)
    return A @ A.T / n + 0.1 * np.eye(n), rng.normal(size=n), -box, box, rng.normal(size=(m, n))


def test_soft_rows_that_can_be_kept_are_kept_by_every_solver(solver):
    for seed in range(10):
        H, g, low, high, G = problem(seed)
        bound = G @ np.random.default_rng(seed).uniform(low, high)  # somebody keeps them all
        unbounded = np.full(len(bound), np.inf)
        hard = solver.solve(H, g, low, high, Rows(G, bound, unbounded))
        soft = solver.solve(H, g, low, high, Rows(G, bound, unbounded, 1e5))
        tolerance = 1e-2 if solver.name == "osqp" else 1e-3
        assert hard.solved
        assert soft.solved, soft.reason
        np.testing.assert_allclose(soft.x, hard.x, atol=tolerance)
        assert soft.slack <= tolerance


def test_soft_rows_that_nobody_can_keep_leave_a_solution_within_the_bounds(solver):
    for seed in range(10):
        H, g, low, high, G = problem(seed)
        rows = Rows(G, np.full(4, 30.0), np.full(4, np.inf), 1e5)
        solution = solver.solve(H, g, low, high, rows)
        assert solution.solved, solution.reason
        assert np.all(np.abs(solution.x) <= 0.5 + (1e-2 if solver.name == "osqp" else 1e-7))
        assert solution.slack == pytest.approx((30.0 - G @ solution.x).max())
        assert solution.slack > 20.0


def test_every_solver_shares_a_lack_alike():
    H, g, low, high, G = problem(3)
    rows = Rows(G, np.array([3.0, 4.0, 2.0, 5.0]), np.full(4, np.inf), 1e3)
    answers = [make_solver(name).solve(H, g, low, high, rows).x for name in NAMES if name != "osqp"]
    for answer in answers[1:]:
        np.testing.assert_allclose(answer, answers[0], atol=1e-5)


def test_without_a_weight_rows_are_hard(solver):
    H, g, low, high, G = problem(4)
    assert not solver.solve(H, g, low, high, Rows(G, np.full(4, 30.0), np.full(4, np.inf))).solved


def at_tool(robot, p):
    return Pose.from_translation(robot.forward(robot.home).translation + p)


@pytest.fixture(scope="module")
def panda():
    robot = load_robot("panda")
    return robot, CollisionAvoidance(robot, {"cube": (CUBE, at_tool(robot, [0, 0, 1.0]))})


def around(v, width=0.05):
    return np.asarray(v) - width, np.asarray(v) + width


def test_far_from_everything_there_are_no_rows(panda):
    robot, avoid = panda
    avoid.move("cube", at_tool(robot, [0, 0, 1.0]))
    assert avoid.rows(robot.home, *around(np.zeros(7), 0.01)) is None
    assert avoid.blocking(np.zeros(7)) is None


def test_free_motion_away_is_never_blocked(panda):
    robot, avoid = panda
    rng, seen = np.random.default_rng(0), 0
    for _ in range(60):
        avoid.move("cube", at_tool(robot, rng.normal(size=3) * 0.12))
        rows = avoid.rows(robot.home, *around(np.zeros(7), 2.0))
        near = avoid._near
        for g, lower, d in zip(rows.matrix, rows.lower, near.distance, strict=True):
            away = g / np.linalg.norm(g)
            if d > avoid.settings.margin:
                assert lower < 0.0  # rest, and all motion away, is allowed
                seen += 1
            # Inside the margin no more than gentle motion out of it is asked for.
            assert lower <= avoid.settings.push
            assert g @ away > 0.0
    assert seen > 100


def test_the_allowed_approach_shrinks_to_nothing_at_the_margin_and_can_be_braked(panda):
    robot, avoid = panda
    s, limits = avoid.settings, robot.limits
    rates = []
    for gap in np.linspace(0.3, 0.0, 61):
        avoid.move("cube", at_tool(robot, [0.0, 0.0, -0.05 - gap]))
        rows = avoid.rows(robot.home, *around(np.zeros(7), 20.0))
        k = int(
            np.argmin(np.where(["cube" in avoid.model.pairs[i] for i in avoid._near.pair], avoid._near.distance, 9))
        )
        d, allowed = avoid._near.distance[k] - s.margin, -rows.lower[k]
        rates.append(allowed)
        able = np.abs(rows.matrix[k]) @ limits.acceleration
        if d > 0:
            assert 0 <= allowed <= d / s.delay_of(limits)
            assert allowed**2 / (2 * able) <= d  # the joints can brake within what is left
        else:
            assert -s.push <= allowed <= 0
    assert np.all(np.diff(rates) <= 1e-9)
    assert max(rates) > 0.5
    assert min(rates) < 0


def test_what_holds_a_motion_back_is_named(panda):
    robot, avoid = panda
    avoid.move("cube", at_tool(robot, [0.0, 0.0, -0.075]))
    rows = avoid.rows(robot.home, *around(np.zeros(7), 1.0))
    k = int(np.argmin(avoid._near.distance))
    towards = -rows.matrix[k] / np.linalg.norm(rows.matrix[k])
    blocking = avoid.blocking(towards)
    assert blocking.other == "cube"
    assert blocking.link in ("panda_leftfinger", "panda_hand")
    assert blocking.distance == avoid._near.distance[k]
    assert avoid.blocking(-towards) is None


def test_an_obstacle_that_moves_asks_for_as_much_way_as_it_takes(panda):
    robot, avoid = panda
    X = at_tool(robot, [0.0, 0.0, -0.12])
    lower = []
    for speed in (0.0, 0.2):
        avoid.move("cube", X, [0, 0, speed, 0, 0, 0])
        rows = avoid.rows(robot.home, *around(np.zeros(7), 5.0))
        lower.append(rows.lower[np.argmin(avoid._near.distance)])
    avoid.move("cube", X)
    assert lower[1] - lower[0] == pytest.approx(0.2, abs=0.02)


def test_a_stop_goes_straight_to_rest_where_nothing_is_near_and_moves_nothing_at_rest(panda):
    robot, avoid = panda
    avoid.move("cube", at_tool(robot, [0.0, 0.0, 1.0]))
    solver = make_solver()
    assert not avoid.stopping(robot.home, *around(0.2 * np.ones(7)), solver).any()
    avoid.move("cube", at_tool(robot, [0.0, 0.0, -0.05]))  # overlaps
    assert not avoid.stopping(robot.home, *around(np.zeros(7)), solver).any()


def test_restored_obstacles_are_where_they_were_move_as_they_did_and_may_be_touched_as_before():
    robot = load_robot("panda")
    avoid = CollisionAvoidance(robot, {"cube": (CUBE, at_tool(robot, [0.0, 0.0, -0.15]))})
    avoid.move("cube", at_tool(robot, [0.0, 0.0, -0.1]), [0.0, 0.0, 0.3, 0.0, 0.0, 0.0])

    def met():
        rows = avoid.rows(robot.home, *around(np.zeros(7), 2.0))
        return rows.matrix.tobytes(), rows.lower.tobytes(), [avoid.model.pairs[i] for i in avoid._near.pair]

    before, snapshot = met(), avoid.snapshot()
    avoid.move("cube", at_tool(robot, [0.0, 0.0, -0.13]))
    avoid.hand_may_touch("cube")
    after, later = met(), avoid.snapshot()
    assert after != before
    avoid.restore(snapshot)
    assert met() == before
    avoid.restore(later)
    assert met() == after


def test_impossible_settings_are_refused(panda):
    for wrong in ({"braking": 0.0}, {"push": np.nan}, {"most_rows": 0}, {"delay": -1.0}):
        with pytest.raises(InvalidValue):
            AvoidanceSettings(**wrong)
    with pytest.raises(InvalidValue, match="margin"):
        CollisionAvoidance(panda[0], settings=AvoidanceSettings(margin=2.0))
    with pytest.raises(UnknownName, match="cube"):
        panda[1].move("cup", Pose.identity())


def test_the_delay_follows_from_how_slowly_the_joints_ramp_up_their_accelerations():
    limits = load_robot("panda").limits
    assert AvoidanceSettings().delay_of(limits) == pytest.approx(0.05)
    slow = replace(limits, jerk=limits.acceleration / 0.1)
    assert AvoidanceSettings().delay_of(slow) == pytest.approx(0.3)
    assert AvoidanceSettings(delay=0.1).delay_of(slow) == 0.1
