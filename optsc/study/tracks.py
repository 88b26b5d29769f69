"""What an engine writes down at each tick: as little as measures and pictures need."""

from __future__ import annotations

import numpy as np

from optsc.control.controller import ControlStep
from optsc.metrics import HandMotion, Motion
from optsc.operators import OperatorSample
from optsc.robot import RobotModel


class Track:
    """Commands, modes and hand samples of the ticks so far, at ``rate`` [Hz]."""

    def __init__(self, robot: RobotModel, rate: float) -> None:
        self.robot, self.rate = robot, rate
        self._commands: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self._modes: list[str] = []
        self._samples: list[tuple[int, OperatorSample]] = []
        self.reason = ""
        """What the controller said last, in words."""

    def __len__(self) -> int:
        return len(self._modes)

    def add(self, step: ControlStep, sample: OperatorSample | None) -> None:
        """Write down one tick."""
        if sample is not None:
            self._samples.append((len(self), sample))
        self._commands.append((step.command.q, step.command.v, step.command.a))
        self._modes.append(step.mode.value)
        self.reason = step.reason

    def first(self, count: int) -> Track:
        """Return the first ``count`` ticks as a track of its own, to go on from."""
        track = Track(self.robot, self.rate)
        track._commands, track._modes = self._commands[:count], self._modes[:count]
        track._samples = [(tick, sample) for tick, sample in self._samples if tick < count]
        return track

    def motion(self) -> Motion:
        """Return everything as the arrays that measures are taken from."""
        n = self.robot.n
        q, v, a = (np.array([row[k] for row in self._commands]).reshape(-1, n) for k in range(3))
        samples = [sample for _, sample in self._samples]
        hand = HandMotion(
            np.array([sample.stamp for sample in samples]),
            np.array([sample.X_SH.translation for sample in samples]).reshape(-1, 3),
        )
        return Motion.of_commands(self.robot, self.rate, self._modes, (q, v, a), hand)
