from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from selection_cases import (
    JOINTS,
    ROBOT,
    SmoothMeasure,
    random_candidates,
    random_hand,
    solve_all,
    solver,
    table_of,
)

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.selection import GraspSelector, JointTravel, WeightedSum

Q = np.linspace(-1.0, 1.0, JOINTS)


class Recorder:
    """Solves like `solve_all`, remembers what it was asked, and fails where asked to."""

    def __init__(self, fails=lambda X_WT: np.zeros(len(X_WT), dtype=bool)):
        self.calls, self.fails = [], fails

    def __call__(self, X_WT, seeds):
        q, success = solve_all(X_WT, seeds)
        self.calls.append((X_WT, np.array(seeds), q))
        return q, success & ~self.fails(X_WT), np.zeros(len(q))


def test_the_pre_grasp_is_solved_from_the_present_configuration_and_the_grasp_from_the_pre_grasp():
    candidates = random_candidates(np.random.default_rng(41), (6,))
    solve = Recorder()
    table = table_of(candidates, Q, solve=solve)
    (X_WP, seeds, q_pregrasp), (X_WG, grasp_seeds, q_grasp) = solve.calls
    assert np.array_equal(seeds, Q)
    assert np.array_equal(grasp_seeds, q_pregrasp)
    assert np.array_equal(table.q_grasp.reshape(-1, JOINTS), q_grasp)
    assert (X_WG @ Pose.from_translation([0.0, 0.0, -0.10])).almost_equal(X_WP)
    assert np.array_equal(table.seed, np.broadcast_to(Q, (6, 2, JOINTS)))
    assert np.array_equal(table.manipulability, SmoothMeasure().evaluate(ROBOT, table.q_grasp))


def test_the_twin_is_the_grasp_turned_by_half_a_turn_about_the_approach_axis():
    candidates = random_candidates(np.random.default_rng(42), (6,))
    table = table_of(candidates)
    assert table.X_WG[:, 0].almost_equal(candidates.X_WG)
    relative = candidates.X_WG.inverse() @ table.X_WG[:, 1]
    assert relative.almost_equal(Pose.from_rotation_vector([[0.0, 0.0, np.pi]] * 6, [[0.0, 0.0, 0.0]] * 6))


def test_each_row_says_why_it_cannot_be_used():
    candidates = random_candidates(np.random.default_rng(43), (40,), jaw_symmetric=False)
    X_WP = candidates.X_WG @ Pose.from_translation([0.0, 0.0, -0.10])
    no_pregrasp = X_WP.translation[:, 1] > 0.1
    no_grasp = (candidates.X_WG.translation[:, 0] > 0.55) & ~no_pregrasp
    limit = {"pregrasp": X_WP.translation[no_pregrasp], "grasp": candidates.X_WG.translation[no_grasp]}

    def fails(X_WT):
        bad = np.concatenate([limit["pregrasp"], limit["grasp"]])
        return np.array([np.any(np.all(np.abs(p - bad) < 1e-12, axis=1)) for p in X_WT.translation])

    asked = []

    def clear(q_grasp, q_pregrasp, rows):
        asked.append(rows)
        assert q_grasp.shape == q_pregrasp.shape == (len(rows.grasp_index), JOINTS)
        return rows.grasp_index % 2 == 0

    table = table_of(candidates, solve=Recorder(fails), clear=clear)
    odd = candidates.grasp_index % 2 == 1
    assert np.array_equal(table.rejected("pre-grasp unreachable")[:, 0], no_pregrasp)
    assert np.array_equal(table.rejected("unreachable")[:, 0], no_grasp)
    assert np.array_equal(table.rejected("collision")[:, 0], odd & ~no_pregrasp & ~no_grasp)
    assert np.array_equal(table.admissible[:, 0], ~odd & ~no_pregrasp & ~no_grasp)
    assert np.array_equal(asked[0].grasp_index, np.flatnonzero(~no_pregrasp & ~no_grasp))
    assert np.all(table.manipulability[~table.admissible] == 0.0)
    with pytest.raises(UnknownName, match="collision"):
        table.rejected("too far")


