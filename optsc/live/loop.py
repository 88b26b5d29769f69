"""The loop of the control process: a session tick by tick on a schedule, fed from and shown in shared memory."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from optsc.control.controller import SharedController
from optsc.live.hand_mailbox import HandReader
from optsc.live.layout import SharedParts
from optsc.live.observer import Lookout, Pipe
from optsc.live.scene import LiveScene
from optsc.live.settings_block import COLUMNS as SETTINGS
from optsc.live.settings_block import LiveSettings
from optsc.live.state_rows import StateRows
from optsc.real_time import RealTime
from optsc.session import Session

LOOK_EVERY = 25
"""Ticks from one look at the objects to the next."""
SHOWN_EVERY = 4
"""Ticks from one state for the page to the next."""


class ControlLoop:
    """Controller and follower of a live session; it touches neither sockets nor files.

    Args:
        scene: what is driven.
        parts: the memory that is shared with page server and recorder.
        pipe: to the observer of objects that move; None where nobody is to look.
        clock, sleep: of the schedule.

    Attributes:
        session: the loop of controller and follower.
        schedule: when ticks are due.
    """

    def __init__(
        self,
        scene: LiveScene,
        parts: SharedParts,
        pipe: Pipe | None = None,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._scene, self._parts = scene, parts
        self._settings, self._settings_count = LiveSettings(), 0
        self._settings_row = self._settings.row()
        self.controller = scene.controller(self._settings)
        self.follower = scene.follower()
        self._hand = HandReader(parts.hand)
        self.session = self._started()
        self.schedule = RealTime(clock, sleep)
        self._rows = StateRows(scene, parts)
        self._worst_late = 0.0
        self._lookout = None if pipe is None else Lookout(scene, pipe)

    def _started(self) -> Session:
        candidates, clear = self._scene.start
        return Session.start(
            self.controller,
            operator=self._hand,
            follower=self.follower,
            candidates=candidates,
            clear=clear,
            rate=self._scene.choice.rate,
        )

    def tick(self) -> None:
        """Wait for the time of the next tick, and do it."""
        now = self.schedule.wait(1.0 / self._scene.choice.rate)
        if self._parts.settings.count != self._settings_count:
            self._take_settings()
        if self._lookout is not None and self.session.ticks % LOOK_EVERY == LOOK_EVERY - 1:
            self._lookout.look(self.controller, self._rows.objects)
            self._rows.observed(self._lookout.count, *self._lookout.seen)
        tick = self.session.tick(now)
        self._worst_late = max(self._worst_late, self.schedule.late)
        rows, schedule = self._rows, self.schedule
        rows.take(tick, self.session, self._hand.row)
        self._parts.ticks.push(rows.tick_row(now, schedule, self._settings_row))
        if self.session.ticks % SHOWN_EVERY == 0:
            self._parts.state.write(rows.state_row(schedule, self._worst_late, self._settings_row))
            self._worst_late = 0.0

    def run(self, ended: Callable[[], bool]) -> None:
        """Do ticks until ``ended``; the garbage collector stays out: it costs more than a tick."""
        gc.collect()
        gc.freeze()
        gc.disable()
        try:
            while not ended():
                self.tick()
        finally:
            gc.enable()
            self.follower.close()

    def _take_settings(self) -> None:
        count, row = self._parts.settings.count, np.zeros(SETTINGS.size)
        if not self._parts.settings.read(row):
            return
        before, after = self._settings, LiveSettings.of_row(row)
        self._settings_row = row
        self._settings, self._settings_count = after, count
        apply_settings(self.controller, before, after)
        if after.restarts != before.restarts:
            self.session = self._started()
            self._rows.begin_again()
            if self._lookout is not None:
                self._lookout.begin_again()


def apply_settings(controller: SharedController, before: LiveSettings, after: LiveSettings) -> None:
    """Change what differs between two settings."""
    selector = controller.selector
    if after.ranking_rule != before.ranking_rule:
        selector.rank_by(after.ranking_rule, selector.solver.manipulability)
    if (after.scale, after.cutoff) != (before.scale, before.cutoff):
        controller.couple_by(replace(controller.clutch, scale=after.scale), after.smoothing)
