"""``optsc grasps``: build, show, validate and import, with what they leave behind for machines."""

import json

import pytest

from optsc.cli import main


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "grasps"
    assert main(["grasps", "build", "--objects", "can", "--count", "4", "--output", str(path)]) == 0
    return path


def summary(folder):
    return json.loads((folder / "summary.json").read_text())


def test_building_leaves_a_summary(folder):
    about = summary(folder)["objects"]["can"]
    assert (about["grasps"], about["gripper"]) == (4, "panda_hand")
    assert about["provenance"]["seed"] == 0


def test_validating_stores_the_outcome_and_its_exit_code_says_whether_enough_held(folder, capsys):
    assert main(["grasps", "validate", str(folder), "--workers", "1", "--least", "0.5"]) == 0
    assert summary(folder)["objects"]["can"]["tried"] == 4
    assert main(["grasps", "show", str(folder)]) == 0
    assert "of 4 tried held" in capsys.readouterr().out


def test_showing_draws_the_grasps(folder, tmp_path):
    assert main(["grasps", "show", str(folder), "--output", str(tmp_path / "pictures")]) == 0
    assert (tmp_path / "pictures" / "can.png").read_bytes().startswith(b"\x89PNG")
    assert summary(tmp_path / "pictures")["pictures"] == [str(tmp_path / "pictures" / "can.png")]


def test_a_table_of_poses_is_imported_beside_what_is_there(folder, tmp_path):
    table = tmp_path / "poses.csv"
    table.write_text("x,y,z,qw,qx,qy,qz\n0,0,0.1,0,1,0,0\n")
    assert main(["grasps", "import", str(table), "--name", "vase", "--output", str(folder)]) == 0
    assert main(["grasps", "show", str(folder), "--objects", "vase"]) == 0
    assert main(["grasps", "show", str(folder), "--objects", "lamp"]) == 1


@pytest.mark.parametrize("action", ["build", "show", "validate", "import"])
def test_every_action_shows_an_example(action, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["grasps", action, "--help"])
    assert stop.value.code == 0
    assert f"example: optsc grasps {action}" in capsys.readouterr().out


def test_a_table_in_millimetres_is_suspected(tmp_path, capsys):
    table = tmp_path / "poses.csv"
    table.write_text("x,y,z,qw,qx,qy,qz\n0,0,100,0,1,0,0\n")
    assert main(["grasps", "import", str(table), "--name", "vase", "--output", str(tmp_path)]) == 1
    assert "millimetres" in capsys.readouterr().err


def test_an_impossible_share_is_refused(folder, capsys):
    assert main(["grasps", "validate", str(folder), "--least", "2"]) == 1
    assert "--least" in capsys.readouterr().err
