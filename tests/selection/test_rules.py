from __future__ import annotations

import pytest

from optsc.errors import InvalidValue
from optsc.selection import Cascade, Lexicographic, PositionDistance, QualityLoss, Stage, WeightedSum


@pytest.mark.parametrize(
    "make",
    [
        lambda: Cascade(()),
        lambda: Cascade((Stage(PositionDistance(), 2),)),
        lambda: Stage(PositionDistance(), 0),
        lambda: WeightedSum(((PositionDistance(), -1.0),)),
        lambda: WeightedSum(((PositionDistance(), float("nan")),)),
        lambda: WeightedSum(((PositionDistance(), 0.0),)),
        lambda: Lexicographic(()),
        lambda: Lexicographic(((PositionDistance(), 0.0),)),
    ],
)
def test_a_rule_that_cannot_rank_is_refused(make):
    with pytest.raises(InvalidValue):
        make()


def test_rules_name_their_stages_and_costs():
    assert Cascade.paper().stages == ("orientation stage", "position stage", "manipulability stage")
    assert Cascade.manipulability_only().stages == ("manipulability stage",)
    rule = WeightedSum(((PositionDistance(), 1.0), (QualityLoss(), 0.0)))
    assert [cost.name for cost in rule.costs] == ["position"]


def test_rules_are_values():
    assert Cascade.paper() == Cascade.paper(30, 6)
    assert Cascade.paper() != Cascade.paper(30, 5)
    assert hash(Cascade.paper()) == hash(Cascade.paper())
