"""Processes of a live session: each says when it is ready, and ends when the one that started it does."""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any

from optsc.errors import OptscError
from optsc.processes import end_with, single_threaded

LONGEST_START = 120.0
"""How long a process may take until it is ready [s]."""
LONGEST_END = 60.0
"""How long it may take to finish [s]."""


class ChildFailed(OptscError):
    """A process of a session could not begin, or ended by itself."""

    def __init__(self, name: str, reason: str) -> None:
        self.name, self.reason = name, reason
        super().__init__(f"the {name} process {reason}")


class Child:
    """A process that runs ``work(say_ready, *arguments)`` and ends with this one, however this one ends.

    Args:
        name: for messages.
        work: a function of a module, since the process begins from nothing; it calls ``say_ready(facts)`` once.
        arguments: for it.
        finishes: whether it is given the time to finish: ``work`` is then called with an ``ended()`` behind
            ``say_ready``, which tells whether it has to.

    Attributes:
        facts: what it said when it was ready.
    """

    def __init__(self, name: str, work: Callable[..., None], *arguments: Any, finishes: bool = False) -> None:
        context = get_context("spawn")
        self.name, self.facts = name, None
        leash, self._held = context.Pipe(duplex=False)
        self._heard, said = context.Pipe(duplex=False)
        self._process: BaseProcess = context.Process(
            target=_run, args=(leash, said, work, arguments, finishes), name=f"optsc {name}"
        )
        with single_threaded():
            self._process.start()
        leash.close()
        said.close()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid or 0

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.is_alive()

    def wait_until_ready(self) -> Any:
        """Wait until it is ready and return its facts; raise `ChildFailed`, with what it failed with."""
        end = time.monotonic() + LONGEST_START
        while not self._heard.poll(0.1):
            if not self.alive and not self._heard.poll(0.0):
                raise ChildFailed(self.name, f"ended at once, with code {self._process.exitcode}")
            if time.monotonic() > end:
                raise ChildFailed(self.name, f"was not ready after {LONGEST_START:.0f} s")
        try:
            kind, self.facts = self._heard.recv()
        except EOFError:
            self._process.join()
            raise ChildFailed(self.name, f"ended at once, with code {self._process.exitcode}") from None
        if kind == "error":
            raise ChildFailed(self.name, f"failed: {self.facts}")
        return self.facts

    def close(self) -> None:
        """Let it end, and wait for that."""
        self._held.close()
        self._process.join(LONGEST_END)
        if self.alive:
            self._process.kill()
            self._process.join()
        self._heard.close()

    def __enter__(self) -> Child:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _run(
    leash: Connection, said: Connection, work: Callable[..., None], arguments: tuple[Any, ...], finishes: bool
) -> None:
    if finishes:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        arguments = (lambda: leash.poll(0.0), *arguments)
    else:
        end_with(leash)

    def say_ready(facts: Any = None) -> None:
        said.send(("ready", facts))

    try:
        work(say_ready, *arguments)
    except OptscError as error:
        said.send(("error", str(error)))
        sys.exit(1)
    except Exception as error:  # noqa: BLE001 - whatever it is, the process that waits has to hear of it
        traceback.print_exc()
        said.send(("error", f"{type(error).__name__}: {error}"))
        os._exit(1)
