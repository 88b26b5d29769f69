"""Sweeps: designs, rows that are kept, runs that are killed, workers that die."""

import json
import os
import random as standard_random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from optsc.cli import main
from optsc.errors import DamagedFile, InvalidValue, UnknownName
from optsc.selection import Cascade, WeightedSum
from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER, Condition
from optsc.study.sweep.plan import Cases
from optsc.study.sweep.results import settle
from optsc.study.sweep.runner import JobFailed, Progress, dask_executor, run_jobs
from optsc.study.sweep.space import (
    COSTS,
    Dimension,
    conditions,
    design,
    grid,
    one_at_a_time,
    random,
    rule_of,
    simplex,
    sobol,
)
from optsc.study.sweep.store import RowStore, read_table, write_csv
from optsc.study.sweep.tuning import tune

WEIGHTS = [Dimension(f"weight.{name}") for name in ("orientation", "position", "manipulability")]
HERE = Path(__file__).parent


def test_a_grid_has_every_combination_once():
    points = grid(
        [
            Dimension("keep.orientation", 10, 50, "integer"),
            Dimension("measure", values=("yoshikawa", "simox")),
        ],
        3,
    )
    assert len(points) == 6
    assert {p["keep.orientation"] for p in points} == {10, 30, 50}
    assert len({tuple(p.values()) for p in points}) == 6


def test_a_simplex_adds_up_to_one_and_has_its_corners():
    points = simplex(WEIGHTS, 4)
    assert len(points) == 15
    assert all(sum(p.values()) == pytest.approx(1.0) for p in points)
    assert sum(max(p.values()) == 1.0 for p in points) == 3
    with pytest.raises(InvalidValue, match="2 or more"):
        simplex(WEIGHTS[:1], 4)


def test_sobol_points_fill_every_half_of_every_dimension_evenly():
    points = sobol(WEIGHTS, 64, seed=3)
    x = np.array([list(p.values()) for p in points])
    assert np.array_equal((x < 0.5).sum(axis=0), [32, 32, 32])
    quadrants = (x[:, 0] < 0.5).astype(int) + 2 * (x[:, 1] < 0.5)
    assert np.bincount(quadrants).tolist() == [16, 16, 16, 16]
    assert points == sobol(WEIGHTS, 64, seed=3) != sobol(WEIGHTS, 64, seed=4)
    assert len(sobol(WEIGHTS, 50, seed=0)) == 50


def test_random_points_follow_their_seed_and_stay_in_range():
    dimensions = [Dimension("dof.length", 0.05, 0.5, "log"), Dimension("keep.position", 2, 9, "integer")]
    points = random(dimensions, 200, 1)
    assert points == random(dimensions, 200, 1) != random(dimensions, 200, 2)
    assert all(0.05 <= p["dof.length"] <= 0.5 for p in points)
    assert {p["keep.position"] for p in points} == set(range(2, 10))
    # Half of a log range lies below its geometric middle.
    assert 70 <= sum(p["dof.length"] < np.sqrt(0.05 * 0.5) for p in points) <= 130


def test_one_at_a_time_changes_one_thing_at_a_time():
    base = {"weight.orientation": 0.5, "weight.position": 0.5, "weight.manipulability": 0.5}
    points = one_at_a_time(WEIGHTS, 3, base)
    assert points[0] == base
    assert all(sum(p[n] != base[n] for n in base) == 1 for p in points[1:])
    assert len(points) == 1 + 3 * 2
    with pytest.raises(InvalidValue, match="a value of"):
        one_at_a_time(WEIGHTS, 3, {})


def test_dimensions_are_read_as_they_are_written():
    assert Dimension.parse("weight.pose=0:2") == Dimension("weight.pose", 0.0, 2.0)
    assert Dimension.parse("dof.rz=0.1:10:log").kind == "log"
    assert Dimension.parse("measure=yoshikawa,simox").values == ("yoshikawa", "simox")
    for wrong, answer in (
        ("weight.charm=0:1", "weight.pose"),
        ("dof.x=1:0", "lower end"),
        ("dof.x=a:b", "numbers"),
    ):
        with pytest.raises((UnknownName, InvalidValue), match=answer):
            Dimension.parse(wrong)
    with pytest.raises(UnknownName, match="sobol"):
        design("spiral", WEIGHTS, count=1, levels=1, seed=0)


def test_a_point_stands_for_its_rule():
    assert rule_of({"keep.orientation": 40, "keep.position": 5}) == Cascade.paper(40, 5)
    assert rule_of({}) == Cascade.paper()
    rule = rule_of({"weight.orientation": 1.0, "weight.pose": 0.5, "dof.z": 0.0, "dof.length": 0.2})
    assert isinstance(rule, WeightedSum)
    named = {cost.name: (cost, weight) for cost, weight in rule.terms}
    assert named["orientation"][1] == pytest.approx(1.0 / 0.5)
    assert named["pose"][0].position == (1.0, 1.0, 0.0)
    assert named["pose"][0].length == 0.2
    assert rule_of({"keep.pose": 12, "dof.rz": 0.3}).steps[0].keep == 12
    assert {"orientation", "position", "manipulability", "pose"} <= set(COSTS)


