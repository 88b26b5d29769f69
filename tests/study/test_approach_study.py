"""The studies: what they compare, what they list as failed, what they write."""

import json

import numpy as np
import pytest

from optsc.cli import main
from optsc.errors import InvalidValue, UnknownName
from optsc.robot.manipulability import DEFINITIONS
from optsc.study.approach import CLAIMS, approach_conditions, compare, explanation, failures, pairs_of
from optsc.study.conditions import OperatorSpec
from optsc.study.episode_setup import EpisodeSettings
from optsc.study.outcomes import CHOSEN, JUMPS, MEASURED
from optsc.study.scenes import random_scene
from optsc.study.stability import stability


def row(condition, scene, **changes):
    numbers = dict.fromkeys((*MEASURED, *CHOSEN, *JUMPS), 1.0)
    words = {
        "robot": "panda",
        "measure": "yoshikawa",
        "scene": scene,
        "condition": condition,
        "person": "typical",
    }
    facts = {
        "person_seed": 0,
        "arrived": True,
        "success": True,
        "object": "can",
        "candidate": 1,
        "half_turn": False,
        "target_place": 0,
    }
    more = {"hand_over": 0, "ended": "arrived", "scene_seed": 1, "level": "random", "goal": "can", "grasp": 1}
    return {**words, **facts, **more, **numbers, **changes}


def both(scene, paper, other):
    return [row("paper", scene, **paper), row("manipulability", scene, candidate=2, **other)]


def test_differences_are_taken_case_by_case_over_complete_pairs():
    rows = both("a", {"path_length_m": 0.2}, {"path_length_m": 0.3})
    rows += both("b", {"path_length_m": 0.3}, {"path_length_m": 0.6})
    rows += both("c", {"path_length_m": np.nan, "arrived": False, "success": False}, {"path_length_m": 0.1})
    (found,) = compare(rows)
    assert found.cases == (3, 2, 0)
    assert found.scenes == (3, 2)
    difference = found.differences["path_length_m"]
    assert difference.pairs == 2
    assert difference.mean.value == pytest.approx(-0.2)
    assert difference.relative == pytest.approx(-0.2 / 0.45)
    assert found.arrived["paper"][0] == pytest.approx(2 / 3)
    assert len(pairs_of(rows, "panda", "simox")) == 0


def test_every_part_of_the_claim_that_fails_is_listed_with_its_reason():
    near, far = {"jump_target_distance_m": 0.1}, {"jump_target_distance_m": 0.2}
    turned, level = {"jump_target_chord": 0.9}, {"jump_target_chord": 0.2}
    rows = both("fine", {"path_length_m": 0.5}, {})
    rows += both("detour", {"path_length_m": 1.2, **far, **level}, {**near, **turned})
    rows += both("over the pre-grasp", {"path_length_m": 1.1, **near}, far)
    rows += both("slow", {"duration_s": 2.0}, {})
    rows += both("rough", {"ldlj_tool": 0.0}, {})
    rows += both("lost", {"arrived": False, "success": False, "ended": "fault"}, {})
    found = {failure.pair.paper["scene"]: failure for failure in failures(rows)}
    assert set(found) == {"detour", "over the pre-grasp", "slow", "rough", "lost"}
    assert list(found)[:2] == ["detour", "over the pre-grasp"]
    assert "orientation came first" in found["detour"].why
    assert "pre-grasp" in found["over the pre-grasp"].why
    assert found["slow"].parts == {"quicker": pytest.approx(1.0)}
    assert "starts and stops" in found["rough"].why
    assert "fault" in found["lost"].why
    flat = found["detour"].row()
    assert (flat["paper_path_length_m"], flat["other_jump_target_chord"]) == (1.2, 0.9)


def test_people_in_one_scene_are_one_case_and_not_many():
    seeds = (0, 1, 2, 3)
    lengths = {"a": (0.2, 0.3), "b": (0.3, 0.6)}
    once = [r for name, (x, y) in lengths.items() for r in both(name, {"path_length_m": x}, {"path_length_m": y})]
    often = [{**r, "person_seed": k, "path_length_m": r["path_length_m"] + 0.01 * k} for k in seeds for r in once]
    # One of the four does not get there: the scene goes on with the mean of the others.
    often[0].update(arrived=False, success=False, path_length_m=np.nan)
    (one,), (four,) = compare(once), compare(often)
    assert four.cases == (8, 7, 0)
    assert (four.scenes, one.scenes) == ((2, 2), (2, 2))
    found, wanted = four.differences["path_length_m"], one.differences["path_length_m"]
    assert found.pairs == wanted.pairs == 2
    assert found.mean == pytest.approx(wanted.mean)
    assert four.arrived["paper"][0] == pytest.approx((0.75 + 1.0) / 2)
    assert four.arrived["paper"][1] < 0.3


@pytest.mark.parametrize(
    ("paper", "why"),
    [
        ({"arrived": False, "success": False, "ended": "fault"}, "did not arrive: fault"),
        ({"duration_s": 2.0, "rotation_rad": 1.5}, "turning set the pace"),
        ({"duration_s": 0.9, "rotation_rad": 1.5}, "takes no longer, but the tool turns more"),
        ({"duration_s": 2.0, "rotation_rad": 0.5, "velocity_share": 0.8}, "near its greatest speed"),
        ({"duration_s": 2.0, "rotation_rad": 0.5, "velocity_share": 0.2}, "longer to settle"),
        ({"ldlj_joint": 0.0}, "starts and stops"),
        ({"path_length_m": 1.1, "jump_target_distance_m": 0.9}, "over its pre-grasp"),
        ({"path_length_m": 1.1, "jump_target_distance_m": 1.1}, "orientation came first"),
        (
            {"path_length_m": 1.1, "jump_target_distance_m": 1.1, "jump_target_chord": 1.1},
            "passed over for its way",
        ),
        ({"path_length_m": 1.1, "hand_over": 1}, "same ready pose"),
    ],
)
def test_the_reason_is_the_one_that_the_numbers_show(paper, why):
    (failure,) = failures(both("a", paper, {}))
    assert why in failure.why