def test_the_collision_check_gets_one_candidate_per_row_with_the_pose_of_its_twin():
    candidates = random_candidates(np.random.default_rng(44), (3, 2))
    asked = []

    def clear(q_grasp, q_pregrasp, rows):
        asked.append(rows)
        return np.ones(len(rows.grasp_index), dtype=bool)

    table = table_of(candidates, clear=clear)
    assert asked[0].object_index.tolist() == [0, 0, 0, 0, 0, 0, 1, 1, 1, 1]
    assert asked[0].X_WG[1::2].almost_equal(table.X_WG[:, 1])
    assert asked[0].object_names == candidates.object_names


def test_refreshing_rows_gives_what_solving_all_from_there_would_have_given_for_them():
    candidates = random_candidates(np.random.default_rng(45), (10,))
    old, new = table_of(candidates), table_of(candidates, Q)
    rows = np.array([3, 8, 19])
    mixed = solver().refresh(old, rows, Q)
    solved = np.isin(np.arange(20), rows).reshape(10, 2)
    for name in ("q_grasp", "q_pregrasp", "status", "manipulability", "seed"):
        a, b, c = getattr(old, name), getattr(new, name), getattr(mixed, name)
        keep = solved.reshape(10, 2, *(1,) * (a.ndim - 2))
        assert np.array_equal(c, np.where(keep, b, a))
    assert not np.array_equal(old.manipulability, mixed.manipulability)