def test_settings_that_rank_nothing_are_left_out():
    points = [{"weight.position": 0.0}, {"weight.position": 1.0, "measure": "simox"}]
    (condition,) = conditions(points)
    assert (condition.name, condition.measure) == ("00001", "simox")
    assert condition.about == points[1]


@dataclass(frozen=True)
class FakeScene:
    hash: str
    robot: str = "none"
    seed: int = 0


@dataclass(frozen=True)
class FakeJob:
    """A job without an arm: numbers from its name."""

    scene: FakeScene
    conditions: tuple

    def keys(self):
        return [f"{self.scene.hash}-{c}" for c in self.conditions]

    def labels(self, condition):
        return {"scene": self.scene.hash, "condition": condition}


def fake_jobs(scenes=6, settings=5):
    return [FakeJob(FakeScene(f"s{k}"), tuple(range(settings))) for k in range(scenes)]


def fake_work(job):
    return [{"key": k, "value": float(len(k)), "word": job.scene.hash} for k in job.keys()]  # noqa: SIM118


def failing_work(job):
    if job.scene.hash == "s3":
        raise ValueError("this one never works")
    return fake_work(job)


def test_finished_rows_are_skipped_and_counted(tmp_path):
    seen, jobs = [], fake_jobs()

    def counting(job):
        seen.append((job.scene.hash, job.conditions))
        return fake_work(job)

    run_jobs(fake_jobs(scenes=2, settings=3), RowStore(tmp_path), workers=0, work=counting)
    reports = []
    rows = run_jobs(jobs, RowStore(tmp_path), workers=0, work=counting, on_progress=reports.append)
    assert seen[2:4] == [("s0", (3, 4)), ("s1", (3, 4))]
    assert [r["key"] for r in rows] == [k for job in jobs for k in job.keys()]  # noqa: SIM118
    assert reports[0].rows == reports[0].skipped == 6
    assert reports[-1].rows == reports[-1].of == 30
    assert rows[7] == {"key": "s1-2", "value": 4.0, "word": "s1", "scene": "s1", "condition": 2}


def test_progress_tells_the_remaining_time_at_the_pace_so_far():
    assert Progress(30, 100, 10, 40.0).remaining == pytest.approx(40.0 * 70 / 20)
    assert Progress(10, 100, 10, 3.0).remaining is None
    assert str(Progress(30, 100, 10, 40.0)) == "30 of 100 rows, 0:40 gone, 2:20 left"


def test_a_job_that_fails_says_which_and_loses_nothing_of_the_others(tmp_path):
    with pytest.raises(JobFailed, match=r"s3.*never works"):
        run_jobs(fake_jobs(), RowStore(tmp_path), workers=0, work=failing_work)
    assert len(RowStore(tmp_path)) == 15


def test_any_executor_will_do(tmp_path):
    with ThreadPoolExecutor(3) as executor:
        rows = run_jobs(fake_jobs(), RowStore(tmp_path / "a"), executor=executor, work=fake_work)
    assert rows == run_jobs(fake_jobs(), RowStore(tmp_path / "b"), workers=0, work=fake_work)


def test_a_torn_file_is_told_and_a_stray_part_ignored(tmp_path):
    store = RowStore(tmp_path)
    store.add(fake_work(fake_jobs()[0]))
    (tmp_path / ".x.parquet.0.part").write_bytes(b"half a row")
    assert len(RowStore(tmp_path)) == 5
    (tmp_path / "torn.parquet").write_bytes(b"PAR1 not really")
    with pytest.raises(DamagedFile, match="torn"):
        RowStore(tmp_path)


def test_a_row_that_comes_twice_is_kept_once(tmp_path):
    store, rows = RowStore(tmp_path), fake_work(fake_jobs()[0])
    assert store.add([*rows, rows[0]]) == 5
    assert store.add(rows) == 0
    assert len(list(tmp_path.glob("*.parquet"))) == 1
    with pytest.raises(InvalidValue, match="1, first nowhere"):
        store.rows(["nowhere"])