def test_all_definitions_of_m_are_tried_under_both_strategies():
    found = approach_conditions()
    assert len(found) == 2 * len(DEFINITIONS) == len({c.key for c in found})
    with pytest.raises(UnknownName, match="yoshikawa"):
        approach_conditions(["beauty"])
    assert set(CLAIMS) == {"shorter", "turns less", "smoother (tool)", "smoother (joints)", "quicker"}


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    folder = tmp_path_factory.mktemp("approach")
    arguments = ["study", "approach", "--robots", "panda", "--scenes", "2", "--objects", "2", "--seed", "5"]
    arguments += ["--measures", "yoshikawa", "inverse-condition", "--workers", "0", "--output", str(folder)]
    assert main(arguments) == 0
    return folder


def test_the_experiment_writes_tables_summary_and_a_page_that_needs_no_network(output):
    summary = json.loads((output / "summary.json").read_text())
    assert summary["rows"] == 8
    assert [(c["robot"], c["measure"]) for c in summary["comparisons"]] == [
        ("panda", "yoshikawa"),
        ("panda", "inverse-condition"),
    ]
    assert len(summary["scenes"]) == 2
    assert "numpy" in summary["versions"]
    assert len((output / "table.csv").read_text().splitlines()) == 9
    page = (output / "report.html").read_text()
    assert 'src="http' not in page
    assert "<script" not in page
    assert page.count("data:image/svg+xml") == len(list((output / "figures").glob("*.svg"))) >= 3
    assert all(path.stat().st_size > 5000 for path in (output / "figures").glob("*.png"))


def test_a_failing_case_can_be_told_in_words():
    scene = random_scene("panda", 3, objects=("can", "box"))
    changes = {"person_seed": 3, "goal": scene.goal}
    longer = {"paper": 2.0, "manipulability": 1.0}
    rows = [row(name, scene.hash, path_length_m=x, **changes) for name, x in longer.items()]
    (failure,) = failures(rows)
    words = explanation(failure, EpisodeSettings(), scene)
    assert "hand-over at" in words
    assert "greatest M" in words


def test_rankings_hold_without_and_give_way_under_perturbation():
    case = (random_scene("panda", 3, objects=("can", "box")), OperatorSpec(seed=3))
    from optsc.study.sweep.space import conditions

    rule = conditions([{"weight.orientation": 1.0, "weight.position": 1.0, "weight.manipulability": 1.0}])
    still, shaken = stability([case], rule, sizes=(0.0, 1.0), draws=3)
    assert (still.tau, still.same_choice) == (1.0, 1.0)
    assert shaken.tau < 0.99


@pytest.mark.parametrize(
    ("arguments", "answer"),
    [
        (["study", "approach", "--robots", "pandora"], "panda"),
        (["study", "approach", "--people", "sleepy"], "typical"),
        (["study", "approach", "--measures", "beauty"], "simox"),
        (["study", "approach", "--level", "hell"], "cluttered"),
        (["study", "approach", "--scenes", "0"], "1 or more"),
        (["study", "arbitration", "--policies", "anarchy"], "alternating"),
        (["sweep", "--design", "spiral"], "sobol"),
        (["sweep", "--vary", "weight.charm=0:1"], "weight.pose"),
        (["sweep", "--seed", "-1"], "0 or more"),
        (["sweep", "--follower", "gazebo"], "pybullet"),
    ],
)
def test_a_wrong_word_is_answered_with_what_would_be_right(arguments, answer, capsys, tmp_path):
    assert main([*arguments, "--output", str(tmp_path / "out")]) == 1
    assert answer in capsys.readouterr().err


@pytest.mark.parametrize("command", [["study"], ["study", "approach"], ["study", "arbitration"], ["sweep"]])
def test_every_command_has_a_help_that_shows_an_example(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([*command, "--help"])
    assert stop.value.code == 0
    assert f"example: optsc {' '.join(command)}" in " ".join(capsys.readouterr().out.split())


def test_two_policies_are_compared_on_the_same_cases(tmp_path):
    arguments = ["study", "arbitration", "--scenes", "3", "--objects", "2", "--seed", "2", "--workers", "0"]
    arguments += ["--policies", "alternating", "manual", "--output", str(tmp_path)]
    assert main(arguments) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert set(summary["policies"]) == {"alternating", "manual"}
    alternating = summary["policies"]["alternating"]
    assert alternating["cases"] == 3
    assert 0.0 < alternating["grasp_s"][0] < 30.0
    # A command that does not step: what is left is the motion of a tick.
    assert alternating["jump_position_m"][0] < 2e-3
    assert summary["policies"]["manual"]["effort_m"][0] > alternating["effort_m"][0]
    assert (tmp_path / "report.html").exists()
    assert {"timelines.png", "ways_1.png"} <= {path.name for path in (tmp_path / "figures").iterdir()}


def test_a_report_refuses_two_pictures_of_one_name(tmp_path):
    from matplotlib.figure import Figure

    from optsc.viewers.report import Picture, Report

    report = Report("Twice")
    report.add("Here", Picture("same", Figure(), ""), Picture("same", Figure(), ""))
    with pytest.raises(InvalidValue, match="each once"):
        report.save(tmp_path)
