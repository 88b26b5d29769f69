"""The benchmark of perception runs and says what its numbers say."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_one_scene_gives_every_figure_and_lists_its_failures(tmp_path):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [
        sys.executable,
        "-m",
        "benchmarks.perception",
        "--scenes",
        "1",
        "--seed",
        "7",
        "--objects",
        "can",
        "box",
    ]
    done = subprocess.run(
        [*command, "--output", str(tmp_path)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    facts = json.loads((tmp_path / "perception.json").read_text())
    text = (tmp_path / "perception.md").read_text()
    counted = facts["within 5 mm"]
    assert 1 <= counted["of"] <= 2
    assert counted["good"] == counted["of"] - len(facts["failures"])
    low, high = counted["interval"]
    assert 0.0 < low <= counted["share"] <= high <= 1.0
    assert f"{counted['good']} of {counted['of']}" in text
    column = facts["objects"]["columns"].index("visible")
    assert sum(row[column] >= 0.4 for row in facts["objects"]["objects"]) == counted["of"]
    assert facts["machine"]["versions"]["numpy"]
