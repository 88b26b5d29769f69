"""What a sweep may vary: every dimension does something, every weight counts alike, every value can be had."""

import shlex
from pathlib import Path

import pytest

from optsc.cli import main
from optsc.errors import InvalidValue, UnknownName
from optsc.study.sweep.designs import design, one_at_a_time, simplex
from optsc.study.sweep.space import COSTS, SCALES, Dimension, conditions, rule_of

DOCUMENTS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize(
    ("point", "idle", "answer"),
    [
        ({"weight.position": 1.0, "keep.orientation": 5}, "keep.orientation", "without weight.COST"),
        ({"weight.pose": 1.0, "keep.pose": 5}, "keep.pose", "without weight.COST"),
        ({"weight.position": 1.0, "dof.z": 0.5}, "dof.z", "weight.pose or keep.pose"),
        ({"dof.length": 0.2}, "dof.length", "weight.pose or keep.pose"),
        ({"keep.pose": 8, "keep.position": 3}, "keep.position", "without keep.pose"),
    ],
)
def test_a_dimension_that_would_do_nothing_is_refused_with_what_would_use_it(point, idle, answer):
    with pytest.raises(InvalidValue, match=answer) as error:
        rule_of(point)
    assert idle in str(error.value)
    rule_of({name: value for name, value in point.items() if name != idle})


def test_a_weight_of_zero_is_still_looked_at():
    found = conditions([{"weight.pose": w, "weight.position": 1.0, "dof.z": 0.5} for w in (0.0, 1.0)])
    assert len({c.key for c in found}) == 2
    assert rule_of({"keep.pose": 4, "dof.z": 0.5}) != rule_of({"keep.pose": 4})


def test_every_cost_has_the_scale_that_makes_a_weight_of_it_count():
    assert set(SCALES) == set(COSTS)
    for name in COSTS:
        ((_, weight),) = rule_of({f"weight.{name}": 2.0}).terms
        assert weight == pytest.approx(2.0 / SCALES[name])


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("measure=yoshikawa,beauty", "simox"),
        ("measure=0:1", "names"),
        ("weight.pose=-1:1", "0 or more"),
        ("weight.pose=0.5,-0.1", "0 or more"),
        ("weight.pose=much", "0 or more"),
        ("dof.x=-1:1", "0 or more"),
        ("dof.x=nan:1", "finite"),
        ("dof.x=0,inf", "finite"),
        ("keep.position=1:30", "integer"),
        ("keep.position=0:30:integer", "1 or more"),
        ("keep.position=1.5:30:integer", "whole"),
        ("keep.pose=3,4.5", "whole"),
    ],
)
def test_what_a_dimension_cannot_be_is_said_before_anything_is_tried(text, answer):
    with pytest.raises((InvalidValue, UnknownName), match=answer):
        Dimension.parse(text)


def test_points_are_checked_as_dimensions_are():
    for point, answer in (({"keep.orientation": 2.5}, "whole"), ({"weight.pose": -1.0}, "0 or more")):
        with pytest.raises(InvalidValue, match=answer):
            rule_of(point)
    assert rule_of({"keep.orientation": 40.0}) == rule_of({"keep.orientation": 40})


def test_a_simplex_of_weights_is_crossed_with_everything_else():
    weights = [Dimension("weight.pose"), Dimension("weight.manipulability")]
    others = [Dimension("measure", values=("yoshikawa", "simox")), Dimension("dof.z", 0.0, 1.0)]
    points = simplex([weights[0], others[0], weights[1], others[1]], 4)
    assert len(points) == 5 * 2 * 4
    assert len({tuple(point.values()) for point in points}) == len(points)
    assert all(p["weight.pose"] + p["weight.manipulability"] == pytest.approx(1.0) for p in points)
    assert {p["measure"] for p in points} == {"yoshikawa", "simox"}
    assert sorted({p["dof.z"] for p in points}) == pytest.approx([0.0, 1 / 3, 2 / 3, 1.0])
    assert list(points[0]) == ["weight.pose", "measure", "weight.manipulability", "dof.z"]
    with pytest.raises(InvalidValue, match="2 or more"):
        simplex([weights[0], *others], 4)
    with pytest.raises(InvalidValue, match="which it fills"):
        simplex([weights[0], Dimension("weight.position", 0.2, 0.5)], 4)


def test_a_dimension_that_comes_twice_is_refused():
    twice = [Dimension("weight.pose"), Dimension("weight.pose")]
    with pytest.raises(InvalidValue, match="each once"):
        design("grid", twice, count=1, levels=2, seed=0)


def test_the_command_line_says_which_dimension_does_nothing(capsys, tmp_path):
    varied = ["--vary", "weight.position=0:1", "keep.position=1:9:integer", "--output", str(tmp_path)]
    assert main(["sweep", "--design", "grid", *varied]) == 1
    assert "keep.position" in capsys.readouterr().err


def documented():
    """Return the words of every sweep that the study's page shows."""
    lines = (DOCUMENTS / "study.md").read_text(encoding="utf-8").splitlines()
    return [shlex.split(line) for line in lines if line.startswith("    optsc sweep") and "--vary" in line]


@pytest.mark.parametrize("words", documented(), ids=" ".join)
def test_sweeps_in_the_documentation_try_nothing_in_vain(words):
    varied = words[words.index("--vary") + 1 :]
    varied = varied[: next((i for i, word in enumerate(varied) if word.startswith("--")), len(varied))]
    dimensions = [Dimension.parse(text) for text in varied]
    name = words[words.index("--design") + 1] if "--design" in words else "random"
    points = design(name, dimensions, count=8, levels=3, seed=0)
    if name == "one-at-a-time":
        assert points == one_at_a_time(dimensions, 3, {d.name: d.at(0.5) for d in dimensions})
    nothing = [p for p in points if "weight" in str(p) and not any(p[n] for n in p if "weight" in n)]
    assert len(conditions(points)) == len(points) - len(nothing) > 0
