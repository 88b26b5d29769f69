"""Hand mailbox: the newest sample of the operator's hand from another process, with presses that are counted.

A pose that was overtaken is of no interest to anybody, but a short press that was overtaken with it would be lost. So
the mailbox holds the newest pose beside a count of presses of each button, and the reader hands in as many presses as
the counts have gone up, one after the other.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.live.columns import Columns
from optsc.live.shared_block import SharedBlock, SharedSegment
from optsc.operators import OperatorSample, OperatorView
from optsc.operators.sample import Button

TRIGGER = "TRIGGER"
BUTTONS = tuple(Button)
PRESSABLE = (TRIGGER, *(button.name for button in BUTTONS))
"""What can be pressed, in the order of the counts."""
MOST_PENDING = 8
"""Presses of one button that are handed in after each other, at most: more of them come from no finger."""

COLUMNS = Columns({"arrival": 1, "device_time": 1, "p": 3, "q": 4, "engaged": 1, "presses": len(PRESSABLE)})
_ARRIVAL, _ENGAGED, _PRESSES = COLUMNS.at("arrival"), COLUMNS.at("engaged"), COLUMNS["presses"]


class HandReading(NamedTuple):
    """One reading of a device.

    Attributes:
        arrival: when it arrived on this machine, or would have without the delay that it is known to have had, on the
            clock of `time.perf_counter` [s].
        p, q: position [m] and unit quaternion (w, x, y, z) of the hand in the station.
        engaged: whether the hand is coupled to the arm.
        pressed: what was pressed since the reading before, by the names of `PRESSABLE`, each as often as it was.
        device_time: on the device's own clock [s]; NaN where it has none.
    """

    arrival: float
    p: Sequence[float]
    q: Sequence[float]
    engaged: bool
    pressed: Iterable[str] = ()
    device_time: float = float("nan")


class HandWriter:
    """The mailbox as the process with the device has it; there may be only one.

    Args:
        block: of `COLUMNS`, with zeros or what an earlier writer left there.
    """

    def __init__(self, block: SharedBlock) -> None:
        self._block, self._row = block, np.zeros(COLUMNS.size)
        block.read(self._row)  # a writer that takes the place of one that died goes on counting from there

    @staticmethod
    def block(segment: SharedSegment) -> SharedBlock:
        """Return the next block of ``segment`` as one for a hand."""
        return SharedBlock(segment, COLUMNS.size)

    def post(self, reading: HandReading) -> None:
        """Put in a reading in place of the last; its presses are added to those that are not read yet."""
        row = self._row
        row[_ARRIVAL], row[COLUMNS.at("device_time")] = reading.arrival, reading.device_time
        row[COLUMNS["p"]], row[COLUMNS["q"]], row[_ENGAGED] = reading.p, reading.q, reading.engaged
        for name in reading.pressed:
            row[_PRESSES.start + PRESSABLE.index(name)] += 1.0
        self._block.write(row)

    def let_go(self) -> None:
        """Open the clutch without a new reading: whoever was there is gone, or not looking any more."""
        if self._block.count:
            self._row[_ENGAGED] = 0.0
            self._block.write(self._row)


class HandReader:
    """The mailbox as an `Operator` of the control process; its stamps are arrivals, on `time.perf_counter`.

    Taking hold of the arm while the robot moves by itself is how a person steps in: the sample then carries
    `Button.CANCEL` too, so that the same motion gives control back and leads on.

    Attributes:
        row: the newest reading as a row of `COLUMNS`.
    """

    def __init__(self, block: SharedBlock) -> None:
        self._block, self.row = block, np.zeros(COLUMNS.size)
        self._copy = np.zeros(COLUMNS.size)
        self._seen = 0
        self._pending = np.zeros(len(PRESSABLE))
        self._down = np.zeros(len(PRESSABLE), dtype=bool)
        self._engaged = False
        if block.read(self._copy):
            # What was pressed before anybody listened is not for this run.
            self.row[_PRESSES] = self._copy[_PRESSES]

    def read(self, view: OperatorView) -> OperatorSample | None:
        """Return the newest sample, or a repeated one with the next press; None where there is nothing new."""
        new = self._taken()
        going_on = self._down.any() or self._pending.any()
        if not new and not going_on:
            return None
        # A press is an edge: what was down at the last sample has to come up before it goes down again.
        self._down = ~self._down & (self._pending > 0.0)
        self._pending -= self._down
        buttons = {button for button, down in zip(BUTTONS, self._down[1:].tolist(), strict=True) if down}
        engaged = self.row[_ENGAGED] != 0.0
        if engaged and not self._engaged and view.automatic:
            buttons.add(Button.CANCEL)
        self._engaged = engaged
        X_SH = Pose(self.row[COLUMNS["q"]].copy(), self.row[COLUMNS["p"]].copy())
        return OperatorSample(float(self.row[_ARRIVAL]), X_SH, engaged, bool(self._down[0]), frozenset(buttons))

    def _taken(self) -> bool:
        if self._block.count == self._seen:
            return False
        seen = self._block.count
        if not self._block.read(self._copy):
            return False
        self._seen = seen
        more = self._copy[_PRESSES] - self.row[_PRESSES]
        self._pending = np.minimum(self._pending + np.maximum(more, 0.0), MOST_PENDING)
        self.row[:] = self._copy
        return True


def age(row: Array) -> float:
    """Return how long ago a reading, as a row of `COLUMNS`, arrived [s]."""
    return time.perf_counter() - float(row[_ARRIVAL])
