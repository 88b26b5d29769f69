"""``optsc study people``: a rehearsal from the plan to the report, and answers to what is wrong."""

import csv
import json
import shutil

import pytest

from optsc.cli import main
from optsc.records import load_inputs

PLAN = ["--conditions", "alternating", "manual", "--participants", "2", "--trials", "1", "--practice", "0"]
SCENES = ["--objects", "1", "--time-limit", "20"]


def people(*arguments):
    return main(["study", "people", *map(str, arguments)])


@pytest.fixture(scope="module")
def rehearsed(tmp_path_factory):
    """Both participants are through, and nothing is rated."""
    study = tmp_path_factory.mktemp("people") / "pilot"
    assert people("plan", study, *PLAN, *SCENES) == 0
    for participant in (1, 2):
        assert people("run", study, "--participant", participant, "--operator", "typical", "--all") == 0
    return study


@pytest.fixture
def study(rehearsed, tmp_path):
    return shutil.copytree(rehearsed, tmp_path / "pilot")


def test_every_trial_leaves_its_run_and_its_measures_by_the_pattern(rehearsed):
    for participant in (1, 2):
        for number, condition in enumerate(("alternating", "manual"), start=1):
            name = f"subject_{participant:02d}_cond_{number:02d}_run_01"
            row = json.loads((rehearsed / f"{name}_measures.json").read_text())
            assert (row["condition"], row["operator"], row["success"]) == (condition, "typical", True)
            about = load_inputs(rehearsed / f"{name}_run.npz").about
            assert (about["policy"], about["goal"]) == (condition, row["goal"])


def test_a_sitting_goes_on_condition_by_condition_and_a_half_written_trial_is_done_again(study, capsys):
    names = [f"subject_02_cond_0{number}_run_01_measures.json" for number in (2, 1)]
    before = [(study / name).read_bytes() for name in names]
    for name in names:
        (study / name).unlink()
    (study / "subject_02_cond_02_run_01_run.npz").write_bytes(b"half a file")
    run = ("run", study, "--participant", 2, "--operator", "typical")
    assert people(*run) == 0
    assert "trials left: 1" in capsys.readouterr().out
    assert (study / names[0]).exists()
    assert not (study / names[1]).exists()
    assert people(*run) == 0
    assert [(study / name).read_bytes() for name in names] == before
    load_inputs(study / "subject_02_cond_02_run_01_run.npz")


def test_a_finished_sitting_says_so_and_changes_nothing(study, capsys):
    before = {path: path.read_bytes() for path in study.iterdir()}
    assert people("run", study, "--participant", 1, "--operator", "typical") == 0
    said = capsys.readouterr().out
    assert "all trials are done" in said
    assert "--participant 1 --condition manual" in said
    assert {path: path.read_bytes() for path in study.iterdir()} == before


def test_answers_are_given_on_the_command_line_or_asked_for(study, capsys, monkeypatch):
    rate = ("rate", study, "--participant", 1, "--condition")
    assert people(*rate, "manual", "--answers", 40, 20, 30, 10, 35, 15) == 0
    assert "raw NASA-TLX 25.0" in capsys.readouterr().out
    answers = iter(["1", "two", "2", "3", "4", "5", "9"])
    monkeypatch.setattr("builtins.input", lambda question: next(answers))
    assert people(*rate, "alternating") == 0
    assert (study / "subject_01_cond_01_tlx.csv").read_text().splitlines()[1] == "1,2,3,4,5,9,4"
    assert people("status", study) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "participant 1: 2 of 2 trials; all trials are done" in lines
    assert "not rated yet: manual, alternating" in lines[-1]


def test_answers_are_not_overwritten_by_mistake(study, capsys):
    rate = ("rate", study, "--participant", 1, "--condition", "manual", "--answers")
    assert people(*rate, 0, 0, 0, 0, 0, 0) == 0
    assert people(*rate, 1, 1, 1, 1, 1, 1) == 1
    assert "--replace" in capsys.readouterr().err
    assert people(*rate, 1, 1, 1, 1, 1, 1, "--replace") == 0
    assert (study / "subject_01_cond_02_tlx.csv").read_text().splitlines()[1] == "1,1,1,1,1,1,1"


def test_without_a_terminal_to_ask_at_the_answers_are_asked_on_the_command_line(study, capsys, monkeypatch):
    def nobody(question):
        raise EOFError

    monkeypatch.setattr("builtins.input", nobody)
    assert people("rate", study, "--participant", 1, "--condition", "manual") == 1
    assert "--answers" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("answers", "answer"),
    [
        ((1, 2, 3, 4, 5), "six numbers"),
        ((1, 2, 3, 4, 5, "ten"), "frustration"),
        ((1, 2, 3, 4, 500, 6), "effort"),
        (("nan", 2, 3, 4, 5, 6), "mental"),
    ],
)
def test_answers_that_are_none_are_refused(study, capsys, answers, answer):
    assert people("rate", study, "--participant", 1, "--condition", "manual", "--answers", *answers) == 1
    assert answer in capsys.readouterr().err
    assert not (study / "subject_01_cond_02_tlx.csv").exists()


