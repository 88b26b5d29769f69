"""The page on arbitration: its example runs and is short, and its table names every policy."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from optsc.control.approach import Approach
from optsc.control.arbitration import HAND_ALONE, Goal, GraspPose, Moment
from optsc.control.fine_tuning import FineTuning
from optsc.control.policies import POLICIES
from optsc.operators import Button
from optsc.selection.intent import IntentSettings

PAGE = (Path(__file__).parents[2] / "docs" / "arbitration.md").read_text()
(BLOCK,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def test_the_example_of_a_policy_runs_as_shown_and_has_fewer_than_forty_lines(tmp_path):
    assert len([line for line in BLOCK.splitlines() if line.strip()]) < 40
    done = subprocess.run([sys.executable, "-c", BLOCK], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Agreement" in done.stdout


def test_the_example_helps_along_the_hands_way_and_only_there():
    names = {}
    exec(BLOCK.split("robot = ")[0], names)
    goal = Goal("a", 1.0, *[GraspPose((1.0, 0, 0), (1.0, 0, 0, 0), 0)] * 2)
    for hand, alpha in (
        ((0.1, 0, 0), 0.6),
        ((0.1, 0.1, 0), 0.6 / np.sqrt(2)),
        ((-0.1, 0, 0), 0),
        ((0, 0, 0), 0),
    ):
        velocity = np.array([*hand, 0, 0, 0], dtype=float)
        moment = Moment((0, 0, 0), (1, 0, 0, 0), velocity, (goal,), 1.0, HAND_ALONE, 0.002, Approach())
        blend = names["Agreement"]().blend(moment)
        assert blend.share == pytest.approx(alpha)
        np.testing.assert_allclose(blend.robot, [0.1 * alpha, 0, 0, 0, 0, 0], atol=1e-12)


def test_every_policy_and_every_button_is_on_the_page_by_name():
    for name, policy in POLICIES.items():
        assert f"| `{name}` | `{policy.__name__}`" in PAGE
    for button in Button:
        assert f"| `{button.name}` |" in PAGE


def test_the_defaults_on_the_page_are_those_of_the_code():
    tuning, intent = FineTuning(), IntentSettings()
    assert (tuning.scale, tuning.most, tuning.speed) == ((0.3, 0.3), (0.03, 0.35), (0.05, 0.25))
    assert (intent.rationality, intent.leak, intent.cap) == (5.0, 0.01, 0.99)
    assert intent.dead_band == (0.01, 0.1)
    policy = {name: kind() for name, kind in POLICIES.items()}
    linear, fixture = policy["linear blending"], policy["virtual fixture"]
    assert (linear.low, linear.high, linear.most, linear.rate) == (0.4, 0.8, 0.6, 2.0)
    assert (fixture.k_tau, fixture.low, fixture.high, fixture.near) == (0.3, 0.4, 0.8, (0.03, 0.2))
    assert (policy["continuous"].reach, policy["continuous"].most) == (0.3, 0.6)
