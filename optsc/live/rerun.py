"""Run a recorded session again: what came in is fed to the controller, and what it commands is compared bit by bit."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from optsc.followers.protocol import FollowerState
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.live.layout import POSE
from optsc.live.loop import apply_settings
from optsc.live.observer import SeenObjects, solved
from optsc.live.run_folder import RunFolder
from optsc.live.scene import LiveScene
from optsc.live.settings_block import COLUMNS as SETTINGS
from optsc.live.settings_block import LiveSettings
from optsc.live.state_rows import BUTTONS
from optsc.operators import OperatorSample


class Rerun(NamedTuple):
    """What running again gave.

    Attributes:
        ticks: how many were run again.
        differing: at how many of them the command was not the same, to the last bit.
        missing: how many ticks the recording lacks; it is compared up to the first of them.
    """

    ticks: int
    differing: int
    missing: int


def rerun(folder: RunFolder) -> Rerun:
    """Run a recorded session again and compare; raise `DamagedFile` where it cannot be read."""
    scene = LiveScene(folder.choice)
    columns = _Columns(folder.ticks(), scene.robot.n, len(scene.names))
    settings = LiveSettings()
    controller = scene.controller(settings)
    ticks, differing, expected, observations = 0, 0, 1, 0.0
    for i in range(len(columns.tick)):
        number = int(columns.tick[i])
        before, settings = settings, LiveSettings.of_row(columns.settings[i])
        # As in the loop: settings first, then a new beginning.
        apply_settings(controller, before, settings)
        if number == 1:
            controller.reset(scene.robot.home, scene.choice.rate)
            controller.observe(*scene.start)
            expected = 1
        count, poses, q = columns.seen(i)
        if count > observations:
            controller.observe(*solved(scene, controller.selector, SeenObjects(poses, q)))
            observations = count
        if number != expected:
            return Rerun(ticks, differing, len(columns.tick) - ticks)
        step = controller.step(columns.sample(i), columns.measured(i), columns.now(i))
        command = np.concatenate([step.command.q, step.command.v, [step.opening]])
        differing += command.tobytes() != columns.command(i).tobytes()
        ticks, expected = ticks + 1, expected + 1
    return Rerun(ticks, differing, 0)


class _Columns:
    """The columns of a recording that are needed, as arrays."""

    def __init__(self, table: Any, n: int, objects: int) -> None:
        count = POSE * objects

        def of(name: str, count: int = 1) -> Array:
            labels = [name] if count == 1 else [f"{name}_{k}" for k in range(count)]
            return np.column_stack([table.column(label).to_numpy() for label in labels])

        self.tick, self.settings = of("tick")[:, 0], of("settings", SETTINGS.size)
        self._observations = np.hstack([of("observations"), of("seen", count), of("seen_q", n)])
        self._given, self._clock = of("sample")[:, 0], of("clock")[:, 0]
        self._hand = np.hstack([of("stamp"), of("raw_p", 3), of("raw_q", 4)])
        self._flags = np.hstack([of("engaged"), of("trigger"), of("buttons")])
        self._measured = [of("measured_time"), of("q_measured", n), of("v_measured", n), of("opening_measured")]
        self._command = np.hstack([of("q", n), of("v", n), of("opening")])

    def seen(self, i: int) -> tuple[float, Array, Array]:
        row, n = self._observations[i], self._measured[1].shape[1]
        return float(row[0]), row[1:-n].reshape(-1, POSE), row[-n:].copy()

    def sample(self, i: int) -> OperatorSample | None:
        if not self._given[i]:
            return None
        hand, (engaged, trigger, bits) = self._hand[i], self._flags[i]
        buttons = frozenset(button for k, button in enumerate(BUTTONS) if int(bits) >> k & 1)
        return OperatorSample(float(hand[0]), Pose(hand[4:], hand[1:4]), bool(engaged), bool(trigger), buttons)

    def now(self, i: int) -> float:
        return float(self._clock[i])

    def measured(self, i: int) -> FollowerState:
        time, q, v, opening = (part[i] for part in self._measured)
        return FollowerState(float(time[0]), q.copy(), v.copy(), float(opening[0]))

    def command(self, i: int) -> Array:
        return self._command[i]
