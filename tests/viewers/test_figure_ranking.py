"""The picture of a ranking shows every candidate, every cost, and what removed whom."""

import numpy as np
import pytest
from selection_cases import JOINTS, no_solutions, random_candidates, random_hand, random_table

from optsc.errors import InvalidValue
from optsc.selection import Cascade, GraspSelector, Ranking
from optsc.viewers.drawing import save_figure
from optsc.viewers.figure_ranking import ranking_figure


class Arm:
    """An arm without kinematics, whose joints do not turn endlessly."""

    n, endless = JOINTS, np.zeros(JOINTS, dtype=bool)

    def difference(self, q_to, q_from):
        return np.asarray(q_to) - np.asarray(q_from)


@pytest.fixture
def ranking():
    rng = np.random.default_rng(12)
    candidates = random_candidates(rng, counts=(40, 60, 1))
    one = GraspSelector(
        Arm(),
        Cascade.paper(),
        object(),
        solve=no_solutions,
        refresh_limit=0,
    )
    one.use(random_table(rng, candidates, reachable=0.5))
    return one.rank(random_hand(rng), np.zeros(JOINTS))


def panels(figure, ranking):
    return dict(zip(ranking.object_names, figure.axes, strict=False))


def test_each_object_has_a_panel_with_a_line_for_each_candidate_and_a_column_for_each_cost(ranking):
    found = panels(ranking_figure(ranking), ranking)
    counts = {"can": 60, "mug": 40, "box": 1}
    for name, axes in found.items():
        image = axes.images[0].get_array()
        assert image.shape == (counts[name], 3)
        assert name in axes.get_title(loc="left")


def test_admissible_candidates_have_colours_and_filtered_ones_have_none(ranking):
    for name, axes in panels(ranking_figure(ranking), ranking).items():
        rows = [row for row in ranking.rows() if row.object_name == name]
        empty = np.ma.getmaskarray(axes.images[0].get_array()).all(axis=1)
        assert empty.tolist() == [row.rank is None for row in rows]


def test_the_labels_count_the_candidates_of_each_stage_and_filter(ranking):
    for name, axes in panels(ranking_figure(ranking), ranking).items():
        words = [text.get_text() for text in axes.texts]
        reasons = [row.removed_by for row in ranking.rows() if row.object_name == name]
        for reason in set(reasons) - {""}:
            assert f"{reasons.count(reason)}  {reason}" in words
        if ranking.chosen[name] is not None:
            assert any("chosen" in text for text in words)


def test_labels_do_not_lie_on_each_other(ranking):
    for axes in panels(ranking_figure(ranking), ranking).values():
        heights = sorted(text.get_position()[1] for text in axes.texts)
        assert np.all(np.diff(heights) > 0.03)


def test_it_is_saved_as_the_same_bytes_every_time(ranking, tmp_path):
    first = save_figure(ranking_figure(ranking, title="A ranking"), tmp_path / "a.png").read_bytes()
    assert first == save_figure(ranking_figure(ranking, title="A ranking"), tmp_path / "b.png").read_bytes()


def test_an_empty_ranking_is_refused():
    with pytest.raises(InvalidValue, match="no candidates"):
        ranking_figure(Ranking.empty("no candidates were observed"))
