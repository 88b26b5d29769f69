"""Designs of sweeps: which settings are tried, and what they stand for."""

import numpy as np
import pytest

from optsc.errors import InvalidValue, UnknownName
from optsc.selection import Cascade, WeightedSum
from optsc.study.sweep.designs import design, grid, one_at_a_time, random, simplex, sobol
from optsc.study.sweep.space import COSTS, Dimension, conditions, rule_of

WEIGHTS = [Dimension(f"weight.{name}") for name in ("orientation", "position", "manipulability")]


def test_a_grid_has_every_combination_once():
    points = grid(
        [
            Dimension("keep.orientation", 10, 50, "integer"),
            Dimension("measure", values=("yoshikawa", "simox")),
        ],
        3,
    )
    assert len(points) == 6
    assert {p["keep.orientation"] for p in points} == {10, 30, 50}
    assert len({tuple(p.values()) for p in points}) == 6


def test_a_simplex_adds_up_to_one_and_has_its_corners():
    points = simplex(WEIGHTS, 4)
    assert len(points) == 15
    assert all(sum(p.values()) == pytest.approx(1.0) for p in points)
    assert sum(max(p.values()) == 1.0 for p in points) == 3
    with pytest.raises(InvalidValue, match="2 or more"):
        simplex(WEIGHTS[:1], 4)


def test_sobol_points_fill_every_half_of_every_dimension_evenly():
    points = sobol(WEIGHTS, 64, seed=3)
    x = np.array([list(p.values()) for p in points])
    assert np.array_equal((x < 0.5).sum(axis=0), [32, 32, 32])
    quadrants = (x[:, 0] < 0.5).astype(int) + 2 * (x[:, 1] < 0.5)
    assert np.bincount(quadrants).tolist() == [16, 16, 16, 16]
    assert points == sobol(WEIGHTS, 64, seed=3) != sobol(WEIGHTS, 64, seed=4)
    assert len(sobol(WEIGHTS, 50, seed=0)) == 50


def test_random_points_follow_their_seed_and_stay_in_range():
    dimensions = [Dimension("dof.length", 0.05, 0.5, "log"), Dimension("keep.position", 2, 9, "integer")]
    points = random(dimensions, 200, 1)
    assert points == random(dimensions, 200, 1) != random(dimensions, 200, 2)
    assert all(0.05 <= p["dof.length"] <= 0.5 for p in points)
    assert {p["keep.position"] for p in points} == set(range(2, 10))
    # Half of a log range lies below its geometric middle.
    assert 70 <= sum(p["dof.length"] < np.sqrt(0.05 * 0.5) for p in points) <= 130


def test_one_at_a_time_changes_one_thing_at_a_time():
    base = {"weight.orientation": 0.5, "weight.position": 0.5, "weight.manipulability": 0.5}
    points = one_at_a_time(WEIGHTS, 3, base)
    assert points[0] == base
    assert all(sum(p[n] != base[n] for n in base) == 1 for p in points[1:])
    assert len(points) == 1 + 3 * 2
    with pytest.raises(InvalidValue, match="a value of"):
        one_at_a_time(WEIGHTS, 3, {})


def test_dimensions_are_read_as_they_are_written():
    assert Dimension.parse("weight.pose=0:2") == Dimension("weight.pose", 0.0, 2.0)
    assert Dimension.parse("dof.rz=0.1:10:log").kind == "log"
    assert Dimension.parse("measure=yoshikawa,simox").values == ("yoshikawa", "simox")
    for wrong, answer in (
        ("weight.charm=0:1", "weight.pose"),
        ("dof.x=1:0", "lower end"),
        ("dof.x=a:b", "numbers"),
    ):
        with pytest.raises((UnknownName, InvalidValue), match=answer):
            Dimension.parse(wrong)
    with pytest.raises(UnknownName, match="sobol"):
        design("spiral", WEIGHTS, count=1, levels=1, seed=0)


def test_a_point_stands_for_its_rule():
    assert rule_of({"keep.orientation": 40, "keep.position": 5}) == Cascade.paper(40, 5)
    assert rule_of({}) == Cascade.paper()
    rule = rule_of({"weight.orientation": 1.0, "weight.pose": 0.5, "dof.z": 0.0, "dof.length": 0.2})
    assert isinstance(rule, WeightedSum)
    named = {cost.name: (cost, weight) for cost, weight in rule.terms}
    assert named["orientation"][1] == pytest.approx(1.0 / 0.5)
    assert named["pose"][0].position == (1.0, 1.0, 0.0)
    assert named["pose"][0].length == 0.2
    assert rule_of({"keep.pose": 12, "dof.rz": 0.3}).steps[0].keep == 12
    assert {"orientation", "position", "manipulability", "pose"} <= set(COSTS)


def test_settings_that_rank_nothing_are_left_out():
    points = [{"weight.position": 0.0}, {"weight.position": 1.0, "measure": "simox"}]
    (condition,) = conditions(points)
    assert (condition.name, condition.measure) == ("00001", "simox")
    assert condition.about == points[1]
