"""Motion recorder: of each tick as little as measures and pictures need."""

from __future__ import annotations

import numpy as np

from optsc.metrics import HandMotion, Motion
from optsc.operators import OperatorSample
from optsc.records import Tick
from optsc.robot import RobotModel


class MotionRecorder:
    """Commands, modes and hand samples of the ticks so far, at ``rate`` [Hz]."""

    def __init__(self, robot: RobotModel, rate: float) -> None:
        self.robot, self.rate = robot, rate
        self._commands: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self._modes: list[str] = []
        self._samples: list[tuple[int, OperatorSample]] = []
        self.reason = ""
        """The last reason that the controller gave, in words."""

    def __len__(self) -> int:
        return len(self._modes)

    def add(self, tick: Tick) -> None:
        """Keep one tick."""
        step, sample = tick.step, tick.sample
        if sample is not None:
            self._samples.append((len(self), sample))
        self._commands.append((step.command.q, step.command.v, step.command.a))
        self._modes.append(step.mode.value)
        self.reason = step.reason

    def first(self, count: int) -> MotionRecorder:
        """Return the first ``count`` ticks as a recorder of its own, to go on from."""
        recorder = MotionRecorder(self.robot, self.rate)
        recorder._commands, recorder._modes = self._commands[:count], self._modes[:count]
        recorder._samples = [(tick, sample) for tick, sample in self._samples if tick < count]
        return recorder

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
