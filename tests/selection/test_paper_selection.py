"""The paper's three steps (section II.B), read literally and written with loops, against the library."""

from __future__ import annotations

import math

import numpy as np
import pytest
from selection_cases import (
    JOINTS,
    ROBOT,
    SmoothMeasure,
    random_candidates,
    random_hand,
    random_table,
    solve_all,
)

from optsc.selection import Cascade, GraspSelector

SIZES = [(150,), (150,), (31,), (30,), (6,), (5,), (1,), (0,), (40, 12, 3), (60, 0, 35)]


def half_turned(q):
    w, x, y, z = q
    return (-z, y, -x, w)


def norm(numbers):
    return math.sqrt(sum(x * x for x in numbers))


def angular_distance(q_ee, q_i):
    plus = norm([a + b for a, b in zip(q_ee, q_i, strict=True)])
    minus = norm([a - b for a, b in zip(q_ee, q_i, strict=True)])
    return min(plus, minus)


def usable_poses(table, i):
    """The orientations under which grasp i can be reached, with their manipulability."""
    q = tuple(table.candidates.X_WG.quaternion[i].tolist())
    poses = [q, half_turned(q)] if table.candidates.jaw_symmetric else [q]
    return [(pose, float(table.manipulability[i, t])) for t, pose in enumerate(poses) if table.status[i, t] == 0]


def literal_selection(table, hand, k):
    """Of 150 poses the 30 nearest in orientation, of them the 6 nearest in position, of them the best M."""
    q_ee, p_ee = hand.quaternion.tolist(), hand.translation.tolist()
    candidate_list = []
    for i in range(len(table.candidates.object_index)):
        if table.candidates.object_index[i] != k:
            continue
        distances = [(angular_distance(q_ee, q), M) for q, M in usable_poses(table, i)]
        if distances:
            d_a, M = min(distances)
            p_i = table.candidates.X_WG.translation[i].tolist()
            d_l = norm([a - b for a, b in zip(p_ee, p_i, strict=True)])
            candidate_list.append((d_a, d_l, M, i))
    candidate_list = sorted(candidate_list, key=lambda c: c[0])[:30]
    candidate_list = sorted(candidate_list, key=lambda c: c[1])[:6]
    best = max(candidate_list, key=lambda c: c[2], default=None)
    return None if best is None else best[3]


@pytest.mark.parametrize("block", range(10))
def test_with_the_papers_settings_the_selection_equals_a_literal_reading_of_the_papers_three_steps(block):
    rng = np.random.default_rng(100 + block)
    for case in range(100):
        counts = SIZES[case % len(SIZES)]
        candidates = random_candidates(rng, counts, jaw_symmetric=bool(rng.random() < 0.5))
        table = random_table(rng, candidates, reachable=rng.choice([0.1, 0.7, 1.0]))
        selector = GraspSelector(ROBOT, Cascade.paper(), SmoothMeasure(), solve=solve_all)
        selector.use(table)
        hand = random_hand(rng)
        ranking = selector.rank(hand, np.zeros(JOINTS))
        for k, name in enumerate(candidates.object_names):
            assert ranking.chosen[name] == literal_selection(table, hand, k)


def test_the_stages_keep_thirty_and_six_and_one():
    rng = np.random.default_rng(5)
    selector = GraspSelector(ROBOT, None, SmoothMeasure(), solve=solve_all)
    selector.use(random_table(rng, random_candidates(rng, (150,)), reachable=1.0))
    rejected = selector.rank(random_hand(rng), np.zeros(JOINTS)).rejected_by.tolist()
    assert rejected.count("orientation stage") == 120
    assert rejected.count("position stage") == 24
    assert rejected.count("manipulability stage") == 5
    assert rejected.count("") == 1


def test_the_older_strategy_takes_the_highest_manipulability_wherever_the_hand_is():
    rng = np.random.default_rng(6)
    candidates = random_candidates(rng, (150,), jaw_symmetric=False)
    table = random_table(rng, candidates)
    selector = GraspSelector(ROBOT, Cascade.manipulability_only(), SmoothMeasure(), solve=solve_all)
    selector.use(table)
    best = int(np.argmax(table.manipulability[:, 0]))
    for _ in range(20):
        assert selector.rank(random_hand(rng), np.zeros(JOINTS)).chosen == {"mug": best}
