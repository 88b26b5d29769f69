"""A ranking as a table says for every candidate what it costs, where it stands and what removed it."""

import numpy as np
import pytest
from selection_cases import JOINTS, ROBOT, no_solutions, random_candidates, random_hand, random_table

from optsc.selection import Cascade, GraspSelector, Ranking, WeightedSum
from optsc.selection.costs import OrientationDistance, PositionDistance

RULES = (
    Cascade.paper(),
    WeightedSum(((OrientationDistance(), 1.0), (PositionDistance(), 2.0))),
)


@pytest.fixture(params=RULES, ids=["cascade", "sum"])
def ranking(request):
    rng = np.random.default_rng(11)
    candidates = random_candidates(rng, counts=(40, 60))
    one = GraspSelector(ROBOT, request.param, object(), solve=no_solutions, refresh_limit=0)
    one.use(random_table(rng, candidates, reachable=0.4))
    return one.rank(random_hand(rng), np.zeros(JOINTS))


def test_every_candidate_has_one_row(ranking):
    rows = ranking.rows()
    assert sorted(row.candidate for row in rows) == list(range(100))
    for name, count in (("mug", 40), ("can", 60)):
        assert sum(row.object_name == name for row in rows) == count


def test_ranks_costs_and_reasons_are_those_of_the_ranking(ranking):
    rows, costs, removed = ranking.rows(), ranking.costs, ranking.rejected_by
    for row in rows:
        assert row.removed_by == removed[row.candidate]
        for name, values in costs.items():
            (term,) = (key for key in row.costs if key.startswith(f"{name} ["))
            assert row.costs[term] == values[row.candidate]
        if row.rank is not None:
            assert ranking.of(row.object_name)[row.rank - 1] == row.candidate
        assert (row.rank == 1) == (ranking.chosen[row.object_name] == row.candidate)
        assert (row.removed_by == "") == (row.rank == 1)


def test_ranks_count_through_the_admissible_grasps_and_leave_out_the_filtered(ranking):
    for name in ranking.object_names:
        ranks = [row.rank for row in ranking.rows() if row.object_name == name]
        admissible = len(ranking.of(name))
        assert ranks == [*range(1, admissible + 1), *[None] * (len(ranks) - admissible)]
        assert None in ranks


def test_the_text_has_a_line_for_each_row_and_names_units_and_reasons(ranking):
    text = ranking.table()
    assert len(text.splitlines()) == 101
    assert "position [m]" in text.splitlines()[0]
    assert text.count("chosen") == 2
    assert "unreachable" in text
    assert len(ranking.table(limit=3).splitlines()) == 7


@pytest.mark.parametrize("count", [1, 2])
def test_the_next_best_grasp_is_named_where_there_is_one(count):
    rng = np.random.default_rng(12)
    one = GraspSelector(ROBOT, None, object(), solve=no_solutions, refresh_limit=0)
    one.use(random_table(rng, random_candidates(rng, counts=(count,)), reachable=1.0))
    ranking = one.rank(random_hand(rng), np.zeros(JOINTS))
    assert len(ranking.of("mug")) == count
    assert ("Next best: grasp" in ranking.explain()) == (count > 1)


def test_a_ranking_of_nothing_says_so():
    empty = Ranking.empty("no candidates were observed")
    assert empty.rows() == ()
    assert "no candidates were observed" in empty.table()
