"""Running jobs: what is finished is skipped, what dies is replaced, and the table comes out the same."""

import os
import random as standard_random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from sweep_jobs import Counting, failing_work, fake_jobs, fake_work, mortal_work

from optsc.errors import DamagedFile, InvalidValue
from optsc.study.results_folder import read_table, write_csv
from optsc.study.sweep.runner import JobFailed, Progress, dask_executor, run_jobs
from optsc.study.sweep.store import RowStore

HERE = Path(__file__).parent


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
import sweep_jobs as t
from optsc.study.sweep.runner import run_jobs
from optsc.study.results_folder import write_table
from optsc.study.sweep.store import RowStore
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
