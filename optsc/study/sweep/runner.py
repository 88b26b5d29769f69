"""Runner: computes the jobs of a study on any executor, keeps rows as they come, skips those that are there."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from optsc.checks import AtLeast, require
from optsc.errors import OptscError
from optsc.processes import process_pool, usable_cores
from optsc.study.cases import Job
from optsc.study.outcomes import Row, do
from optsc.study.sweep.store import RowStore

Work: TypeAlias = Callable[[Any], list[Row]]
"""Computes a job: one row for each of its conditions, each with its key."""
RESTARTS = 3
"""How often a pool of processes is replaced after one of them died."""


@dataclass(frozen=True)
class Progress:
    """How far a run of jobs has come.

    Attributes:
        rows, of: rows that are there, of how many; skipped ones count.
        skipped: rows that were there from the beginning.
        elapsed: since the beginning [s].
    """

    rows: int
    of: int
    skipped: int
    elapsed: float

    @property
    def remaining(self) -> float | None:
        """Time that the rest will take at the pace so far [s]; None before there is a pace."""
        done = self.rows - self.skipped
        return self.elapsed * (self.of - self.rows) / done if done > 0 else None

    def __str__(self) -> str:
        left = "" if self.remaining is None else f", {_clock(self.remaining)} left"
        return f"{self.rows} of {self.of} rows, {_clock(self.elapsed)} gone{left}"


def _clock(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"


class JobFailed(OptscError):
    """A job that raised: which, and what."""

    def __init__(self, job: Job[Any], error: BaseException) -> None:
        self.job, self.error = job, error
        scene = job.scene
        super().__init__(
            f"scene {scene.hash} ({scene.robot}, seed {scene.seed}) failed: {type(error).__name__}: {error}"
        )


def run_jobs(
    jobs: Sequence[Job[Any]],
    store: RowStore,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    work: Work = do,
) -> list[Row]:
    """Compute the rows of ``jobs`` that ``store`` does not have, and return all of them in the order of the jobs.

    Args:
        jobs: what to compute; conditions of the same episode belong into one job, which shares their work.
        store: takes every job's rows as soon as they are there.
        executor: runs the jobs; by default a pool of processes for this run.
        workers: processes of that pool, by default one for each core; 0 computes in this process.
        on_progress: called at the beginning and after every job.
        work: computes one job; it has to be importable where the executor runs it.

    Raises:
        JobFailed: a job raised; what was finished before is kept, and a new run continues from there. The same holds
            for a `KeyboardInterrupt`, which ends jobs that are under way.
        InvalidValue: fewer than 0 workers.
    """
    if workers is not None:
        require("workers", workers, AtLeast(0))
    start, wanted, left = time.monotonic(), [], []
    for job in jobs:
        keys = job.keys()
        wanted += keys
        missing = tuple(c for c, k in zip(job.conditions, keys, strict=True) if k not in store)
        if missing:
            left.append(replace(job, conditions=missing))
    distinct = frozenset(wanted)
    skipped = len(distinct & store.keys)

    def report() -> None:
        if on_progress is not None:
            done, elapsed = len(distinct & store.keys), time.monotonic() - start
            on_progress(Progress(done, len(distinct), skipped, elapsed))

    report()
    # Closed at once and not by the garbage collector: an interrupted run has to end its processes.
    with closing(_computed(left, executor, workers, work)) as results:
        for rows in results:
            store.add(rows)
            report()
    labels = [job.labels(condition) for job in jobs for condition in job.conditions]
    return [{**row, **names} for row, names in zip(store.rows(wanted), labels, strict=True)]


def _computed(jobs: list[Job[Any]], executor: Executor | None, workers: int | None, work: Work) -> Any:
    """Yield the rows of each job."""
    left = dict(enumerate(jobs))
    if executor is not None:
        yield from _submitted(left, executor, work, cancel=True)
    elif workers == 0:
        for job in jobs:
            yield _in_this_process(job, work)
    else:
        yield from _pooled(left, workers or usable_cores(), work)


def _in_this_process(job: Job[Any], work: Work) -> list[Row]:
    try:
        return work(job)
    # Whatever a job raises ends the run, and has to say which job it was.
    except Exception as error:
        raise JobFailed(job, error) from error


def _pooled(left: dict[int, Job[Any]], workers: int, work: Work) -> Iterator[list[Row]]:
    """Yield the rows of each job from a pool of processes; when one of them dies, from another pool."""
    for restart in range(RESTARTS + 1):
        if not left:
            return
        try:
            with process_pool(min(workers, len(left))) as pool:
                yield from _submitted(left, pool, work, cancel=False)
        except BrokenExecutor:
            if restart == RESTARTS:
                raise


def _submitted(left: dict[int, Job[Any]], executor: Executor, work: Work, *, cancel: bool) -> Iterator[list[Row]]:
    """Yield the rows of each job and take it out of ``left``; abandoned early, cancel what is waiting if asked to.

    In a pool that is about to break nothing may be cancelled: Python 3.11 fails at futures that were.
    """
    waiting: dict[Future[list[Row]], int] = {executor.submit(work, job): index for index, job in left.items()}
    try:
        while waiting:
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                index = waiting.pop(future)
                error = future.exception()
                if isinstance(error, BrokenExecutor):
                    raise error
                if error is not None:
                    raise JobFailed(left[index], error) from error
                yield future.result()
                del left[index]
    finally:
        if cancel:
            for future in waiting:
                future.cancel()


@contextmanager
def dask_executor(address: str, timeout: float = 10.0) -> Iterator[Any]:
    """Connect to a Dask scheduler within ``timeout`` [s] and give an `Executor`; its jobs survive a lost worker.

    Raises `OptscError` where there is no `distributed` or no scheduler.
    """
    try:
        from distributed import Client
    except ImportError:
        raise OptscError("a --scheduler needs the package distributed: pip install 'optsc[cluster]'") from None
    try:
        client = Client(address, timeout=timeout, set_as_default=False)
    except (OSError, ValueError) as error:
        raise OptscError(f"no Dask scheduler answers at {address}: {error}") from None
    with client, client.get_executor(pure=False, retries=5) as executor:
        yield executor
