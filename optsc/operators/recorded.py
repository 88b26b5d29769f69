"""Hand recordings: read from a file, scaled, and played back in place of a person."""

from __future__ import annotations

import csv
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import ArrayOf, Below, Checked, Finite, Positive, require
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.operators.sample import DEVICE_UNIT_TOLERANCE, OperatorSample, OperatorView

COLUMNS = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
"""Columns of a recording: time [s], position of the hand in S [m], unit quaternion."""
SWITCHES = ("clutch", "trigger")
"""Columns that a recording may have beside them, 0 or 1."""


@dataclass(frozen=True, eq=False)
class HandRecording(Checked):
    """The motion of a hand.

    Attributes:
        time: when each sample was taken (N,) [s], increasing.
        X_SH: the hand in the station frame (N,).
        clutch: whether the hand was coupled to the arm (N,).
        trigger: whether the trigger was pressed (N,).
    """

    time: Annotated[Array, ArrayOf("N", least=1), Finite]
    X_SH: Pose
    clutch: Annotated[np.ndarray, ArrayOf("N", dtype=bool)]
    trigger: Annotated[np.ndarray, ArrayOf("N", dtype=bool)]

    def __post_init__(self) -> None:
        super().__post_init__()
        steps = np.diff(self.time)
        if np.any(steps <= 0.0):
            row = int(np.argmax(steps <= 0.0)) + 1
            raise InvalidValue(f"time of sample {row}", float(self.time[row]), f"above {self.time[row - 1]} s")
        if self.X_SH.shape != self.time.shape:
            raise InvalidValue("HandRecording.X_SH", self.X_SH.shape, f"shape {self.time.shape}, as time")

    @classmethod
    def from_array(
        cls, samples: ArrayLike, clutch: ArrayLike | None = None, trigger: ArrayLike | None = None
    ) -> HandRecording:
        """Return the recording of ``samples`` (N, 8), ordered as `COLUMNS`; raise `InvalidValue`.

        Without ``clutch`` (N,) the hand is coupled throughout, without ``trigger`` (N,) it is never pressed.
        """
        table = np.asarray(samples, dtype=float)
        if table.ndim != 2 or table.shape[1] != len(COLUMNS):
            raise InvalidValue("samples", table.shape, f"shape (N, 8), ordered {', '.join(COLUMNS)}")
        if not np.all(np.isfinite(table)):
            row = int(np.argmin(np.all(np.isfinite(table), axis=1)))
            raise InvalidValue(f"sample {row}", table[row].tolist(), "finite")
        norm = np.linalg.norm(table[:, 4:], axis=1)
        if np.any(np.abs(norm - 1.0) > DEVICE_UNIT_TOLERANCE):
            row = int(np.argmax(np.abs(norm - 1.0)))
            raise InvalidValue(f"quaternion of sample {row}", table[row, 4:].tolist(), "of unit norm within 1e-3")
        return cls(
            time=table[:, 0],
            X_SH=Pose(table[:, 4:] / norm[:, None], table[:, 1:4]),
            clutch=np.ones(len(table), dtype=bool) if clutch is None else np.asarray(clutch, dtype=bool),
            trigger=np.zeros(len(table), dtype=bool) if trigger is None else np.asarray(trigger, dtype=bool),
        )

    @classmethod
    def example(cls) -> HandRecording:
        """Return the recording that comes along: a quick hand for 40 s at 50 Hz; see README.md in optsc/data.

        It reaches and turns further than an arm on a table does: scale it with `scaled`.
        """
        with as_file(files("optsc") / "data" / "hand_reach.csv") as path:
            return cls.from_csv(path)

    @classmethod
    def from_csv(cls, path: str | Path) -> HandRecording:
        """Return the recording in a CSV file with a header naming `COLUMNS`, and `SWITCHES` if it has them.

        Raises `DamagedFile` when it cannot be read as one, and OSError when there is no such file.
        """
        try:
            with open(path, newline="", encoding="utf-8") as file:
                rows = [row for row in csv.reader(file) if row]
        except (UnicodeDecodeError, csv.Error) as error:
            raise DamagedFile(path, f"not a CSV text file ({error})") from error
        header = [name.strip() for name in rows[0]] if rows else []
        missing = [name for name in COLUMNS if name not in header]
        if missing:
            raise DamagedFile(path, f"no column named {', '.join(missing)}; the header is {header}")
        try:
            table = np.array([_numbers(row, len(header)) for row in rows[1:]]).reshape(-1, len(header))
            by_name = dict(zip(header, table.T, strict=True))
            switches = {name: by_name[name] != 0.0 for name in SWITCHES if name in by_name}
            return cls.from_array(np.column_stack([by_name[name] for name in COLUMNS]), **switches)
        except ValueError as error:
            raise DamagedFile(path, str(error)) from error

    def __len__(self) -> int:
        return len(self.time)

    @property
    def duration(self) -> float:
        """From the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    def scaled(self, position_scale: float = 1.0, rotation_scale: float = 1.0) -> HandRecording:
        """Return the motion made smaller or larger about its first pose, as a clutch with a scale does.

        Rotations are scaled from sample to sample and composed: scaling the whole rotation from the first
        sample would jump where that passes half a turn.
        """
        p, q = self.X_SH.translation, self.X_SH.quaternion
        steps = rotation.exp(rotation_scale * rotation.log(rotation.multiply(q[1:], rotation.conjugate(q[:-1]))))
        turned = [q[0]]
        for step in steps:
            turned.append(rotation.multiply(step, turned[-1]))
        scaled = np.array(turned)
        scaled /= np.linalg.norm(scaled, axis=1, keepdims=True)
        return HandRecording(self.time, Pose(scaled, p[0] + position_scale * (p - p[0])), self.clutch, self.trigger)


def _numbers(row: Sequence[str], count: int) -> list[float]:
    if len(row) != count:
        raise ValueError(f"row {row} has {len(row)} entries, the header {count}")
    return [float(entry) for entry in row]


class Recorded:
    """An `Operator` that plays a recording from the first view on, whatever it is shown.

    After the last sample there are no more, as from a device that fell silent.

    Args:
        recording: the hand's motion.
        reengage_every: open the clutch this often [s]; None: as recorded.
        release: for how long it is open [s].

    Raises `InvalidValue` unless 0 < release < reengage_every.
    """

    def __init__(self, recording: HandRecording, reengage_every: float | None = None, release: float = 0.1) -> None:
        if reengage_every is not None:
            require("reengage_every", reengage_every, Positive)
            require("release", release, Positive, Below(reengage_every))
        self.recording = recording
        self._time: list[float] = (recording.time - recording.time[0]).tolist()
        self._every, self._release = reengage_every, release
        self._start: float | None = None
        self._last = -1

    @property
    def finished(self) -> bool:
        """Whether the last sample has been read."""
        return self._last == len(self._time) - 1

    def read(self, view: OperatorView) -> OperatorSample | None:
        """Return the newest sample whose time has come since the last call, else None."""
        if self._start is None:
            self._start = view.time
        # A nanosecond absorbs the rounding of a clock that adds up its ticks.
        newest = bisect_right(self._time, view.time - self._start + 1e-9, lo=self._last + 1) - 1
        if newest <= self._last:
            return None
        self._last = newest
        time = self._time[newest]
        clutch = bool(self.recording.clutch[newest]) and not self._released(time)
        trigger = bool(self.recording.trigger[newest])
        return OperatorSample(self._start + time, self.recording.X_SH[newest], clutch, trigger)

    def _released(self, time: float) -> bool:
        if self._every is None:
            return False
        stretch, within = divmod(time + 1e-9, self._every)
        return stretch >= 1.0 and within < self._release
