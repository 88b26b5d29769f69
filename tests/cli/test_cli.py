"""The command line: help with an example, clear errors, exit codes."""

import pytest

from optsc.cli import main


@pytest.mark.parametrize("command", ["demo", "doctor", "grasps"])
def test_every_command_has_a_help_that_shows_an_example(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    assert f"example: optsc {command}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "answer"),
    [
        (["demo", "--robot", "pandora"], "panda"),
        (["demo", "--objects", "elephant"], "mug"),
        (["demo", "--seed", "-1"], "0 or more"),
        (["demo", "--rate", "-5"], "rate"),
        (["grasps", "build", "--gripper", "tongs"], "panda_hand"),
    ],
)
def test_a_wrong_word_is_answered_with_what_would_be_right(arguments, answer, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    assert answer in capsys.readouterr().err


def test_a_window_without_a_display_is_refused(capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    assert main(["demo", "--gui"]) == 1
    assert "display" in capsys.readouterr().err


def test_the_doctor_names_solvers_and_the_compiler(capsys, monkeypatch):
    assert main(["doctor"]) == 0
    assert "daqp" in capsys.readouterr().out
    monkeypatch.setenv("OPTSC_COMPILER", "none")
    assert main(["doctor"]) == 0
    assert "compiler: none" in capsys.readouterr().out


def test_grasps_are_built_shown_and_kept(capsys, tmp_path):
    folder = str(tmp_path / "grasps")
    assert main(["grasps", "build", "--objects", "can", "--output", folder]) == 0
    assert main(["grasps", "show", folder]) == 0
    assert "can: 150 grasps for panda_hand" in capsys.readouterr().out


def test_a_folder_without_grasps_is_an_error(capsys, tmp_path):
    assert main(["grasps", "show", str(tmp_path / "nowhere")]) == 1
    assert "nowhere" in capsys.readouterr().err


def test_the_doctor_prints_what_compiling_changes(capsys, monkeypatch):
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    if "compiler: none" not in said:
        lines = [line for line in said.splitlines() if "results differ by" in line]
        assert [float(line.split("differ by ")[1].split()[0]) <= 1e-9 for line in lines] == [True] * 5
        assert all(" times; " in line for line in lines)
    monkeypatch.setenv("OPTSC_COMPILER", "none")
    assert main(["doctor", "--robot", "ur5"]) == 0
    assert "kernels of the ur5: interpreted" in capsys.readouterr().out
