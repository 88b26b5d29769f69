"""The benchmarks of inverse kinematics and ranking run, at a size that says nothing about speed."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import ik_success, ranking
from optsc.robot import load_robot
from optsc.selection import GraspCost

ROOT = Path(__file__).parents[1]


def run(module, folder, *arguments):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-m", f"benchmarks.{module}", *arguments, "--output", str(folder)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    text = (folder / f"{module}.md").read_text()
    assert text.strip() in done.stdout
    assert f"python -m benchmarks.{module} {arguments[0]}" in text
    facts = json.loads((folder / "summary.json").read_text())
    assert facts["machine"]["versions"]["numpy"]
    return facts


def test_poses_are_solved_beside_trac_ik_where_it_is_installed(tmp_path):
    facts = run("ik_success", tmp_path, "--robots", "panda", "--count", "60")
    (result,) = facts["results"]
    assert result["optsc"]["solved"] == result["optsc"]["claimed"] == 60
    low, high = result["optsc"]["success 95 % [%]"]
    assert 90.0 < low < high == 100.0
    installed = importlib.util.find_spec("pytracik") is not None
    assert installed == ("TRAC-IK" in result) == (result["missing"] is None)
    assert "TRAC-IK, published" in (tmp_path / "ik_success.md").read_text()


def test_table_and_ranking_are_timed_and_their_growth_is_drawn(tmp_path):
    sizes = ["--rounds", "1", "--ticks", "12", "--largest", "30"]
    facts = run("ranking", tmp_path, "--robot", "panda", "--objects", "box", *sizes)
    assert [result["twins"] for result in facts["reach"]] == [False, True]
    assert facts["reach"][1]["rows"] == 2 * facts["reach"][0]["rows"]
    for result in facts["reach"]:
        found = result["solved"]
        assert 0 < found["from the present configuration only"] <= found["with 32 restarts"] <= result["rows"]
    assert [row["candidates"] for row in facts["growth"]] == [10, 30]
    assert {"paper's cascade", "all costs"} <= set(facts["rank"])
    assert (tmp_path / "ranking.png").stat().st_size > 10000


def test_all_costs_are_all_that_selection_exports():
    costs, others = ranking.all_costs()
    assert all(isinstance(cost, GraspCost) for cost in costs)
    assert {"orientation", "position", "pose"} <= {cost.name for cost in costs}
    assert not set(others) & {type(cost).__name__ for cost in costs}


def test_a_configuration_beyond_a_limit_or_off_its_pose_is_not_counted_as_solved():
    robot = load_robot("panda")
    q = robot.random_configuration(np.random.default_rng(0), (4,))
    X_WT = robot.forward(q)
    given = q.copy()
    given[1, 0] += 1e-3
    given[2] += 2 * np.pi
    claimed = np.array([True, True, True, False])
    answer = ik_success.Answer(given, claimed, np.zeros(4))
    assert ik_success.solved(robot, X_WT, answer).tolist() == [True, False, False, False]


@pytest.mark.parametrize(
    ("wins", "low", "high"), [(10000, 0.99962, 1.0), (9988, 0.99790, 0.99931), (5, 0.00021, 0.00117)]
)
def test_the_interval_of_a_share_is_wilsons(wins, low, high):

    found = ik_success.wilson(wins, 10000)
    z, share = 1.959964, wins / 10000
    for bound in found:
        # Wilson's bounds are where the share is z standard errors of the bound away from it.
        assert abs(share - bound) == pytest.approx(z * np.sqrt(bound * (1 - bound) / 10000), abs=1e-9)
    np.testing.assert_allclose(found, (low, high), atol=2e-5)


def test_the_bootstrap_covers_the_mean_and_the_ratio():
    rng = np.random.default_rng(1)
    times = {"optsc": rng.exponential(10.0, 4000), "TRAC-IK": rng.exponential(200.0, 4000)}
    intervals = ik_success.bootstrap(times, rng)
    assert intervals["optsc"][0] < 10.0 < intervals["optsc"][1]
    assert intervals["ratio"][0] < 0.05 < intervals["ratio"][1] < 0.06


@pytest.mark.parametrize("module", ["ik_success", "ranking"])
def test_the_benchmark_says_how_it_is_used(module):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", f"benchmarks.{module}", "--help"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    assert "--output" in done.stdout
    assert "example: python -m benchmarks" in done.stdout
