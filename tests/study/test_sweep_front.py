"""The front of a sweep: which settings stand for it, how they differ from the paper's, how they move."""

import numpy as np
import pytest
from pandas import DataFrame

from optsc.study.cases import Cases
from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER
from optsc.study.outcomes import do
from optsc.study.sweep.report import MEASURES, build, differences
from optsc.study.sweep.results import KNEE, MEANS, difference_from, setting_results, shown_settings
from optsc.study.sweep.space import conditions


def setting(name, path, found, *, best=True, robot="panda"):
    numbers = {**dict.fromkeys(MEANS, 0.0), "path_length_m": path, "target_yoshikawa": found}
    return {"robot": robot, "condition": name, "success": 1.0, **numbers, "best": best}


def shown(settings, robot=None):
    return shown_settings(DataFrame(settings), robot)


def test_a_front_is_shown_by_its_ends_and_its_knee():
    front = [setting("dent", 0.28, 0.31), setting("most", 0.4, 0.6), setting("short", 0.2, 0.3)]
    front += [setting("knee", 0.22, 0.5), setting("near the end", 0.21, 0.4)]
    beaten = [setting("beaten", 0.1, 0.9, best=False), setting("elsewhere", 0.1, 0.9, robot="ur5")]
    wanted = {"least path_length_m": "short", KNEE: "knee", "most target_yoshikawa": "most"}
    assert shown([*front, *beaten]) == wanted
    assert shown([*beaten, *front], "ur5") == {"least path_length_m, most target_yoshikawa": "elsewhere"}


def test_a_front_of_few_settings_is_shown_by_as_many():
    two = [setting("a", 0.2, 0.3), setting("b", 0.4, 0.6), setting("the same as b", 0.4, 0.6)]
    assert shown(two) == {"least path_length_m": "a", "most target_yoshikawa": "b"}
    assert list(shown(two[1:]).values()) == ["b"]
    assert shown([setting("a", 0.2, 0.3, best=False)]) == shown_settings(setting_results([])) == {}


def outcome(condition, scene, path, seed=0, **changes):
    case = {
        "robot": "panda",
        "condition": condition,
        "scene": scene,
        "person": "typical",
        "person_seed": seed,
    }
    facts = {"arrived": True, "object": "can", **dict.fromkeys(MEASURES, 0.0), "path_length_m": path}
    return {**case, **facts, **changes}


def test_settings_differ_from_the_paper_s_by_scene_and_not_by_row():
    rows = [outcome("paper", "a", 1.0), outcome("paper", "b", 1.0), outcome("paper", "c", 1.0)]
    rows += [outcome("paper", "a", 1.0, seed) for seed in (1, 2)]
    rows += [outcome("x", "a", 0.7 + 0.1 * seed, seed) for seed in (0, 1, 2)]
    rows += [outcome("x", "b", 0.6), outcome("x", "c", 0.1, arrived=False)]
    rows += [outcome("paper", "d", 1.0), outcome("x", "d", 0.1, object="box")]
    found = difference_from(DataFrame(rows), "panda", "x", "paper", "path_length_m")
    assert found.pairs == 2
    assert found.mean.value == pytest.approx(np.mean([-0.2, -0.4]))
    assert found.d_z == pytest.approx(-0.3 / np.std([-0.2, -0.4], ddof=1))
    table = differences(DataFrame([setting("x", 0.7, 0.3)]), DataFrame(rows))
    assert table.rows[0][:3] == ["x", "least path_length_m, most target_yoshikawa", 2]
    assert table.rows[0][3].startswith("-0.3 (-0.4 to -0.2)")


@pytest.fixture(scope="module")
def swept():
    points = [{"weight.position": x, "weight.manipulability": 1.0 - x} for x in (0.0, 0.5, 1.0)]
    jobs = Cases(scenes=1, objects=2, seed=4).jobs([*conditions(points), PAPER, MANIPULABILITY_ONLY])
    return jobs, [{**row, **job.labels(c)} for job in jobs for row, c in zip(do(job), job.conditions, strict=True)]


def test_the_report_compares_the_front_with_the_paper_and_shows_how_it_moves(swept, tmp_path):
    jobs, rows = swept
    references = {PAPER.name, MANIPULABILITY_ONLY.name}
    settings = setting_results([row for row in rows if row["condition"] not in references])
    references_seen = setting_results([row for row in rows if row["condition"] in references])
    page = build(settings, references_seen, [], "a command", rows=rows, jobs=jobs).save(tmp_path).read_text()
    figures = {path.name for path in (tmp_path / "figures").glob("*.png")}
    assert {"ways_panda.png", "timelines_panda.png"} <= figures
    assert "Settings on the front minus paper" in page
    assert "least path_length_m" in page
    plain = build(settings, references_seen, [], "a command").save(tmp_path / "plain").read_text()
    assert "minus paper" not in plain
