"""What a run leaves behind: one tick, one run, and the file they go to."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from optsc.control.controller import ControlStep
from optsc.control.modes import Mode
from optsc.errors import DamagedFile
from optsc.followers.protocol import FollowerState
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates
from optsc.operators import OperatorSample
from optsc.operators.sample import Button
from optsc.selection import Ranking
from optsc.selection.reach import ClearRows, ReachTable

FORMAT = 3
"""Version of the file format; a newer one is refused."""


class Tick(NamedTuple):
    """One control tick: what came in, what the controller decided, and what it cost.

    The order within a tick: `measured` is read, then `sample`, then the decision is made and sent.

    Attributes:
        sample: the operator's sample, None where there was no new one.
        measured: the follower's state before the command.
        step: the controller's decision.
        objects: true poses of the objects, where the follower knows them.
        elapsed: time that the controller took [s].
        now: what time the loop said it was [s]; None where it said nothing.
    """

    sample: OperatorSample | None
    measured: FollowerState
    step: ControlStep
    objects: Mapping[str, Pose]
    elapsed: float
    now: float | None = None

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self.step.time

    @property
    def mode(self) -> Mode:
        """The control mode."""
        return self.step.mode

    @property
    def ranking(self) -> Ranking | None:
        """The newest ranking of the candidate grasps."""
        return self.step.ranking


class SceneUpdate(NamedTuple):
    """What the controller is told when the scene has changed.

    Attributes:
        candidates: the grasps of the scene as it is now.
        clear: which of them the arm can execute without collision, see `optsc.collision.GraspClearance`.
    """

    candidates: Candidates
    clear: ClearRows | None = None


class SolvedUpdate(NamedTuple):
    """The same with the reach table of the grasps, solved elsewhere, in another process for one."""

    candidates: Candidates
    clear: ClearRows | None
    table: ReachTable


@dataclass(frozen=True, eq=False)
class Run:
    """All ticks of a run, in order, and what determines them.

    Attributes:
        rate: control rate [Hz].
        ticks: the ticks.
        about: robot, start configuration and whatever else the caller wants to keep; JSON values only.
        updates: what the controller was told of the scene during the run, by the index of the tick before which it was.
    """

    rate: float
    ticks: Sequence[Tick]
    about: Mapping[str, Any] = field(default_factory=dict)
    updates: Mapping[int, SceneUpdate | SolvedUpdate] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.ticks)

    def __getitem__(self, index: int) -> Tick:
        return self.ticks[index]

    def __iter__(self) -> Iterator[Tick]:
        return iter(self.ticks)

    @cached_property
    def times(self) -> Array:
        """Times (T,) [s]."""
        return np.array([tick.time for tick in self.ticks])

    @cached_property
    def q(self) -> Array:
        """Commanded joint positions (T, n) [rad]."""
        return np.array([tick.step.command.q for tick in self.ticks])

    @cached_property
    def v(self) -> Array:
        """Commanded joint velocities (T, n) [rad/s]."""
        return np.array([tick.step.command.v for tick in self.ticks])

    @cached_property
    def a(self) -> Array:
        """Commanded joint accelerations (T, n) [rad/s^2]."""
        return np.array([tick.step.command.a for tick in self.ticks])

    @cached_property
    def commands(self) -> Array:
        """Commanded motion (T, 3 n + 1): positions, velocities, accelerations, opening of the jaws."""
        opening = np.array([[tick.step.opening] for tick in self.ticks])
        return np.hstack([self.q, self.v, self.a, opening])

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """The mode of each tick."""
        return tuple(tick.mode for tick in self.ticks)

    def switches(self) -> list[int]:
        """Return the indices of the first ticks of a new mode."""
        return [i for i in range(1, len(self)) if self.modes[i] is not self.modes[i - 1]]

    def save(self, path: str | Path) -> None:
        """Write inputs and commands to one ``.npz`` file, from which `load_inputs` reads them back."""
        measured = np.array([[*t.measured.q, *t.measured.v, t.measured.opening, t.measured.time] for t in self.ticks])
        arrays = {
            "samples": np.array([_sample_row(tick.sample) for tick in self.ticks]),
            "measured": measured,
            "commands": self.commands,
            "now": np.array([np.nan if tick.now is None else tick.now for tick in self.ticks]),
            "buttons": np.array([button.name for button in _BUTTONS]),
            "modes": np.array([mode.value for mode in self.modes]),
            "about": np.array(json.dumps({"format": FORMAT, "rate": self.rate, **self.about}, sort_keys=True)),
        }
        with open(path, "wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)


_BUTTONS = tuple(Button)
_OLD_BUTTONS = ("CONFIRM", "CANCEL", "NEXT", "VETO", "NUDGE")
"""What the columns are in files that do not say it."""
_POSE_COLUMNS = ("stamp", "x", "y", "z", "qw", "qx", "qy", "qz", "clutch", "trigger")
_COLUMNS = len(_POSE_COLUMNS) + len(_BUTTONS) + 1 + 6 + 1  # whether there is a nudge, the nudge, lost
_REFUSED = (*(np.nan,) * 8, *(0.0,) * (_COLUMNS - 8))
"""Stands for what is no sample: it is refused, too."""


def _sample_row(sample: OperatorSample | None) -> list[float]:
    if sample is None:
        return [np.nan] * _COLUMNS
    try:
        X, lost = sample.X_SH, float(sample.lost)
        pressed = [float(button in sample.buttons) for button in _BUTTONS]
        nudge = [0.0] * 7 if sample.nudge is None else [1.0, *sample.nudge]
        flags = (float(sample.clutch), float(sample.trigger))
        row = np.array([sample.stamp, *X.translation, *X.quaternion, *flags, *pressed, *nudge, lost], dtype=float)
    except Exception:  # noqa: BLE001 - whatever a device hands in for a sample, the run can be saved
        return list(_REFUSED)
    return row.tolist() if len(row) == _COLUMNS else list(_REFUSED)


class RunInputs(NamedTuple):
    """What has to be fed to a controller to see the same run again, and the commands that it then gave.

    Attributes:
        about: what determines the run; holds ``rate`` [Hz].
        samples: the operator's sample or None, per tick.
        measured: the follower's state, per tick.
        commands: as `Run.commands`.
        now: what time the loop said it was [s], per tick; None where it said nothing.
    """

    about: Mapping[str, Any]
    samples: tuple[OperatorSample | None, ...]
    measured: tuple[FollowerState, ...]
    commands: Array
    now: tuple[float | None, ...] = ()


def load_inputs(path: str | Path) -> RunInputs:
    """Read what `Run.save` wrote; raise `DamagedFile`."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in ("samples", "measured", "commands", "about")}
            now = file["now"] if "now" in file else np.full(len(arrays["samples"]), np.nan)
            buttons = [Button[name] for name in (file["buttons"].tolist() if "buttons" in file else _OLD_BUTTONS)]
        about = json.loads(str(arrays["about"]))
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise DamagedFile(path, f"is no recorded run ({error})") from None
    if about.get("format", 0) > FORMAT:
        raise DamagedFile(path, f"has format {about['format']}, and this version reads up to {FORMAT}")
    n = (arrays["commands"].shape[1] - 1) // 3
    measured = tuple(FollowerState(row[-1], row[:n], row[n : 2 * n], row[-2]) for row in arrays["measured"])
    samples = tuple(_sample(row, buttons) for row in arrays["samples"])
    said = tuple(None if np.isnan(time) else time for time in now.tolist())
    return RunInputs(about, samples, measured, arrays["commands"], said)


def _sample(row: Array, columns: Sequence[Button]) -> OperatorSample | None:
    # A missing sample has no clutch; a bad one may have a stamp or a pose that is not a number.
    if np.isnan(row[8]):
        return None
    X_SH, clutch, trigger = Pose(row[4:8], row[1:4]), bool(row[8]), bool(row[9])
    # In the first version of the format a row ends here.
    buttons = frozenset(button for button, held in zip(columns, row[len(_POSE_COLUMNS) :], strict=False) if held)
    at = len(_POSE_COLUMNS) + len(columns)
    nudge = tuple(row[at + 1 : at + 7].tolist()) if len(row) > at and row[at] else None
    # In the second version there is no column for it.
    lost = len(row) > at + 7 and bool(row[at + 7])
    return OperatorSample(float(row[0]), X_SH, clutch, trigger, buttons, nudge, lost)
