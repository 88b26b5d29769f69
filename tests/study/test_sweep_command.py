"""``optsc sweep``: what it leaves, what it survives, what it refuses."""

import contextlib
import json
import multiprocessing
import os
import random as standard_random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from sweep_jobs import Counting, endless_work, fake_jobs

from optsc.cli import main
from optsc.robot.manipulability import DEFINITIONS
from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER, Condition
from optsc.study.scenes import LEVELS
from optsc.study.sweep.designs import random
from optsc.study.sweep.results import MEANS
from optsc.study.sweep.runner import run_jobs
from optsc.study.sweep.space import COSTS, Dimension, conditions
from optsc.study.sweep.store import RowStore

WEIGHTS = [Dimension(f"weight.{name}") for name in ("orientation", "position", "manipulability")]
HERE = Path(__file__).parent


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
    monkeypatch.setattr("optsc.study.sweep.report.stability", lambda *_, **__: [])


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
    print(f"{len(list((directory / 'rows').glob('*.parquet')))} of 3 jobs were done, {len(children)} children")
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


def test_references_are_told_apart_from_settings_by_name():
    names = {PAPER.name, MANIPULABILITY_ONLY.name}
    assert names.isdisjoint({c.name for c in conditions(random(WEIGHTS, 3, 0))})
    assert Condition("x", PAPER.rule).key == PAPER.key