def test_a_table_cannot_be_written_to():
    table = table_of(random_candidates(np.random.default_rng(46), (3,)))
    for name in ("q_grasp", "q_pregrasp", "status", "manipulability", "seed"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(table, name)[0] = 0


def test_a_measure_that_is_not_a_number_counts_as_nothing():
    class Broken:
        def evaluate(self, robot, q):
            return np.where(np.arange(len(q)) % 2, np.nan, 0.4)

    table = table_of(random_candidates(np.random.default_rng(47), (4,), jaw_symmetric=False), manipulability=Broken())
    assert table.manipulability[:, 0].tolist() == [0.4, 0.0, 0.4, 0.0]


@pytest.mark.parametrize("settings", [{"standoff": -0.1}, {"standoff": float("nan")}, {"q": np.full(JOINTS, np.nan)}])
def test_settings_that_make_no_table_are_refused(settings):
    with pytest.raises(InvalidValue):
        table_of(random_candidates(np.random.default_rng(48), (2,)), **settings)


def selector_at(q, counts=(60, 60), **settings):
    selector = GraspSelector(ROBOT, None, SmoothMeasure(), solve=settings.pop("solve", solve_all), **settings)
    selector.observe(random_candidates(np.random.default_rng(49), counts), q)
    return selector


def test_the_finalists_are_judged_by_the_configuration_driven_to_from_the_present_one():
    hand = random_hand(np.random.default_rng(50))
    selector = selector_at(np.zeros(JOINTS))
    ranking = selector.rank(hand, 20 * Q, refresh_limit=100)
    assert not ranking.stale
    expected = table_of(selector.candidates, 20 * Q)
    final = np.isin(ranking.rejected_by, ["", "manipulability stage"])
    twin = ranking.decision.situation.grid.layout.gather(ranking.decision.situation.turned).astype(int)
    rows = np.flatnonzero(final), twin[final]
    assert final.sum() == 12
    assert np.array_equal(selector.table.manipulability[rows], expected.manipulability[rows])
    for name in ranking.object_names:
        target = ranking.target(name)
        of_object = [i for i in np.flatnonzero(final) if i in ranking.of(name)]
        assert target.manipulability == max(expected.manipulability[i, twin[i]] for i in of_object)
        assert np.array_equal(target.q, expected.q_grasp[target.candidate, int(target.half_turn)])


def test_a_call_solves_no_more_rows_than_its_limit_and_the_next_calls_catch_up():
    hand = random_hand(np.random.default_rng(51))
    solve = Recorder()
    selector = selector_at(np.zeros(JOINTS), solve=solve, refresh_limit=5)
    for stale, rows in ((True, 5), (True, 5), (False, 2), (False, 0)):
        solve.calls.clear()
        assert selector.rank(hand, 20 * Q).stale is stale
        assert sum(len(X_WT) for X_WT, *_ in solve.calls) == 2 * rows


def test_within_the_refresh_angle_nothing_is_solved_again():
    hand = random_hand(np.random.default_rng(52))
    solve = Recorder()
    selector = selector_at(np.zeros(JOINTS), solve=solve)
    solve.calls.clear()
    assert not selector.rank(hand, np.full(JOINTS, 0.09)).stale
    assert not solve.calls
    assert selector.rank(hand, np.full(JOINTS, 0.11), refresh_limit=0).stale
    assert not solve.calls
    selector.rank(hand, np.full(JOINTS, 0.11))
    assert len(solve.calls) == 2


def test_costs_of_the_configuration_follow_the_rows_that_were_solved_again():
    rng = np.random.default_rng(55)
    rule = WeightedSum(((JointTravel(), 1.0),))
    selector = GraspSelector(ROBOT, rule, SmoothMeasure(), solve=solve_all)
    selector.observe(random_candidates(rng, (4,), jaw_symmetric=False), np.zeros(JOINTS))
    selector.rank(random_hand(rng), np.zeros(JOINTS))
    q = np.full(JOINTS, 30.0)
    ranking = selector.rank(random_hand(rng), q)
    travel = np.abs(selector.table.q_grasp[:, 0] - q).max(axis=1)
    assert np.array_equal(ranking.total, travel)
    assert np.array_equal(selector.table.seed[:, 0], np.tile(q, (4, 1)))


def test_a_finalist_that_is_no_longer_reached_gives_way_to_the_next():
    hand = random_hand(np.random.default_rng(53))
    lost = []

    def fails(X_WT):
        return np.array([any(np.allclose(p, x) for x in lost) for p in X_WT.translation], dtype=bool)

    selector = selector_at(np.zeros(JOINTS), counts=(60,), solve=Recorder(fails))
    first = selector.rank(hand, np.zeros(JOINTS)).target("mug")
    lost.append(first.X_WG.translation)
    ranking = selector.rank(hand, np.full(JOINTS, 0.2), refresh_limit=100)
    assert ranking.chosen["mug"] != first.candidate
    assert ranking.chosen["mug"] is not None
    assert not ranking.stale


def test_idle_time_solves_the_rows_from_furthest_away_first():
    solve = Recorder()
    selector = selector_at(np.zeros(JOINTS), counts=(10,), solve=solve)
    q = np.full(JOINTS, 1.0)
    assert selector.refresh_oldest(q, 15) == 15
    assert selector.refresh_oldest(q, 15) == 5
    assert selector.refresh_oldest(q, 15) == 0
    assert np.array_equal(selector.table.seed, np.broadcast_to(q, (10, 2, JOINTS)))
    assert GraspSelector(ROBOT, None, SmoothMeasure(), solve=solve_all).refresh_oldest(q, 5) == 0


def test_candidates_given_to_rank_are_observed_once():
    rng = np.random.default_rng(54)
    solve = Recorder()
    selector = GraspSelector(ROBOT, None, SmoothMeasure(), solve=solve)
    candidates, hand = random_candidates(rng, (10,)), random_hand(rng)
    selector.rank(hand, Q, candidates)
    selector.rank(hand, Q, candidates)
    assert len(solve.calls) == 2
    # The same grasps in another object: known already.
    selector.rank(hand, Q, replace(candidates))
    assert len(solve.calls) == 2
    selector.rank(hand, Q, replace(candidates, X_WG=Pose.from_translation([0.01, 0.0, 0.0]) @ candidates.X_WG))
    assert len(solve.calls) == 4


@pytest.mark.parametrize("settings", [{"refresh_angle": 0.0}, {"refresh_limit": -1}, {"standoff": -1.0}])
def test_settings_that_make_no_selector_are_refused(settings):
    with pytest.raises(InvalidValue):
        GraspSelector(ROBOT, None, SmoothMeasure(), solve=solve_all, **settings)
