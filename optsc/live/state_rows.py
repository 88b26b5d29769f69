"""Rows of a tick for the page and for the recorder, made in the control loop without new arrays where it matters."""

from __future__ import annotations

from typing import Any

import numpy as np

from optsc.control.controller import SharedController
from optsc.control.modes import Event, Mode
from optsc.control.status import Status
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.live import hand_mailbox
from optsc.live.hand_mailbox import BUTTONS
from optsc.live.layout import POSE, REASON, TERMS, SharedParts, text_numbers
from optsc.live.scene import LiveScene
from optsc.real_time import RealTime
from optsc.records import Tick
from optsc.selection import Ranking
from optsc.session import Session

MODES, STATUSES, EVENTS = tuple(Mode), tuple(Status), tuple(Event)
"""The order in which rows number them."""
COSTS_PERIOD = 0.1
"""How often costs and ranks are worked out for the page [s]: ranking is quick, a table of all costs less so."""

_MODE = {mode: float(i) for i, mode in enumerate(MODES)}
_STATUS = {status: float(i) for i, status in enumerate(STATUSES)}
_EVENT = {event: float(i) for i, event in enumerate(EVENTS)}
_BIT = {button: float(2**i) for i, button in enumerate(BUTTONS)}
_HAND = hand_mailbox.COLUMNS


