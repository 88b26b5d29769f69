"""What docs/avoidance.md says: its formulas, its numbers and its example."""

import re
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from optsc.collision import AvoidanceSettings, CollisionAvoidance
from optsc.collision.avoidance import LEAST_DELAY
from optsc.geometry import Pose, TriangleMesh
from optsc.robot import load_robot

PAGE = (Path(__file__).parents[2] / "docs" / "avoidance.md").read_text()
CORNERS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
CUBE = TriangleMesh(0.04 * CORNERS, [[0, 1, 3]])
OUTSIDE, INSIDE = re.findall(r"allowed\(s\) = (.*?)\s+for s", PAGE)
(BRAKING,) = re.findall(r"^    A = (.*)$", PAGE, re.MULTILINE)


def allowed(s, A):
    settings = AvoidanceSettings()
    names = {"A": A, "T": LEAST_DELAY, "push": settings.push, "s": s, "sqrt": sqrt, "max": max}
    return eval(OUTSIDE if s > 0 else INSIDE, {"__builtins__": {}}, names)


def test_the_numbers_of_the_table_follow_from_the_formulas():
    rows = re.findall(r"^\| (-?[\d.]+) \| (-?[\d.]+) \|$", PAGE, re.MULTILINE)
    assert len(rows) == 7
    for s, speed in rows:
        assert allowed(float(s), 3.0) == pytest.approx(float(speed), abs=5e-5)


def test_the_rows_are_those_of_the_formulas():
    robot, settings = load_robot("panda"), AvoidanceSettings()
    tool = robot.forward(robot.home).translation
    avoid, seen = (
        CollisionAvoidance(robot, {"cube": (CUBE, Pose.from_translation(tool))}, table_height=None),
        0,
    )
    for gap in np.linspace(-0.02, 0.2, 23):
        avoid.move("cube", Pose.from_translation(tool + [0.0, 0.0, -0.06 - gap]))
        rows = avoid.rows(robot.home, np.full(7, -20.0), np.full(7, 20.0))
        for pair, d, g, lower in zip(avoid._near.pair, avoid._near.distance, rows.matrix, rows.lower, strict=True):
            if avoid.model.pairs[pair].other != "cube" or abs(d) < 2e-3:
                continue
            names = {
                "g": g,
                "acceleration": robot.limits.acceleration,
                "abs": np.abs,
                "sum": np.sum,
                "min": min,
            }
            names |= {"braking": settings.braking, "most_braking": settings.most_braking}
            A = eval(BRAKING, {"__builtins__": {}}, names)
            s = d - settings.margin
            if s > 0 or s > -settings.push * LEAST_DELAY:  # beyond, blending may shorten the push
                assert -lower == pytest.approx(allowed(s, A), abs=1e-9)
                seen += 1
    assert seen > 40


def test_the_example_presses_the_table_and_says_so(capsys):
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(compile(block, "docs/avoidance.md", "exec"), {})
    out = capsys.readouterr().out
    assert "mm from table" in out


def test_the_hand_may_touch_what_it_is_allowed_and_nothing_after_none():
    robot = load_robot("panda")
    tool = robot.forward(robot.home).translation
    avoid = CollisionAvoidance(robot, {"cube": (CUBE, Pose.from_translation(tool))})

    def nearest():
        distance, _ = avoid.model.distances(robot.home)
        cube = [pair.other == "cube" for pair in avoid.model.pairs]
        return float(distance[cube].min())

    assert nearest() < 0.0
    avoid.hand_may_touch("cube")
    assert nearest() > 0.0
    avoid.hand_may_touch(None)
    assert nearest() < 0.0
