"""Sweeps: designs, rows that are kept, runs that are killed, workers that die."""

import contextlib
import json
import multiprocessing
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
from optsc.robot.manipulability import DEFINITIONS
from optsc.selection import Cascade, WeightedSum
from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER, Condition
from optsc.study.scenes import LEVELS
from optsc.study.sweep.plan import Cases
from optsc.study.sweep.results import MEANS, settle
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


class Counting(RowStore):
    """A store that remembers every key that it was given, also those that it had."""

    def __init__(self, directory):
        super().__init__(directory)
        self.given = []

    def add(self, rows):
        self.given += [row["key"] for row in rows]
        return super().add(rows)


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


SMALL = "--design random --count 4 --scenes 3 --objects 2 --stability 1 --seed 3"


def sweep(directory, *more):
    return ["sweep", *SMALL.split(), "--output", str(directory), *more]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the folder of a sweep that nothing interrupted."""
    directory = tmp_path_factory.mktemp("sweep") / "whole"
    assert main(sweep(directory, "--workers", "0")) == 0
    return directory


def test_a_sweep_leaves_tables_a_summary_and_a_report(whole):
    summary = json.loads((whole / "summary.json").read_text())
    assert (summary["rows"], summary["settings"], summary["cases"]) == (18, 4, 3)
    page = (whole / "report.html").read_text()
    assert "http" not in page.replace("http://www.w3.org", "")
    assert page.count("<img") == len(list((whole / "figures").glob("*.png"))) >= 3
    # Rankings are tried of settings on the front, which are named by what they are and by their numbers.
    stable = {s["condition"] for s in summary["stability"]}
    assert any("path_length_m" in name and "position 0." in name for name in stable)
    assert len(stable) >= 2
    assert all(name in page for name in stable)


@pytest.fixture
def tables_only(monkeypatch):
    """Leave out the report, which is tested elsewhere and costs more than a small sweep."""

    class Page:
        def save(self, directory):
            return directory

    monkeypatch.setattr("optsc.study.sweep.report.build", lambda *_, **__: Page())
    monkeypatch.setattr("optsc.study.stability.stability", lambda *_, **__: [])


def running(process):
    psutil = pytest.importorskip("psutil")
    with contextlib.suppress(psutil.NoSuchProcess):
        return process.status() != psutil.STATUS_ZOMBIE
    return False


@pytest.mark.usefixtures("tables_only")
def test_the_real_sweep_killed_at_any_moment_and_started_again_ends_with_the_same_table(tmp_path, whole):
    psutil = pytest.importorskip("psutil")
    seed = int(os.environ.get("OPTSC_TEST_SEED", time.time_ns() % 10**6))
    chance = standard_random.Random(seed)
    chunks, moment = chance.randrange(3), chance.random()
    print(f"killed {moment:.3f} s after {chunks} of 3 jobs: OPTSC_TEST_SEED={seed}")
    directory = tmp_path / "killed"
    command = [sys.executable, "-m", "optsc", *sweep(directory, "--workers", "2")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and (
        not (directory / "rows").exists() or len(list((directory / "rows").glob("*.parquet"))) < chunks
    ):
        time.sleep(0.02)
    time.sleep(moment)
    children = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGKILL)
    process.wait()
    print(
        f"{len(list((directory / 'rows').glob('*.parquet')))} of 3 jobs were done, {len(children)} children"
    )
    deadline = time.monotonic() + 60.0
    while any(running(child) for child in children) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(running(child) for child in children)
    assert main(sweep(directory, "--workers", "0")) == 0
    for file in ("table.parquet", "table.csv", "settings.csv"):
        assert (directory / file).read_bytes() == (whole / file).read_bytes()


@pytest.mark.usefixtures("tables_only")
def test_a_real_sweep_on_a_cluster_that_loses_a_worker_ends_with_the_same_table(tmp_path, whole, monkeypatch):
    distributed = pytest.importorskip("distributed")
    stores, killed = [], []

    class Killing(Counting):
        """Kills, when the first rows have come, a worker that has work."""

        def __init__(self, directory):
            super().__init__(directory)
            stores.append(self)

        def add(self, rows):
            number = super().add(rows)
            busy = {w for w, state in cluster.scheduler.workers.items() if state.processing}
            for nanny in cluster.workers.values():
                if not killed and nanny.worker_address in busy:
                    killed.append(nanny.pid)
                    os.kill(nanny.pid, signal.SIGKILL)
            return number

    monkeypatch.setattr("optsc.study.sweep.store.RowStore", Killing)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        assert main(sweep(tmp_path, "--scheduler", cluster.scheduler_address)) == 0
    (store,) = stores
    assert killed
    assert len(store.given) == len(set(store.given)) == len(store) == 18
    assert (tmp_path / "table.parquet").read_bytes() == (whole / "table.parquet").read_bytes()


def test_an_interrupted_sweep_keeps_what_is_finished_and_says_how_to_go_on(tmp_path, monkeypatch, capsys):
    class Interrupted(RowStore):
        def add(self, rows):
            super().add(rows)
            raise KeyboardInterrupt

    monkeypatch.setattr("optsc.study.sweep.store.RowStore", Interrupted)
    assert main(sweep(tmp_path, "--workers", "0")) == 1
    said = capsys.readouterr().err
    assert f"kept in {tmp_path / 'rows'}; to go on: optsc" in said
    assert said.endswith("stopped\n")
    assert len(RowStore(tmp_path / "rows")) == 6


def test_an_interrupted_run_lets_go_of_its_processes(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), *sys.path]))

    def interrupt(progress):
        if progress.rows:
            raise KeyboardInterrupt

    store = RowStore(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        run_jobs(fake_jobs(10), store, workers=2, work=endless_work, on_progress=interrupt)
    assert len(store) == 5
    assert not multiprocessing.active_children()


@pytest.mark.parametrize(
    ("options", "answer"),
    [
        ("--design nonsense", "simplex, sobol"),
        ("--design grid --tune", "--design is 'grid'"),
        ("--tune --levels 3", "--levels with --tune"),
        ("--design grid --count 3", "--count with grid"),
        ("--design grid --levels 1", "--levels is 1; valid: 2 or more"),
        ("--count 0", "--count is 0; valid: 1 or more"),
        ("--stability -1", "--stability is -1; valid: 0 or more"),
        ("--workers -1", "--workers is -1; valid: 0 or more"),
        ("--design one-at-a-time --base weight.pose=0:1", "one value"),
        ("--objectives clearance_m=maximize duration_s=minimize", "only with --tune"),
        ("--tune --objectives clearance_m=maximize", "two measures or more"),
        ("--tune --objectives beauty=maximize duration_s=minimize", "clearance_m"),
        ("--tune --objectives clearance_m=up duration_s=minimize", "minimize or maximize"),
        ("--tune --robots panda ur5", "robots to tune for"),
    ],
)
def test_what_a_sweep_cannot_do_or_would_ignore_is_refused_with_a_word(tmp_path, capsys, options, answer):
    assert main(["sweep", *options.split(), "--scenes", "1", "--output", str(tmp_path)]) == 1
    assert answer in capsys.readouterr().err
    assert not list(tmp_path.rglob("*.parquet"))


def test_the_help_of_a_sweep_names_all_that_can_be_chosen(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["sweep", "--help"])
    words = capsys.readouterr().out.replace(",", " ").split()
    assert ended.value.code == 0
    assert {*COSTS, *DEFINITIONS, *LEVELS, *MEANS, "hasty", "one-at-a-time", "ur5"} <= set(words)


def endless_work(job):
    """Work that no one waits for, but for that of the first job."""
    if job.scene.hash != "s0":
        time.sleep(600.0)
    return fake_work(job)


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
        store = Counting(tmp_path / "rows")
        rows = run_jobs(fake_jobs(12), store, executor=executor, work=mortal_work)
    assert (tmp_path / "mark").exists()
    assert len(store.given) == len(set(store.given)) == 60
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


def test_references_are_told_apart_from_settings_by_name():
    names = {PAPER.name, MANIPULABILITY_ONLY.name}
    assert names.isdisjoint({c.name for c in conditions(random(WEIGHTS, 3, 0))})
    assert Condition("x", PAPER.rule).key == PAPER.key