def test_the_report_has_tables_differences_and_a_page(study, capsys):
    people("rate", study, "--participant", 1, "--condition", "manual", "--answers", 40, 20, 30, 10, 35, 15)
    people("rate", study, "--participant", 1, "--condition", "alternating", "--answers", 0, 0, 0, 0, 0, 0)
    assert people("report", study) == 0
    report = study / "report"
    with (report / "trials.csv").open() as file:
        trials = list(csv.DictReader(file))
    assert len(trials) == 4
    assert {row["tlx_raw"] for row in trials if row["participant"] == "1"} == {"25.0", "0.0"}
    with (report / "differences.csv").open() as file:
        found = {row["measure"]: row for row in csv.DictReader(file)}
    assert found["grasp_s"]["participants"] == "2"
    assert (found["tlx_raw"]["participants"], found["tlx_raw"]["mean"]) == ("1", "25.0")
    assert {path.name for path in report.glob("*.parquet")} == {
        *("trials.parquet", "participants.parquet", "differences.parquet")
    }
    page = (report / "report.html").read_text()
    assert "Differences within participants" in page
    assert "minus alternating" in page
    assert json.loads((report / "summary.json").read_text())["operators"] == {"typical": 4}
    said = capsys.readouterr().out
    assert "manual minus alternating, tlx_raw: +25" in said


def test_a_report_on_practice_alone_says_so(tmp_path):
    study = tmp_path / "new"
    assert people("plan", study, *PLAN, *SCENES, "--practice", 1, "--time-limit", 0.5) == 0
    assert people("run", study, "--participant", 2, "--operator", "typical", "--trials", 1) == 0
    assert people("report", study) == 0
    assert "only practice" in (study / "report" / "report.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "answer"),
    [
        (("run", "STUDY", "--participant", 3, "--operator", "typical"), "1 to 2"),
        (("run", "STUDY", "--participant", 1, "--operator", "sleepy"), "mind-changing"),
        (("run", "STUDY", "--participant", 1, "--operator", "hasty"), "typical, as in subject_01"),
        (("run", "STUDY", "--participant", 1, "--operator", "typical", "--trials", 0), "1 or more"),
        (("run", "nowhere", "--participant", 1, "--operator", "typical"), "optsc study people plan"),
        (("rate", "STUDY", "--participant", 1, "--condition", "other"), "alternating, manual"),
        (("report", "STUDY", "--reference", "other"), "alternating, manual"),
        (("report", "STUDY", "--seed", -1), "0 or more"),
        (("plan", "STUDY", *PLAN, "--objects", 2), "another folder"),
        (("plan", "new", "--conditions", "telepathy", "--participants", 1), "hindsight"),
        (("plan", "new", "--conditions", "manual", "--participants", 0), "1 to"),
        (("plan", "new", "--conditions", "manual", "--participants", 1, "--time-limit", 0), "time_limit"),
    ],
)
def test_a_wrong_word_is_answered_with_what_would_be_right(study, arguments, answer, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert people(*(study if word == "STUDY" else word for word in arguments)) == 1
    assert answer in capsys.readouterr().err


def test_a_window_needs_a_display_and_the_simulated_world(study, capsys, monkeypatch):
    (study / "subject_01_cond_01_run_01_measures.json").unlink()
    for display, answer in ((None, "display"), (":0", "pybullet")):
        if display is None:
            monkeypatch.delenv("DISPLAY", raising=False)
        else:
            monkeypatch.setenv("DISPLAY", display)
        assert people("run", study, "--participant", 1, "--operator", "typical", "--gui") == 1
        assert answer in capsys.readouterr().err


@pytest.mark.parametrize("action", [("run", "--operator", "typical"), ("rate", "--condition", "manual")])
def test_a_damaged_file_is_named_with_what_to_do_about_it(study, capsys, action):
    (study / "subject_01_cond_01_run_01_measures.json").write_text('{"participant": 1')
    assert people(action[0], study, "--participant", 1, *action[1:]) == 1
    said = capsys.readouterr().err
    assert "subject_01_cond_01_run_01_measures.json" in said
    assert "done again" in said


def test_measures_of_another_trial_and_answers_that_are_none_are_refused(study, capsys):
    first, second = (study / f"subject_0{k}_cond_01_run_01_measures.json" for k in (1, 2))
    kept = first.read_bytes()
    first.write_bytes(second.read_bytes())
    assert people("status", study) == 1
    assert "another trial" in capsys.readouterr().err
    first.write_bytes(kept)
    (study / "subject_01_cond_01_tlx.csv").write_text("mental,physical\n1,2\n")
    assert people("report", study) == 1
    assert "rate it again" in capsys.readouterr().err


def test_the_help_shows_the_way_from_the_plan_to_the_report(capsys):
    with pytest.raises(SystemExit) as stop:
        people("--help")
    assert stop.value.code == 0
    said = capsys.readouterr().out
    places = [said.index(f"optsc study people {step}") for step in ("plan", "run", "rate", "report")]
    assert places == sorted(places)


@pytest.mark.parametrize("step", ["plan", "run", "rate", "status", "report"])
def test_every_step_shows_an_example(step, capsys):
    with pytest.raises(SystemExit) as stop:
        people(step, "--help")
    assert stop.value.code == 0
    assert f"example: optsc study people {step}" in " ".join(capsys.readouterr().out.split())
