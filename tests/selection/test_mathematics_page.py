"""The formulas of the page on mathematics are those of the library."""

import re
from pathlib import Path

import numpy as np
import pytest

from optsc.collision.clearance import HORIZON
from optsc.kernels.newton import DAMPING, FLOOR
from optsc.kernels.rollout import END_TOLERANCE, STEP_TOLERANCE, STEPS
from optsc.robot import load_robot
from optsc.robot.manipulability import DEFINITIONS, Manipulability
from optsc.robot.rollout import STEP_TIME
from optsc.selection.reach_columns import TO_GRASP, TO_PREGRASP, WORST_SPEED

PAGE = Path(__file__).parents[2] / "docs" / "mathematics.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_every_block_of_the_page_runs_as_shown(block, capsys):
    exec(compile(block, str(PAGE), "exec"), {})
    assert capsys.readouterr().out.strip()


def test_the_page_shows_the_numbers_that_are_used():
    text = PAGE.read_text()
    assert f"cut off at a horizon\nof {HORIZON} m" in text
    assert f"at most {STEP_TIME} s at the speed" in text
    assert f"N is at most {STEPS}" in text
    assert f"`λ = {DAMPING} eᵀ W e + 10⁻¹⁰`" in text
    assert pytest.approx(1e-10) == FLOOR
    assert (STEP_TOLERANCE, END_TOLERANCE) == (1e-3, 1e-5)
    assert "below 10⁻³ (10⁻⁵ at the end)" in text
    assert WORST_SPEED == 2.0
    assert "; 2 where the path cannot be completed" in text
    assert (TO_PREGRASP, TO_GRASP) == (6, 2)


def test_the_finite_form_of_the_weight_is_that_of_the_slope():
    lower, upper = -1.2, 2.5
    q = np.linspace(lower + 0.01, upper - 0.01, 50)
    width, x = upper - lower, (2 * q - upper - lower) / (upper - lower)
    slope = width**2 * np.abs(2 * q - upper - lower) / (4 * (upper - q) ** 2 * (q - lower) ** 2)
    c = (1 - x**2) ** 2
    np.testing.assert_allclose(c / (c + 4 * np.abs(x) / width), 1 / (1 + slope), rtol=1e-12)


def test_every_named_definition_is_one_that_can_be_told_apart():
    robot = load_robot("ur5")
    assert len(set(DEFINITIONS.values())) == len(DEFINITIONS)
    assert DEFINITIONS["yoshikawa-tsai"] == Manipulability()
    values = [definition.evaluate(robot, robot.home) for definition in DEFINITIONS.values()]
    assert len(set(np.round(values, 12))) == len(values)