class StateRows:
    """Makes the two rows of a tick; what changes seldom is kept from tick to tick."""

    def __init__(self, scene: LiveScene, parts: SharedParts) -> None:
        self._names = scene.names
        self._index = {name: float(i) for i, name in enumerate(scene.names)}
        self._state = np.full(parts.state_columns.size, np.nan)
        self._tick = np.full(parts.tick_columns.size, np.nan)
        self._of_state = {name: parts.state_columns[name] for name in parts.state_columns}
        self._of_tick = {name: parts.tick_columns[name] for name in parts.tick_columns}
        self._ranking: Ranking | None = None
        self._ranked = -np.inf
        self._reason = ""
        self._events = 0
        for row, at in ((self._state, self._of_state), (self._tick, self._of_tick)):
            self._put(row, at, "reason", text_numbers("", REASON))
            for name in ("intended", "event"):
                self._put(row, at, name, -1.0)
        self._put(self._state, self._of_state, "target_object", -1.0)
        self._put(self._state, self._of_state, "selected", -1.0)

    @staticmethod
    def _put(row: Array, at: dict[str, slice], name: str, value: Any) -> None:
        row[at[name]] = value

    def take(self, tick: Tick, session: Session, hand: Array) -> None:
        """Put a tick into both rows; ``hand`` is the newest reading of the device."""
        step, command, measured = tick.step, tick.step.command, tick.measured
        state, tick_row, s, t = self._state, self._tick, self._of_state, self._of_tick
        p, q = session.controller.servo.reference
        target = (*p, *q)
        held = -1.0 if step.held is None else self._index.get(step.held.object_name, -2.0)
        for row, at in ((state, s), (tick_row, t)):
            row[at["time"]], row[at["mode"]], row[at["status"]] = step.time, _MODE[step.mode], _STATUS[command.status]
            row[at["q"]], row[at["q_measured"]] = command.q, measured.q
            row[at["opening"]], row[at["opening_measured"]] = step.opening, measured.opening
            row[at["target"]], row[at["error"]] = target, command.error
            row[at["elapsed"]], row[at["arrival"]] = tick.elapsed, hand[0]
            row[at["engaged"]], row[at["held"]] = hand[_HAND["engaged"]], held
        state[s["ticks"]] = session.ticks
        tick_row[t["tick"]] = session.ticks
        tick_row[t["v"]], tick_row[t["a"]], tick_row[t["v_measured"]] = command.v, command.a, measured.v
        tick_row[t["measured_time"]] = measured.time
        tick_row[t["device_time"]] = hand[_HAND["device_time"]]
        tick_row[t["raw_p"]], tick_row[t["raw_q"]] = hand[_HAND["p"]], hand[_HAND["q"]]
        self._take_sample(tick)
        self._take_event(tick)
        if step.reason != self._reason:
            self._reason = step.reason
            state[s["reason"]] = tick_row[t["reason"]] = text_numbers(step.reason, REASON)
        self._take_objects(tick)
        ranking = step.ranking
        if ranking is not None and ranking is not self._ranking and step.time - self._ranked >= COSTS_PERIOD:
            self._ranking, self._ranked = ranking, step.time
            self._take_ranking(ranking, session.controller)
        self._take_path(tick)

    def begin_again(self) -> None:
        """Forget what was shown last: time begins again."""
        self._ranking, self._ranked = None, -np.inf

    @property
    def objects(self) -> Array:
        """Poses of the objects at the newest tick (K, 7)."""
        return self._state[self._of_state["objects"]].reshape(-1, POSE)

    def observed(self, count: int, poses: Array, q: Array) -> None:
        """Put in what the grasps in use follow from."""
        row, at = self._tick, self._of_tick
        row[at["observations"]], row[at["seen"]], row[at["seen_q"]] = count, poses.ravel(), q

    def tick_row(self, clock: float, schedule: RealTime, settings: Array) -> Array:
        """Return the row for the recorder."""
        row, at = self._tick, self._of_tick
        row[at["clock"]], row[at["late"]], row[at["lost"]] = clock, schedule.late, schedule.lost
        row[at["settings"]] = settings
        return row

    def state_row(self, schedule: RealTime, worst_late: float, settings: Array) -> Array:
        """Return the row for the page."""
        row, at = self._state, self._of_state
        row[at["late"]], row[at["worst_late"]], row[at["lost"]] = schedule.late, worst_late, schedule.lost
        row[at["late_ticks"]], row[at["settings"]] = schedule.late_ticks, settings
        return row

    def _take_sample(self, tick: Tick) -> None:
        row, at, sample = self._tick, self._of_tick, tick.sample
        row[at["sample"]] = sample is not None
        if sample is not None:
            row[at["stamp"]], row[at["trigger"]] = sample.stamp, sample.trigger
            row[at["buttons"]] = sum(_BIT[button] for button in sample.buttons)

    def _take_event(self, tick: Tick) -> None:
        event = tick.step.event
        self._tick[self._of_tick["event"]] = -1.0 if event is None else _EVENT[event]
        if event is not None:
            self._events += 1
            self._state[self._of_state["event"]] = _EVENT[event]
        self._state[self._of_state["events"]] = self._events

    def _take_objects(self, tick: Tick) -> None:
        row, start = self._state, self._of_state["objects"].start
        for k, name in enumerate(self._names):
            X = tick.objects.get(name)
            if X is not None:
                row[start + POSE * k : start + POSE * k + 3] = X.translation
                row[start + POSE * k + 3 : start + POSE * (k + 1)] = X.quaternion
        self._tick[self._of_tick["objects"]] = row[self._of_state["objects"]]

    def _take_ranking(self, ranking: Ranking, controller: SharedController) -> None:
        state, s = self._state, self._of_state
        ranks = state[s["ranks"]]
        ranks[:] = np.nan
        shown = state[s["shown"]].reshape(-1, POSE)
        shown[:] = np.nan
        selected, widths = state[s["selected"]], state[s["widths"]]
        selected[:], widths[:] = -1.0, np.nan
        for name in ranking.object_names:
            k = int(self._index.get(name, -1))
            order = ranking.of(name)
            ranks[order] = np.linspace(0.0, 1.0, len(order))
            target = ranking.target(name)
            if k >= 0 and target is not None:
                shown[k] = _numbers(target.X_WG)
                selected[k], widths[k] = target.candidate, target.opening
        best = ranking.best
        intended = -1.0 if best is None else self._index.get(best, -1.0)
        terms: Any = np.nan
        if best is not None and (chosen := ranking.chosen[best]) is not None:
            terms = [ranking.cost_of(cost)[chosen] for cost in TERMS]
            self._tick[self._of_tick["selected"]] = chosen
        for row, at in ((state, s), (self._tick, self._of_tick)):
            row[at["intended"]], row[at["terms"]] = intended, terms

    def _take_path(self, tick: Tick) -> None:
        state, s = self._state, self._of_state
        target, ranking = tick.step.target, self._ranking
        state[s["target_object"]] = -1.0 if target is None else self._index.get(target.object_name, -1.0)
        if target is None and ranking is not None:
            target = ranking.target()
        if target is None:
            state[s["path"]] = np.nan
            return
        at = s["path"].start
        state[at : at + POSE], state[at + POSE : at + 2 * POSE] = _numbers(target.X_WP), _numbers(target.X_WG)


def _numbers(X: Pose) -> Array:
    return np.concatenate([X.translation, X.quaternion])
