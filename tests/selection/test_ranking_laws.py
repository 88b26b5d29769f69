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
    random_table,
    shuffled,
    solve_all,
    table_of,
)

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose, rotation
from optsc.selection import (
    AtMost,
    Cascade,
    GraspSelector,
    JointTravel,
    Lexicographic,
    ManipulabilityLoss,
    OrientationDistance,
    PoseDistance,
    PositionDistance,
    QualityLoss,
    Stage,
    WeightedSum,
)

Q = np.zeros(JOINTS)
POSE = PoseDistance((1.0, 0.7, 0.3), (1.0, 2.0, 0.2))
RULES = {
    "paper": Cascade.paper(),
    "manipulability only": Cascade.manipulability_only(),
    "weighted sum": WeightedSum(((POSE, 1.0), (ManipulabilityLoss(), 0.2), (JointTravel(), 0.01))),
    "lexicographic": Lexicographic(((POSE, 0.05), (ManipulabilityLoss(), 1e-3), (QualityLoss(), 1e-6))),
}
each_rule = pytest.mark.parametrize("rule", RULES.values(), ids=RULES.keys())


def rank(table, hand, rule=None, filters=()):
    selector = GraspSelector(ROBOT, rule, SmoothMeasure(), solve=solve_all, filters=filters)
    selector.use(table)
    return selector.rank(hand, Q)


def tied_candidates(rng, count=150):
    """Grasps in the 24 axis-aligned orientations and on a coarse grid: most of them tie with others."""
    candidates = random_candidates(rng, (count, count))
    axes = np.eye(3)
    turns = np.concatenate([rotation.exp(a * k * np.pi / 2) for a in axes for k in range(4)]).reshape(-1, 4)
    q = rotation.multiply(turns[rng.integers(0, 12, 2 * count)], turns[rng.integers(0, 12, 2 * count)])
    p = rng.integers(-2, 3, (2 * count, 3)) * 0.1 + [0.5, 0.0, 0.2]
    return replace(candidates, X_WG=Pose(q, p))


def tied_table(rng, candidates):
    table = random_table(rng, candidates)
    return replace(table, manipulability=np.round(table.manipulability, 1))


def identities(table, order):
    """Object and grasp index of candidates: what they are called, wherever they stand in the list."""
    c = table.candidates
    return [(c.object_names[c.object_index[i]], int(c.grasp_index[i])) for i in order]


@each_rule
@pytest.mark.parametrize("ties", [False, True])
def test_the_ranking_does_not_depend_on_the_world_frame(rule, ties):
    rng = np.random.default_rng(1)
    for _ in range(10):
        candidates = tied_candidates(rng) if ties else random_candidates(rng, (80, 40))
        table = tied_table(rng, candidates) if ties else random_table(rng, candidates)
        X_VW = Pose(rotation.random(rng), rng.normal(size=3))
        moved = replace(
            table,
            candidates=replace(candidates, X_WG=X_VW @ candidates.X_WG),
            X_WG=X_VW @ table.X_WG,
            X_WP=X_VW @ table.X_WP,
        )
        hand = random_hand(rng)
        one, other = rank(table, hand, rule), rank(moved, X_VW @ hand, rule)
        assert one.best == other.best
        assert one.order.tolist() == other.order.tolist()


@each_rule
def test_the_ranking_does_not_depend_on_the_sign_of_a_quaternion(rule):
    rng = np.random.default_rng(2)
    for _ in range(10):
        table = tied_table(rng, tied_candidates(rng))
        flipped = table.X_WG.quaternion * rng.choice([-1.0, 1.0], table.X_WG.shape)[..., None]
        other = replace(table, X_WG=Pose(flipped, table.X_WG.translation))
        hand = random_hand(rng)
        opposite = Pose(-hand.quaternion, hand.translation)
        assert rank(table, hand, rule).order.tolist() == rank(other, opposite, rule).order.tolist()


