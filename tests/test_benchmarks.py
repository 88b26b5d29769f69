"""The benchmarks run, at a size that says nothing about speed."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def run(module, folder, *arguments):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-m", f"benchmarks.{module}", *arguments, "--output", str(folder)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    name = "hand_sweep" if "--sweep" in arguments else module
    text = (folder / f"{name}.md").read_text()
    assert text.strip() in done.stdout
    assert f"python -m benchmarks.{module} {arguments[0]}" in text
    facts = json.loads((folder / f"{name}.json").read_text())
    assert facts["machine"]["versions"]["numpy"]
    return facts


def test_the_hand_is_followed_within_the_limits_and_every_number_is_there(tmp_path):
    facts = run(
        "hand",
        tmp_path,
        "--robots",
        "ur5",
        "--rates",
        "500",
        "--stretches",
        "2",
        "--samples",
        "40",
        "--fade",
        "0.2",
    )
    (found,) = facts["runs"].values()
    assert found["medians"]["violations"] == 0
    assert found["medians"]["stretches"] == 2
    assert 0.0 <= found["medians"]["lag"] < 100.0
    assert [s["first"] for s in found["stretches"]] == [0, 200]


def test_the_ticks_of_the_servo_are_timed_beside_what_is_installed(tmp_path):
    facts = run("tick", tmp_path, "--robots", "panda", "--seconds", "0.1", "--steady-seconds", "0.1")
    (result,) = facts["results"]
    installed = importlib.util.find_spec("pink") is not None
    assert any(name.startswith("optsc") for name in result["series"])
    assert installed == any(name.startswith("Pink") for name in result["series"])
    assert installed or any(reason.startswith("Pink") for reason in result["missing"])
    for row in result["series"].values():
        assert 0.0 < row["min"] <= row["p50"] <= row["p99.9"]
    assert 0.0 <= facts["steady"]["collector off and heap frozen"]["over 1 ms"] <= 1.0
    assert facts["snapshots"].keys() == {"snapshot", "restore"}
    assert all(median > 0.0 for median in facts["snapshots"].values())


def test_an_arm_is_pressed_against_its_limits_and_its_reach(tmp_path):
    facts = run("press", tmp_path, "--robots", "ur5", "--seconds", "0.2", "--rate", "250")
    (result,) = facts["results"]
    assert "target behind the reach" in result["cases"]
    for arms in result["cases"].values():
        assert arms["optsc"]["greatest jerk of the whole run [%]"] <= 100.0 + 1e-6
        assert all(value >= 0.0 for value in arms["optsc"].values())


def test_the_choice_of_a_resting_hand_is_watched(tmp_path):
    facts = run("stability", tmp_path, "--scenes", "1", "--poses", "1", "--seconds", "0.4")
    assert {row["hand"] for row in facts["rows"]} == {"moving", "simulated", "still"}
    for row in facts["rows"]:
        assert row["steady_runs"] <= row["runs"]
        assert row["zone"] != "none" or row["price"] == [0.0, 0.0, 0.0]


def test_segments_are_judged_by_labels(tmp_path):
    run("segmentation", tmp_path, "--scenes", "1")


@pytest.mark.parametrize("module", ["hand", "tick", "press", "stability", "segmentation", "perception", "grasps"])
def test_every_benchmark_says_how_it_is_used(module):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", f"benchmarks.{module}", "--help"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    assert "--output" in done.stdout
