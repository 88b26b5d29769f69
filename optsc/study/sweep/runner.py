"""Running jobs: finished rows are skipped, the others are computed by any executor, and kept as they come."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeAlias

from optsc.errors import InvalidValue, OptscError
from optsc.processes import process_pool, usable_cores
from optsc.study.outcomes import Row, do
from optsc.study.scenes import Scene
from optsc.study.sweep.store import RowStore


class RowJob(Protocol):
    """Work that belongs together: rows of several conditions in one case; a frozen dataclass that can be pickled."""

    @property
    def scene(self) -> Scene:
        """Where."""
        ...

    @property
    def conditions(self) -> tuple[Any, ...]:
        """What is tried there."""
        ...

    def keys(self) -> list[str]:
        """Return the key of each condition's row."""
        ...

    def labels(self, condition: Any) -> Row:
        """Return what a table says about the row of a condition besides its outcome."""
        ...


Work: TypeAlias = Callable[[Any], list[Row]]
"""Computes a job: one row for each of its conditions, each with its key."""
REVIVALS = 3
"""How often a pool of processes is started anew after one of them died."""


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
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"


class JobFailed(OptscError):
    """A job that raised: which, and what."""

    def __init__(self, job: RowJob, error: BaseException) -> None:
        self.job, self.error = job, error
        scene = job.scene
        super().__init__(
            f"scene {scene.hash} ({scene.robot}, seed {scene.seed}) failed: {type(error).__name__}: {error}"
        )


def run_jobs(
    jobs: Sequence[RowJob],
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
        executor: runs the jobs; by default a pool of processes of this run's own.
        workers: processes of that pool, by default one for each core; 0 computes in this process.
        on_progress: called at the beginning and after every job.
        work: computes one job; it has to be importable where the executor runs it.

    Raises:
        JobFailed: a job raised; what was finished before is kept, and a new run goes on from there. The same holds
            for a `KeyboardInterrupt`, which ends jobs that are under way.
        InvalidValue: fewer than 0 workers.
    """
    if workers is not None and workers < 0:
        raise InvalidValue("workers", workers, "0 or more")
    start, wanted, left = time.monotonic(), [], []
    for job in jobs:
        keys = job.keys()
        wanted += keys
        missing = [c for c, k in zip(job.conditions, keys, strict=True) if k not in store]
        if missing:
            left.append(replace(job, conditions=tuple(missing)))  # type: ignore[type-var]
    distinct = frozenset(wanted)
    skipped = len(distinct & store.keys)

    def report() -> None:
        if on_progress is not None:
            on_progress(
                Progress(len(distinct & store.keys), len(distinct), skipped, time.monotonic() - start)
            )

    report()
    # Closed at once, and not when the memory is wanted: an interrupted run should let go of its processes.
    with closing(_computed(left, executor, workers, work)) as results:
        for rows in results:
            store.add(rows)
            report()
    named = [job.labels(condition) for job in jobs for condition in job.conditions]
    return [{**row, **names} for row, names in zip(store.rows(wanted), named, strict=True)]


def _computed(
    jobs: list[RowJob], executor: Executor | None, workers: int | None, work: Work
) -> Generator[list[Row], None, None]:
    if workers == 0 and executor is None:
        for job in jobs:
            yield _guarded(job, work)
    elif executor is not None:
        yield from _submitted(dict(enumerate(jobs)), executor, work, cancel=True)
    else:
        yield from _pooled(jobs, workers or usable_cores(), work)


def _guarded(job: RowJob, work: Work) -> list[Row]:
    try:
        return work(job)
    # Whatever a job raises ends the run, and has to say which job it was.
    except Exception as error:
        raise JobFailed(job, error) from error


def _pooled(jobs: list[RowJob], workers: int, work: Work) -> Iterator[list[Row]]:
    """Yield the rows of each job from a pool of this run's own; when one of its processes dies, from another pool."""
    open_ = dict(enumerate(jobs))
    for revival in range(REVIVALS + 1):
        if not open_:
            return
        try:
            with process_pool(min(workers, len(open_))) as pool:
                yield from _submitted(open_, pool, work, cancel=False)
        except BrokenExecutor:
            if revival == REVIVALS:
                raise


def _submitted(
    open_: dict[int, RowJob], executor: Executor, work: Work, *, cancel: bool
) -> Iterator[list[Row]]:
    """Yield the rows of each job and take it out of ``open_``.

    Left early, it cancels what is waiting, if it should: not in a pool that is about to break, where Python 3.11
    stumbles over futures that were cancelled.
    """
    waiting: dict[Future[list[Row]], int] = {
        executor.submit(work, job): index for index, job in open_.items()
    }
    try:
        while waiting:
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                index = waiting.pop(future)
                error = future.exception()
                if isinstance(error, BrokenExecutor):
                    raise error
                if error is not None:
                    raise JobFailed(open_[index], error) from error
                rows = future.result()
                yield rows
                del open_[index]
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
        raise OptscError(
            "a --scheduler needs the package distributed: pip install 'optsc[cluster]'"
        ) from None
    try:
        client = Client(address, timeout=timeout, set_as_default=False)
    except (OSError, ValueError) as error:
        raise OptscError(f"no Dask scheduler answers at {address}: {error}") from None
    with client, client.get_executor(pure=False, retries=5) as executor:
        yield executor