@each_rule
@pytest.mark.parametrize("ties", [False, True])
def test_the_ranking_does_not_depend_on_the_order_of_the_candidates(rule, ties):
    rng = np.random.default_rng(3)
    for _ in range(10):
        candidates = tied_candidates(rng) if ties else random_candidates(rng, (80, 40))
        table = tied_table(rng, candidates) if ties else random_table(rng, candidates)
        hand, order = random_hand(rng), rng.permutation(len(candidates.object_index))
        other = shuffled(table, order)
        one, two = rank(table, hand, rule), rank(other, hand, rule)
        assert identities(table, one.order) == identities(other, two.order)
        assert one.best == two.best
        assert one.rejected_by[order].tolist() == two.rejected_by.tolist()


def test_the_ranking_does_not_depend_on_the_order_of_the_objects():
    rng = np.random.default_rng(4)
    candidates = random_candidates(rng, (20, 30, 40))
    table, hand = random_table(rng, candidates), random_hand(rng)
    renamed = replace(candidates, object_names=candidates.object_names[::-1], object_index=2 - candidates.object_index)
    one, two = rank(table, hand), rank(replace(table, candidates=renamed), hand)
    assert one.chosen == two.chosen
    assert one.order.tolist() == two.order.tolist()


@pytest.mark.parametrize(
    "cost",
    [OrientationDistance(), PositionDistance(), ManipulabilityLoss(), POSE, JointTravel(), QualityLoss()],
    ids=lambda cost: cost.name,
)
def test_a_one_stage_cascade_equals_sorting_by_that_cost(cost):
    rng = np.random.default_rng(7)
    table, hand = random_table(rng, random_candidates(rng, (60,))), random_hand(rng)
    ranking = rank(table, hand, Cascade((Stage(cost),)))
    usable = np.flatnonzero(table.admissible.any(axis=1))
    expected = usable[np.argsort(ranking.cost_of(cost)[usable])]
    assert ranking.order.tolist() == expected.tolist()
    assert ranking.chosen["mug"] == expected[0]
    weighted = rank(table, hand, WeightedSum(((cost, 3.0),)))
    assert weighted.order.tolist() == expected.tolist()


def test_a_zero_weight_equals_leaving_the_term_out():
    rng = np.random.default_rng(8)
    table, hand = tied_table(rng, tied_candidates(rng)), random_hand(rng)
    terms = ((PositionDistance(), 2.0), (OrientationDistance(), 1.0))
    without = rank(table, hand, WeightedSum(terms))
    with_zero = rank(table, hand, WeightedSum(((JointTravel(), 0.0), *terms, (ManipulabilityLoss(), 0.0))))
    assert with_zero.order.tolist() == without.order.tolist()
    assert np.array_equal(with_zero.total, without.total)
    assert list(with_zero.costs) == ["position", "orientation"]


def test_the_total_of_a_weighted_sum_is_the_sum_of_its_weighted_costs():
    rng = np.random.default_rng(9)
    table, hand = random_table(rng, random_candidates(rng, (30, 20))), random_hand(rng)
    ranking = rank(table, hand, WeightedSum(((PositionDistance(), 2.0), (OrientationDistance(), 0.5))))
    expected = 2.0 * ranking.costs["position"] + 0.5 * ranking.costs["orientation"]
    assert np.allclose(ranking.total, expected, atol=1e-12)


def test_lexicographic_order_looks_at_the_second_cost_only_within_a_step_of_the_first():
    rng = np.random.default_rng(10)
    table, hand = random_table(rng, random_candidates(rng, (100,))), random_hand(rng)
    ranking = rank(table, hand, Lexicographic(((PositionDistance(), 0.1), (ManipulabilityLoss(), 1e-9))))
    d, M = ranking.costs["position"][ranking.order], ranking.costs["manipulability"][ranking.order]
    steps = np.floor(d / 0.1)
    assert np.all(np.diff(steps) >= 0)
    assert np.all(np.diff(M)[np.diff(steps) == 0] > 0)
    assert len(set(steps)) < len(steps)


