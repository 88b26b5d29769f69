"""Results of settings and tuning: which settings are compared, and how a search goes on."""

import json

import numpy as np
import pytest

from optsc.cli import main
from optsc.errors import InvalidValue, UnknownName
from optsc.study.cases import Cases
from optsc.study.results_folder import read_table
from optsc.study.sweep.results import MEANS, setting_results
from optsc.study.sweep.runner import run_jobs
from optsc.study.sweep.space import Dimension
from optsc.study.sweep.store import RowStore
from optsc.study.sweep.tuning import tune

WEIGHTS = [Dimension(f"weight.{name}") for name in ("orientation", "position", "manipulability")]


def outcomes():
    rows = []
    for name, paths, found in (("a", [1.0, 2.0], 0.1), ("b", [1.2, 1.4], 0.3), ("c", [2.0, 2.0], 0.2)):
        rows += [fake_outcome(name, path, found) for path in paths]
    return [*rows, fake_outcome("d", 0.1, 0.9), {**fake_outcome("d", 0.1, 0.9), "success": False}]


def fake_outcome(name, path, found):

    numbers = {**dict.fromkeys(MEANS, 0.0), "path_length_m": path, "target_yoshikawa": found}
    return {
        "robot": "panda",
        "condition": name,
        "measure": "yoshikawa",
        "success": True,
        "at_x": 1,
        **numbers,
    }


def test_a_setting_that_gives_up_on_hard_scenes_is_not_on_the_front():
    found = setting_results(outcomes()).set_index("condition")
    assert found["path_length_m"]["a"] == pytest.approx(1.5)
    assert set(found.index[found["best"]]) == {"b"}
    assert found["success"]["d"] == 0.5
    assert found["at_x"]["b"] == 1


def test_whole_numbers_of_a_point_stay_whole_where_others_have_none():
    rows = [{**fake_outcome("a", 1.0, 0.1), "at_x": 3}, {**fake_outcome("b", 1.0, 0.1), "at_x": 0.5}]
    rows.append({name: x for name, x in fake_outcome("c", 1.0, 0.1).items() if name != "at_x"})
    points = [row["at_x"] for row in setting_results(rows).to_dict("records")]
    assert [repr(x) for x in points[:2]] == ["3", "0.5"]
    assert points[2] is None


def test_cases_meet_the_same_people_whatever_the_settings():
    cases = Cases(("panda", "ur5"), scenes=3, seed=2, people=("typical", "hasty"), repetitions=2)
    pairs = cases.pairs()
    assert len(pairs) == 2 * 3 * 2 * 2
    assert [person for _, person in pairs[:12]] == [person for _, person in pairs[12:]]
    assert len({person for _, person in pairs[:12]}) == 12
    with pytest.raises(InvalidValue, match="scenes"):
        Cases(scenes=0)


def test_tuning_finds_its_way_back_without_computing_anything_twice(tmp_path):
    pytest.importorskip("optuna")
    cases = Cases(scenes=1, objects=2)
    first = tune(cases, WEIGHTS, RowStore(tmp_path), trials=6, generation=3, workers=0)
    known = len(RowStore(tmp_path))
    again = tune(cases, WEIGHTS, RowStore(tmp_path), trials=6, generation=3, workers=0)
    assert again == first
    assert len(RowStore(tmp_path)) == known
    assert any(trial.best for trial in first)
    longer = tune(cases, WEIGHTS, RowStore(tmp_path), trials=9, generation=3, workers=0)
    assert [trial.point for trial in longer[:6]] == [trial.point for trial in first]


def test_tuning_refuses_what_it_cannot_weigh_against_each_other(tmp_path):
    one, store = Cases(scenes=1), RowStore(tmp_path)
    with pytest.raises(UnknownName, match="path_length_m"):
        tune(one, WEIGHTS, store, objectives={"beauty": "maximize"})
    with pytest.raises(InvalidValue, match="minimize or maximize"):
        tune(one, WEIGHTS, store, objectives={"path_length_m": "less"})
    with pytest.raises(InvalidValue, match="panda, ur5"):
        tune(Cases(("panda", "ur5"), scenes=1), WEIGHTS, store)
    with pytest.raises(InvalidValue, match="each once"):
        tune(one, [WEIGHTS[0], WEIGHTS[0]], store)


def test_a_search_does_not_prefer_points_that_give_up_on_hard_cases(tmp_path, monkeypatch):
    pytest.importorskip("optuna")

    def outcome(job):
        """A short way where orientation weighs little, but then one of the two scenes is not solved."""
        rows = []
        for key, condition in zip(job.keys(), job.conditions, strict=True):
            x = condition.about["weight.orientation"]
            fails = x < 0.5 and job.scene == scenes[1]
            found = fake_outcome("-", np.nan if fails else x, x)
            rows.append({**found, "key": key, "success": not fails})
        return rows

    cases = Cases(scenes=2, objects=2)
    scenes = cases.all_scenes()
    monkeypatch.setattr("optsc.study.sweep.tuning.run_jobs", lambda *a, **k: run_jobs(*a, **k, work=outcome))
    trials = tune(cases, WEIGHTS, RowStore(tmp_path), trials=60, generation=12, workers=0, seed=1)
    x = np.array([trial.point["weight.orientation"] for trial in trials])
    assert [trial.success for trial in trials] == [1.0 if value >= 0.5 else 0.5 for value in x]
    assert min(x) < 0.5
    assert all(trial.success == 1.0 for trial in trials if trial.best)
    # The search has learnt it too: later generations hardly try them any more.
    assert np.mean(x[-24:] < 0.5) < np.mean(x[:12] < 0.5)


def test_a_search_from_the_command_line_reports_its_front(tmp_path):
    pytest.importorskip("optuna")
    objectives = ["--objectives", "rotation_rad=minimize", "clearance_m=maximize"]
    few = "--tune --count 4 --scenes 1 --objects 2 --stability 0 --workers 0"
    assert main(["sweep", *few.split(), *objectives, "--output", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["rows"], summary["settings"]) == (6, 4)
    assert summary["objectives"] == {"rotation_rad": "minimize", "clearance_m": "maximize"}
    page = (tmp_path / "report.html").read_text()
    assert "The objectives of the search" in page
    assert (tmp_path / "figures" / "objectives.png").exists()
    trials, settings = (read_table(tmp_path / f"{name}.parquet") for name in ("trials", "settings"))
    best = {f"{row['trial']:05d}" for row in trials if row["best"]}
    assert best == {row["condition"] for row in settings[2:] if row["best"]} != set()
