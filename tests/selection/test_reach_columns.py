"""What the reach table measures on request, and the costs that read it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from selection_cases import random_candidates, random_hand, table_of

from optsc.collision import CollisionModel, GraspClearance
from optsc.control.approach import Approach
from optsc.control.path_feasibility import can_travel, which_can_travel
from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.grasps import Candidates
from optsc.ik.batch import solve_ik
from optsc.robot import load_robot
from optsc.robot.manipulability import Manipulability
from optsc.robot.rollout import straight_line_rollout
from optsc.selection import (
    AtMost,
    Cascade,
    ClearanceLoss,
    GraspSelector,
    ManipulabilityLoss,
    PathClearanceLoss,
    PathLength,
    PathManipulabilityLoss,
    PathSpeed,
    QualityLoss,
    ReachSolver,
    StraightMotion,
    StraightPathFilter,
    WeightedSum,
)
from optsc.selection import reach_columns as columns
from optsc.selection.grid import Grid, situate

HEIGHT = {"cube": 0.05, "post": 0.12}
COSTS = (ClearanceLoss(0.08), PathSpeed(), PathManipulabilityLoss(), PathClearanceLoss(0.08))
EVERYTHING = WeightedSum(tuple((cost, 1.0) for cost in (*COSTS, PathLength(), QualityLoss())))


def block(x, y, z):
    corners = [[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (0.0, 1.0)]
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return TriangleMesh(np.array(corners) * [x, y, z], np.array(faces))


SHAPES = {name: block(0.04, 0.04, height) for name, height in HEIGHT.items()}


def grasps(places, count=30):
    """Grasps from above and leaning, of every object at its place (x, y)."""
    pieces = []
    for k, name in enumerate(HEIGHT):
        rng = np.random.default_rng(60 + k)
        yaw, lean = rng.uniform(-np.pi, np.pi, count), rng.uniform(0.0, np.radians(80.0), count)
        zero = np.zeros(count)
        turns = [
            np.stack(axis, axis=-1) for axis in ((zero, zero, yaw), (zero, lean, zero), (zero + np.pi, zero, zero))
        ]
        q = rotation.multiply(rotation.multiply(rotation.exp(turns[0]), rotation.exp(turns[1])), rotation.exp(turns[2]))
        pieces.append(Pose(q, np.tile([*places[name], 0.8 * HEIGHT[name]], (count, 1))))
    return Candidates(
        object_names=tuple(HEIGHT),
        object_index=np.repeat([0, 1], count),
        grasp_index=np.tile(np.arange(count), 2),
        X_WG=Pose.concatenate(pieces),
        opening=np.full(2 * count, 0.04),
        quality=np.linspace(0.0, 1.0, 2 * count),
        jaw_symmetric=True,
    )


PLACES = {"cube": (0.45, 0.15), "post": (0.5, -0.15)}


@lru_cache
def arm():
    robot = load_robot("panda")
    return robot, CollisionModel(robot)


def clearance_at(places):
    obstacles = {name: (SHAPES[name], Pose.from_translation([*at, 0.0])) for name, at in places.items()}
    return GraspClearance(arm()[1].scene(obstacles))


@lru_cache
def observed():
    robot, _ = arm()
    selector = GraspSelector(robot, EVERYTHING)
    table = selector.observe(grasps(PLACES), robot.home, clear=clearance_at(PLACES))
    return selector, table


def test_only_what_a_rule_or_filter_reads_is_measured():
    robot, _ = arm()
    assert not GraspSelector(robot).observe(grasps(PLACES), robot.home).columns
    filtered = GraspSelector(robot, filters=(AtMost(PathSpeed(), 0.5), StraightPathFilter()))
    table = filtered.observe(grasps(PLACES), robot.home)
    assert set(table.columns) == {columns.PATH, columns.PATH_SPEED}
    assert set(observed()[1].columns) == {column for cost in COSTS for column in cost.columns}


def test_columns_are_finite_and_nothing_where_a_row_is_not_reached():
    _, table = observed()
    assert 20 < table.admissible.sum() < table.rows
    for values in table.columns.values():
        assert np.all(np.isfinite(values))
        assert not values[~table.admissible].any()
        assert np.ptp(values[table.admissible]) > 0.0


def test_the_clearance_is_that_of_grasp_and_pre_grasp_without_the_grasped_object_for_the_hand():
    _, table = observed()
    scene = clearance_at(PLACES).scene.capsules
    for i, t in np.argwhere(table.admissible)[::7]:
        name = table.candidates.object_names[table.candidates.object_index[i]]
        at_grasp = scene.measure(table.q_grasp[i, t][None], np.array([name]))
        before = scene.measure(table.q_pregrasp[i, t][None])
        expected = min(*at_grasp.own, *at_grasp.world, *before.own, *before.world)
        assert table.columns[columns.CLEARANCE][i, t] == pytest.approx(max(expected, columns.OVERLAP), abs=1e-12)


def test_predicted_motion_is_the_path_rolled_out_one_row_at_a_time():
    robot, _ = arm()
    _, table = observed()
    start, scene = robot.forward(robot.home), clearance_at(PLACES).scene.capsules
    completed = 0
    for i, t in np.argwhere(table.admissible)[::9]:
        X_WP, X_WG = table.X_WP[i, t][None], table.X_WG[i, t][None]
        settings = {"speed": 0.1, "angular_speed": 0.5}
        first = straight_line_rollout(robot, robot.home, start, X_WP, **settings)
        last = straight_line_rollout(robot, first.q, X_WP, X_WG, **settings)
        found = {name: values[i, t] for name, values in table.columns.items()}
        if not (first.completed[0] and last.completed[0]):
            assert found[columns.PATH_SPEED] == columns.WORST_SPEED
            assert found[columns.PATH_MANIPULABILITY] == 0.0
            continue
        completed += 1
        assert found[columns.PATH_SPEED] == pytest.approx(max(first.speed[0], last.speed[0]), rel=1e-9)
        path = np.vstack([first.configurations[0, : first.steps[0]], last.configurations[0, : last.steps[0]]])
        M = Manipulability().evaluate(robot, path)
        assert found[columns.PATH_MANIPULABILITY] >= M.min() - 1e-12
        assert found[columns.PATH_MANIPULABILITY] <= np.median(M)
        touch = np.array(
            [""] * first.steps[0] + [table.candidates.object_names[table.candidates.object_index[i]]] * last.steps[0]
        )
        every = scene.measure(path, touch)
        least = max(np.minimum(every.own, every.world).min(), columns.OVERLAP)
        assert least - 1e-12 <= found[columns.PATH_CLEARANCE] <= least + 0.05
    assert completed >= 3


def test_the_length_of_the_path_goes_by_the_pre_grasp():
    _, table = observed()
    hand = random_hand(np.random.default_rng(70))
    situation = situate(Grid(table), hand.quaternion, hand.translation, np.zeros(7))
    expected = np.linalg.norm(table.X_WP.translation[:, 0] - hand.translation, axis=1) + 0.1
    assert np.allclose(situation.grid.layout.gather(PathLength().values(situation)), expected, atol=1e-12)


def test_enough_clearance_costs_nothing_and_more_is_worth_nothing():
    _, table = observed()
    hand = random_hand(np.random.default_rng(71))
    situation = situate(Grid(table), hand.quaternion, hand.translation, np.zeros(7))
    clearance = situation.chosen(situation.grid.column(columns.CLEARANCE))
    cost = ClearanceLoss(0.04).values(situation)
    assert np.array_equal(cost == 0.0, clearance >= 0.04)
    assert np.allclose(cost[clearance < 0.04], 0.04 - clearance[clearance < 0.04])
    assert ClearanceLoss(0.04).describe(0.01) == "clearance 0.03 m"
    assert ClearanceLoss(0.04).describe(0.0) == "clearance at least 0.04 m"
    for cost_type in (ClearanceLoss, PathClearanceLoss):
        with pytest.raises(InvalidValue, match="enough"):
            cost_type(0.5)


def test_refreshed_rows_are_measured_from_the_new_configuration():
    robot, _ = arm()
    selector = GraspSelector(robot, EVERYTHING)
    clear = clearance_at(PLACES)
    old = selector.observe(grasps(PLACES), robot.home, clear=clear)
    q = robot.home + 0.2
    assert selector.refresh_oldest(q, 10) == 10
    expected = GraspSelector(robot, EVERYTHING).observe(grasps(PLACES), q, clear=clear)
    again = np.any(selector.table.seed != old.seed, axis=2)
    assert again.sum() == 10
    for name, values in selector.table.columns.items():
        assert np.array_equal(values, np.where(again, expected.columns[name], old.columns[name]))


def test_a_sum_over_the_table_is_worked_out_once_and_follows_the_table():
    selector, _ = observed()
    robot, _ = arm()
    hand = robot.forward(robot.home)
    ranking = selector.rank(hand, robot.home)
    expected = sum(ranking.cost_of(cost) for cost, _ in EVERYTHING.terms)
    assert np.allclose(ranking.total, expected, atol=1e-12)
    other = replace(
        selector.table,
        columns={**selector.table.columns, columns.CLEARANCE: np.zeros(selector.table.status.shape)},
    )
    selector.use(other, clear=clearance_at(PLACES))
    later = selector.rank(hand, robot.home, refresh_limit=0)
    assert np.allclose(later.total, sum(later.cost_of(cost) for cost, _ in EVERYTHING.terms), atol=1e-12)
    assert not np.allclose(later.total, expected)


def test_columns_that_cannot_be_measured_are_refused_before_anything_is_solved():
    robot, _ = arm()
    candidates = grasps(PLACES)
    with pytest.raises(InvalidValue, match="GraspClearance"):
        GraspSelector(robot, Cascade.manipulability_only(), filters=(AtMost(ClearanceLoss(), 0.01),)).observe(
            candidates, robot.home
        )
    with pytest.raises(InvalidValue, match="StraightMotion"):
        table_of(candidates, columns=frozenset({columns.PATH}))
    with pytest.raises(UnknownName, match="clearance on the path"):
        table_of(candidates, columns=frozenset({"beauty"}))
    with pytest.raises(InvalidValue, match="also"):
        GraspSelector(robot, EVERYTHING).use(table_of(random_candidates(np.random.default_rng(72), (3,))))


def test_a_ranking_that_lacks_its_scene_says_so_and_raises_nothing():
    robot, _ = arm()
    selector = GraspSelector(robot, EVERYTHING)
    ranking = selector.rank(robot.forward(robot.home), robot.home, grasps(PLACES))
    assert "collision check" in ranking.reason


def test_every_usable_row_can_be_approached_on_a_straight_line_and_ends_in_its_configuration():
    robot, _ = arm()
    _, table = observed()
    rows = table.admissible
    line = straight_line_rollout(
        robot, table.q_pregrasp[rows], table.X_WP[rows], table.X_WG[rows], speed=0.1, angular_speed=0.5
    )
    assert line.completed.all()
    np.testing.assert_allclose(line.q, table.q_grasp[rows], atol=1e-4)


def test_a_grasp_behind_a_limit_on_its_line_is_reached_but_has_no_straight_approach():
    robot, _ = arm()
    quick = StraightMotion(robot, speed=20.0, angular_speed=100.0)

    def solve(X_WT, seeds):
        found = solve_ik(robot, X_WT, seeds=seeds, restarts=0)
        return found.q, found.success

    solver = ReachSolver(robot, solve, Manipulability())
    plain = solver.table(grasps(PLACES), robot.home)
    table = replace(solver, motion=quick).table(grasps(PLACES), robot.home)
    refused = table.rejected("no straight approach")
    assert refused.sum() > 10
    assert plain.admissible[refused].all()


def test_many_paths_are_judged_as_each_by_itself():
    robot, _ = arm()
    _, table = observed()
    start, some = robot.forward(robot.home), np.argwhere(table.admissible)[:20]
    X_WP, X_WG = table.X_WP[some[:, 0], some[:, 1]], table.X_WG[some[:, 0], some[:, 1]]
    together = which_can_travel(robot, Approach(), robot.home, start, [X_WP, X_WG])
    alone = [can_travel(robot, Approach(), robot.home, [start, X_WP[k], X_WG[k]]) for k in range(len(some))]
    assert together.tolist() == alone
    assert together.sum() > 0


class Counting:
    """The inverse kinematics of a selector, which counts the poses."""

    def __init__(self, selector):
        self.solve, self.poses = selector.solver.solve, 0
        selector.solver = replace(selector.solver, solve=self)

    def __call__(self, X_WT, seeds):
        self.poses += len(X_WT)
        return self.solve(X_WT, seeds)


@pytest.mark.parametrize("rule", [Cascade.paper(), EVERYTHING], ids=["paper", "everything"])
def test_after_one_object_moved_only_its_grasps_are_solved_and_the_table_is_as_if_all_were(rule):
    robot, _ = arm()
    selector = GraspSelector(robot, rule)
    first = selector.observe(grasps(PLACES), robot.home, clear=clearance_at(PLACES))
    moved = {**PLACES, "post": (0.45, 0.08)}
    count = Counting(selector)
    table = selector.observe(grasps(moved), robot.home, clear=clearance_at(moved))
    assert 60 <= count.poses <= 2 * 60
    expected = GraspSelector(robot, rule).observe(grasps(moved), robot.home, clear=clearance_at(moved))
    for name in ("status", "manipulability", "q_grasp", "q_pregrasp", "seed"):
        assert np.array_equal(getattr(table, name), getattr(expected, name))
    for name in expected.columns:
        assert np.array_equal(table.columns[name], expected.columns[name])
    # The post stands close to the cube now: what was clear before is not any more.
    cube = table.candidates.object_index == 0
    assert np.any(first.admissible[cube] & table.rejected("collision")[cube])


def test_nothing_is_solved_again_where_nothing_moved_and_all_where_the_arm_did():
    robot, _ = arm()
    selector = GraspSelector(robot)
    selector.observe(grasps(PLACES), robot.home)
    count = Counting(selector)
    selector.observe(grasps(PLACES), robot.home + 0.05)
    assert count.poses == 0
    selector.observe(grasps(PLACES), robot.home, reuse=False)
    assert count.poses >= 120
    count.poses = 0
    selector.observe(grasps(PLACES), robot.home + 0.2)
    assert count.poses >= 120
    count.poses = 0
    one = replace(grasps(PLACES), object_names=("cube", "vase"))
    selector.observe(one, robot.home + 0.2)
    assert 60 <= count.poses <= 120


def test_manipulability_alone_still_decides_without_columns():
    rule = WeightedSum(((ManipulabilityLoss(), 1.0),))
    assert columns.needed(rule.costs) == frozenset()
    assert rule.deciding_cost.columns == frozenset()
    assert EVERYTHING.deciding_cost.columns == columns.needed(EVERYTHING.costs)