@pytest.mark.parametrize("count", [1, 5, 6, 7, 29, 30, 31])
def test_where_there_are_fewer_than_a_stage_keeps_all_of_them_go_on(count):
    rng = np.random.default_rng(11)
    table = random_table(rng, random_candidates(rng, (count,)), reachable=1.0)
    rejected = rank(table, random_hand(rng)).rejected_by.tolist()
    assert rejected.count("orientation stage") == max(0, count - 30)
    assert rejected.count("position stage") == max(0, min(count, 30) - 6)
    assert rejected.count("manipulability stage") == min(count, 6) - 1
    assert rejected.count("") == 1


@each_rule
def test_of_no_candidates_nothing_is_chosen_and_the_explanation_says_so(rule):
    rng = np.random.default_rng(12)
    ranking = rank(table_of(random_candidates(rng, (0, 4))), random_hand(rng), rule)
    assert ranking.chosen["mug"] is None
    assert ranking.target("mug") is None
    assert ranking.of("mug").tolist() == []
    assert ranking.best == "can"
    assert "mug: no grasp. 0 candidates" in ranking.explain()
    nothing = rank(table_of(random_candidates(rng, ())), random_hand(rng), rule)
    assert nothing.best is None
    assert nothing.target() is None
    assert nothing.order.tolist() == []


def test_an_unreachable_candidate_is_never_ranked_and_its_reason_is_kept():
    rng = np.random.default_rng(13)
    candidates = random_candidates(rng, (50,), jaw_symmetric=False)
    table = random_table(rng, candidates, reachable=0.3)
    ranking = rank(table, random_hand(rng))
    reasons = np.array(["", "unreachable", "pre-grasp unreachable", "collision"])[table.status[:, 0]]
    out = reasons != ""
    assert ranking.rejected_by[out].tolist() == reasons[out].tolist()
    assert set(ranking.order.tolist()) == set(np.flatnonzero(~out).tolist())
    none = rank(replace(table, status=np.full_like(table.status, 3)), random_hand(rng))
    assert none.chosen == {"mug": None}
    assert "all rejected: 50 collision" in none.explain()


