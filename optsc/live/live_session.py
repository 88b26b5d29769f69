"""A live session: starts control process and page server around one shared memory, and keeps them going."""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from types import TracebackType
from typing import Any

from optsc.live.access import Access, plain_names
from optsc.live.children import Child, ChildFailed
from optsc.live.layout import SharedParts, Sizes
from optsc.live.observer import Pipe, run_observer
from optsc.live.scene import LiveScene, SceneChoice

LOOK_EVERY = 0.2
"""From one look at the processes to the next [s]."""


class LiveSession:
    """A session that runs: a person can open its page and drive.

    Args:
        scene: what is driven.
        access: where the page is served, and to whom.
        light: whether surfaces are to be as coarse as can be.
        output: folder that the run is recorded in, see `optsc.live.run_folder`; None for not at all.
        say: is told what happens, in words.

    Attributes:
        parts: the shared memory.
        access: the same with the port that was found.

    Raises:
        ChildFailed: a process could not begin.
    """

    def __init__(
        self,
        scene: LiveScene,
        access: Access,
        light: bool = False,
        output: Path | None = None,
        say: Callable[[str], None] = print,
    ) -> None:
        self.scene, self.access, self._light, self._output, self._say = scene, access, light, output, say
        self.parts = SharedParts(scene.sizes)
        self._shared = (scene.choice, scene.sizes, self.parts.segment.name)
        asking, answering = get_context("spawn").Pipe()
        self.control = Child("control", run_control, *self._shared, asking)
        self.observer = Child("observer", run_observer, scene.choice, answering)
        asking.close()
        answering.close()
        self.recorder = self._recorded()
        self.server = self._served()
        try:
            if self.recorder is not None:
                self.recorder.wait_until_ready()
            self.control.wait_until_ready()
            self.observer.wait_until_ready()
            self._find_port()
        except BaseException:
            self.close()
            raise

    def _served(self) -> Child:
        return Child("page", run_server, *self._shared, self.access, self._light)

    def _recorded(self) -> Child | None:
        if self._output is None:
            return None
        from optsc.live.recorder import run_recorder

        return Child("recorder", run_recorder, *self._shared, self._output, finishes=True)

    def _find_port(self) -> None:
        self.access = replace(self.access, port=self.server.wait_until_ready())

    def watch(self, until: Callable[[], bool] = lambda: False) -> None:
        """Keep the session going until told otherwise; a page server that ended begins again at the same address.

        Raises:
            ChildFailed: the control process ended.
        """
        while not until():
            if not self.control.alive:
                raise ChildFailed("control", "ended; the arm was left where it was")
            if not self.observer.alive:
                raise ChildFailed("observer", "ended; grasps would no longer follow the objects")
            if not self.server.alive:
                self._say("the page server ended; it begins again, and the arm holds until then")
                self.server.close()
                self.server = self._served()
                self._find_port()
            if self.recorder is not None and not self.recorder.alive:
                self._say("the recorder ended; another one goes on in the same folder")
                self.recorder.close()
                self.recorder = self._recorded()
            time.sleep(LOOK_EVERY)

    def close(self) -> None:
        """End the processes, the recorder when it has written everything, and remove the shared memory."""
        self.server.close()
        self.control.close()
        self.observer.close()
        if self.recorder is not None:
            self.recorder.close()
        self.parts.segment.close()

    def __enter__(self) -> LiveSession:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def run_control(
    say_ready: Callable[[Any], None], choice: SceneChoice, sizes: Sizes, name: str, pipe: Pipe | None = None
) -> None:
    """Run the control process; ``pipe`` leads to the observer."""
    from optsc.live.loop import ControlLoop

    loop = ControlLoop(LiveScene(choice), SharedParts(sizes, name), pipe)
    say_ready(None)
    loop.run(lambda: False)


def run_server(
    say_ready: Callable[[Any], None], choice: SceneChoice, sizes: Sizes, name: str, access: Access, light: bool
) -> None:
    """Run the page server; it is ready with the port that it serves."""
    from optsc.live.clients import LATEST
    from optsc.live.frames import Frames
    from optsc.live.server import PageServer

    parts = SharedParts(sizes, name)
    # Who waits longer for a slow network also takes what comes late over it.
    latest = max(LATEST, choice.timeout)
    server = PageServer(parts, Frames(LiveScene(choice), parts.state_columns, light), access, latest)
    context = None
    if access.secure:
        from optsc.live.certificates import server_context

        with tempfile.TemporaryDirectory() as folder:
            context = server_context(plain_names(access.names), Path(folder))

    async def serve() -> None:
        async with await server.start(context):
            say_ready(server.access.port)
            await server.send_frames()

    asyncio.run(serve())