def test_numbers_survive_both_kinds_of_files(tmp_path):
    rows = [{"key": "a", "x": 0.1 + 0.2, "n": 3}, {"key": "b", "x": float("nan"), "n": 4, "more": True}]
    store = RowStore(tmp_path)
    store.add(rows)
    back = {row["key"]: row for row in read_table(next(tmp_path.glob("*.parquet")))}
    assert back["a"]["x"] == 0.1 + 0.2
    assert np.isnan(back["b"]["x"])
    assert back["a"]["more"] is None
    write_csv(rows, tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text().splitlines() == [
        "key,x,n,more",
        "a,0.30000000000000004,3,",
        "b,,4,True",
    ]


SCRIPT = """
import sys, time
sys.path.insert(0, {here!r})
import test_sweep as t
from optsc.study.sweep.runner import run_jobs
from optsc.study.sweep.store import RowStore, write_table
from pathlib import Path

def slow(job):
    time.sleep(0.03)
    return t.fake_work(job)

directory = Path(sys.argv[1])
rows = run_jobs(t.fake_jobs(24, 4), RowStore(directory / "rows"), workers=0, work=slow)
write_table(rows, directory / "table.parquet")
"""


def test_killed_at_random_moments_and_started_again_it_ends_with_the_same_table(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(here=str(HERE)))
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    subprocess.run([sys.executable, script, whole], check=True)
    moments = standard_random.Random(5)
    for _ in range(2):
        process = subprocess.Popen([sys.executable, script, killed])
        before = len(list((killed / "rows").glob("*.parquet")))
        while process.poll() is None and len(list((killed / "rows").glob("*.parquet"))) < before + 3:
            time.sleep(0.01)
        time.sleep(0.05 * moments.random())
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert 0 < len(RowStore(killed / "rows")) < 96
    assert not (killed / "table.parquet").exists()
    subprocess.run([sys.executable, script, killed], check=True)
    assert (killed / "table.parquet").read_bytes() == (whole / "table.parquet").read_bytes()


SMALL = "--design random --count 4 --scenes 2 --objects 2 --stability 1 --workers 0 --seed 3"


def test_the_real_sweep_killed_and_started_again_ends_with_the_same_table(tmp_path):
    def arguments(name):
        return ["sweep", *SMALL.split(), "--output", str(tmp_path / name)]

    command = [sys.executable, "-m", "optsc", *arguments("killed")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and not list((tmp_path / "killed" / "rows").glob("*.parquet")):
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (tmp_path / "killed" / "summary.json").exists()
    assert main(arguments("killed")) == main(arguments("whole")) == 0
    for file in ("table.parquet", "table.csv", "settings.csv"):
        assert (tmp_path / "killed" / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()
    summary = json.loads((tmp_path / "whole" / "summary.json").read_text())
    assert (summary["rows"], summary["settings"], summary["cases"]) == (12, 4, 2)
    page = (tmp_path / "whole" / "report.html").read_text()
    assert "http" not in page.replace("http://www.w3.org", "")
    assert page.count("<img") == len(list((tmp_path / "whole" / "figures").glob("*.png"))) >= 3


def mortal_work(job):
    """Die once, in the middle of the sweep, together with the process that this runs in."""
    mark = Path(os.environ["OPTSC_TEST_MARK"])
    if job.scene.hash == "s4" and not mark.exists():
        mark.write_text("dead")
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.02)
    return fake_work(job)


def test_a_process_of_the_pool_that_dies_is_replaced(tmp_path, monkeypatch):
    monkeypatch.setenv("OPTSC_TEST_MARK", str(tmp_path / "mark"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), *sys.path]))
    rows = run_jobs(fake_jobs(10), RowStore(tmp_path / "rows"), workers=2, work=mortal_work)
    assert (tmp_path / "mark").exists()
    assert rows == run_jobs(fake_jobs(10), RowStore(tmp_path / "other"), workers=0, work=fake_work)


def test_a_dask_worker_that_is_killed_loses_nothing_and_doubles_nothing(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setenv("OPTSC_TEST_MARK", str(tmp_path / "mark"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), *sys.path]))
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
        ) as cluster,
        dask_executor(cluster.scheduler_address) as executor,
    ):
        rows = run_jobs(fake_jobs(12), RowStore(tmp_path / "rows"), executor=executor, work=mortal_work)
    assert (tmp_path / "mark").exists()
    keys = [row["key"] for path in (tmp_path / "rows").glob("*.parquet") for row in read_table(path)]
    assert len(keys) == len(set(keys)) == 60
    assert rows == run_jobs(fake_jobs(12), RowStore(tmp_path / "other"), workers=0, work=fake_work)


def test_without_a_scheduler_there_is_a_clear_word():
    pytest.importorskip("distributed")
    from optsc.errors import OptscError

    with pytest.raises(OptscError, match="no Dask scheduler"), dask_executor("tcp://127.0.0.1:9", 0.5):
        pass


def settled_rows():
    rows = []
    for name, paths, found in (("a", [1.0, 2.0], 0.1), ("b", [1.2, 1.4], 0.3), ("c", [2.0, 2.0], 0.2)):
        rows += [fake_outcome(name, path, found) for path in paths]
    return [*rows, fake_outcome("d", 0.1, 0.9), {**fake_outcome("d", 0.1, 0.9), "success": False}]


def fake_outcome(name, path, found):
    from optsc.study.sweep.results import MEANS

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
    found = {s.row["condition"]: s for s in settle(settled_rows())}
    assert found["a"].row["path_length_m"] == pytest.approx(1.5)
    assert {name for name, s in found.items() if s.best} == {"b"}
    assert found["d"].row["success"] == 0.5
    assert found["b"].row["at_x"] == 1


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
    with pytest.raises(UnknownName, match="path_length_m"):
        tune(cases, WEIGHTS, RowStore(tmp_path), objectives={"beauty": "maximize"})


def test_references_are_told_apart_from_settings_by_name():
    names = {PAPER.name, MANIPULABILITY_ONLY.name}
    assert names.isdisjoint({c.name for c in conditions(random(WEIGHTS, 3, 0))})
    assert Condition("x", PAPER.rule).key == PAPER.key