def test_ties_are_decided_by_the_next_cost_and_at_last_by_the_grasp_index():
    candidates = random_candidates(np.random.default_rng(14), (8,), jaw_symmetric=False)
    candidates = replace(
        candidates,
        grasp_index=np.array([7, 6, 5, 4, 3, 2, 1, 0]),
        X_WG=Pose(np.tile([1.0, 0, 0, 0], (8, 1)), np.array([[0.1 * (i // 2), 0, 0] for i in range(8)])),
    )
    table = replace(table_of(candidates), manipulability=np.full((8, 1), 0.5))
    hand = Pose.identity()
    ranking = rank(table, hand)
    # All are equal in orientation and manipulability; pairs are equal in position too.
    assert ranking.order.tolist() == [1, 0, 3, 2, 5, 4, 7, 6]
    assert ranking.chosen["mug"] == 1


def test_of_two_jaw_twins_the_nearer_is_taken_and_of_equally_near_ones_the_stored():
    stored = Pose.from_rotation_vector(np.array([[0.3, 0.0, 0.0]]), [[0.5, 0.0, 0.2]])
    candidates = replace(random_candidates(np.random.default_rng(15), (1,)), X_WG=stored)
    table = table_of(candidates)
    for degrees, half_turn in ((0, False), (60, False), (90, False), (91, True), (180, True), (-120, True)):
        hand = stored[0] @ Pose.from_rotation_vector([0.0, 0.0, np.radians(degrees)], [0.0, 0.0, 0.0])
        target = rank(table, hand).target("mug")
        assert target.half_turn is half_turn
        turn = Pose.from_rotation_vector([0.0, 0.0, np.pi * half_turn], [0.0, 0.0, 0.0])
        assert target.X_WG.almost_equal(stored[0] @ turn)


def test_equally_near_jaw_twins_stay_equal_whatever_the_world_frame():
    rng = np.random.default_rng(26)
    candidates = random_candidates(rng, (200,))
    table = table_of(candidates)
    for i in range(200):
        hand = candidates.X_WG[i] @ Pose.from_rotation_vector([0.0, 0.0, np.pi / 2], [0.0, 0.0, 0.0])
        assert rank(table, hand).target_of(i).half_turn is False


def test_a_jaw_twin_that_cannot_be_reached_leaves_the_grasp_to_the_other():
    rng = np.random.default_rng(16)
    candidates = random_candidates(rng, (1,))
    hand = candidates.X_WG[0]
    table = table_of(candidates)
    assert rank(table, hand).target("mug").half_turn is False
    blocked = replace(table, status=np.array([[1, 0]], dtype=np.int8))
    assert rank(blocked, hand).target("mug").half_turn is True


def test_grippers_without_jaw_symmetry_have_no_twins():
    rng = np.random.default_rng(17)
    table = table_of(random_candidates(rng, (5,), jaw_symmetric=False))
    assert table.twins == 1
    hand = table.X_WG[2, 0] @ Pose.from_rotation_vector([0.0, 0.0, np.pi], [0.0, 0.0, 0.0])
    ranking = rank(table, hand)
    assert ranking.costs["orientation"][2] == pytest.approx(np.sqrt(2.0))


def aim(hand, grasp):
    """How far a grasp is from what the hand points at, written once more with matrices."""
    R = grasp.rotation_matrix()
    p = R.T @ (hand.translation - grasp.translation)
    r = rotation.log(rotation.multiply(rotation.conjugate(grasp.quaternion), hand.quaternion))
    return np.sqrt(p @ (p * [1, 1, 0.1]) + 0.15**2 * r @ (r * [1, 1, 0.25]))


@each_rule
def test_the_best_object_is_the_one_that_the_hand_points_at_whatever_the_rule(rule):
    rng = np.random.default_rng(18)
    for _ in range(20):
        table, hand = random_table(rng, random_candidates(rng, (20, 20, 20))), random_hand(rng)
        ranking = rank(table, hand, rule)
        far = {
            name: min(aim(hand, ranking.target_of(i).X_WG) for i in ranking.of(name)) for name in ranking.object_names
        }
        assert ranking.best == min(far, key=far.get)
        assert ranking.target().candidate == ranking.order[0]
        assert ranking.order.tolist()[0] == ranking.chosen[ranking.best]


def test_a_target_is_the_row_of_the_reach_table_with_its_twin():
    rng = np.random.default_rng(19)
    candidates = random_candidates(rng, (10, 10))
    table = random_table(rng, candidates)
    ranking = rank(table, random_hand(rng))
    for name in ranking.object_names:
        target = ranking.target(name)
        row = target.candidate, int(target.half_turn)
        assert target.candidate == ranking.chosen[name]
        assert target.grasp_index == candidates.grasp_index[target.candidate]
        assert target.manipulability == table.manipulability[row]
        assert target.opening == candidates.opening[target.candidate]
        assert np.array_equal(target.q, table.q_grasp[row])
        assert np.array_equal(target.q_pregrasp, table.q_pregrasp[row])
        behind = target.X_WG @ Pose.from_translation([0.0, 0.0, -0.10])
        assert target.X_WP.almost_equal(behind)
        assert ranking.target_of(target.candidate).X_WG.almost_equal(target.X_WG)


def test_a_filter_removes_candidates_before_the_first_stage_and_names_its_reason():
    rng = np.random.default_rng(20)
    table = random_table(rng, random_candidates(rng, (60,)), reachable=0.5)
    hand = random_hand(rng)
    near = AtMost(PositionDistance(), 0.25)
    ranking = rank(table, hand, filters=(near,))
    out = ranking.costs["position"] > 0.25
    reached = table.admissible.any(axis=1)
    assert 0 < (out & reached).sum() < reached.sum()
    assert set(ranking.rejected_by[out & reached]) == {"beyond position 0.25 m"}
    assert set(ranking.rejected_by[~reached]) <= {"unreachable", "pre-grasp unreachable", "collision"}
    assert not set(ranking.order.tolist()) & set(np.flatnonzero(out).tolist())


def test_every_candidate_is_explained_with_its_object_its_fate_and_its_costs():
    rng = np.random.default_rng(21)
    table = random_table(rng, random_candidates(rng, (80, 40)))
    ranking = rank(table, random_hand(rng), filters=(AtMost(PositionDistance(), 0.5),))
    for i, reason in enumerate(ranking.rejected_by):
        text = ranking.explain(i)
        assert identities(table, [i])[0][0] in text
        assert (reason or "chosen") in text
        assert f"{ranking.costs['position'][i]:.3g} m" in text
    text = ranking.explain()
    assert f"The hand points at: {ranking.best}." in text
    assert "-> 30 (orientation stage) -> 6 (position stage) -> 1 (manipulability stage)" in text


def test_the_place_in_an_explanation_is_the_place_in_the_sorted_costs():
    rng = np.random.default_rng(22)
    table = random_table(rng, random_candidates(rng, (150,)), reachable=1.0)
    ranking = rank(table, random_hand(rng))
    d = ranking.costs["orientation"]
    i = int(np.argsort(d)[44])
    limit = np.sort(d)[29]
    assert f"place 45 of 150 (30 kept, the last with orientation {limit:.3g})" in ranking.explain(i)


@pytest.mark.parametrize(
    ("hand", "q", "words"),
    [
        (Pose(np.array([np.nan, 0, 0, 0]), np.zeros(3)), Q, "hand pose is not finite"),
        (Pose(np.array([1.0, 0, 0, 0]), np.array([0, np.inf, 0])), Q, "hand pose is not finite"),
        (Pose(np.zeros(4), np.zeros(3)), Q, "quaternion is zero"),
        (Pose.identity((2,)), Q, "batch"),
        (Pose.identity(), np.full(JOINTS, np.nan), "configuration is not finite"),
        (Pose.identity(), np.zeros(3), "shape"),
        (Pose.identity(), None, "shape"),
    ],
)
def test_a_pose_or_configuration_that_cannot_be_used_gives_the_previous_ranking_with_the_reason(hand, q, words):
    rng = np.random.default_rng(23)
    selector = GraspSelector(ROBOT, None, SmoothMeasure(), solve=solve_all)
    selector.use(table_of(random_candidates(rng, (10,))))
    empty = selector.rank(hand, q)
    assert words in empty.reason
    assert empty.best is None
    assert words in empty.explain()
    good = selector.rank(random_hand(rng), Q)
    kept = selector.rank(hand, q)
    assert (kept.chosen, kept.best) == (good.chosen, good.best)
    assert words in kept.reason
    assert words in kept.explain()
    assert selector.rank(random_hand(rng), Q).reason == ""


def test_an_empty_ranking_answers_every_question_that_has_an_answer():
    ranking = GraspSelector(ROBOT, None, SmoothMeasure(), solve=solve_all).rank(Pose.identity(), Q)
    assert ranking.reason == "no candidates were observed"
    assert ranking.order.tolist() == ranking.total.tolist() == ranking.rejected_by.tolist() == []
    assert ranking.costs == {}
    assert ranking.target() is None
    with pytest.raises(UnknownName):
        ranking.target("mug")


def test_asking_for_what_was_not_ranked_names_what_was():
    rng = np.random.default_rng(24)
    ranking = rank(table_of(random_candidates(rng, (3, 3))), random_hand(rng))
    with pytest.raises(UnknownName, match="can, mug"):
        ranking.target("cup")
    with pytest.raises(InvalidValue, match="0 to 5"):
        ranking.explain(6)


def test_a_ranking_stays_what_it_was_when_the_selector_goes_on():
    rng = np.random.default_rng(25)
    selector = GraspSelector(ROBOT, None, SmoothMeasure(), solve=solve_all)
    selector.use(random_table(rng, random_candidates(rng, (60, 60))))
    hands = [random_hand(rng) for _ in range(5)]
    rankings = [selector.rank(hand, Q) for hand in hands]
    selector.rank(hands[0], Q + 1.0, refresh_limit=50)
    for hand, ranking in zip(hands, rankings, strict=True):
        again = ranking.explain(), ranking.order.tolist()
        other = rank(ranking.decision.situation.grid.table, hand)
        assert again == (other.explain(), other.order.tolist())
