"""Process pool for long computations: fresh processes of one thread each, which end with the one that started them."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Thread

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def usable_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Give a pool whose processes end with this one, however it ends, and at once where the context is left early."""
    # Spawned and not forked: a fork would inherit threads and simulations in an unknown state.
    context = get_context("spawn")
    leash, held = context.Pipe(duplex=False)
    with (
        single_threaded(),
        leash,
        held,
        ProcessPoolExecutor(workers, context, initializer=end_with, initargs=(leash,)) as pool,
    ):
        try:
            yield pool
        except BaseException:
            held.close()
            raise


def end_with(leash: Connection) -> None:
    """Let this process end when the other end of ``leash`` closes; interrupts are left to the process that holds it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        # True at the end of the pipe too, and nothing is ever sent.
        leash.poll(None)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


@contextmanager
def single_threaded() -> Iterator[None]:
    """Let processes that are started meanwhile use one thread each: there is one for each core."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
