"""Putting an object down, as a simulated person does who has nothing but a hand and a trigger.

The hand turns as the tool is, takes the arm over, brings the object above its place, and has the robot put it down.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.operators.sample import OperatorView
from optsc.people.motor import Movement
from optsc.people.parameters import HumanParameters

_MOST_PRESSES = 4


class PlacingStage(Enum):
    """How far the person has come."""

    ALIGN = "turning the hand as the tool is"
    TAKE = "pressing the trigger to take over"
    BRING = "bringing the object above its place"
    HAND_OVER = "pressing the trigger to have it put down"
    WATCH = "watching it being put down"
    DONE = "the object is put down, or lost"


class PuttingDown(NamedTuple):
    """A person who puts down what the arm carries: a value, one of the next sample follows from `after`.

    Attributes:
        place: x, y in W to bring it to [m]; None for where the tool is.
        R_SW: orientation of the world in the station.
        human: motor habits.
        stage, since: what is being done, and since when [s].
        movement: of the hand in this stage.
        origin: x, y of the tool where the object was carried to by the robot [m]: from there it can be put down again.
        began: whether the robot has been seen to put it down.
        presses: how often that was asked for.
    """

    place: tuple[float, float] | None
    R_SW: Array
    human: HumanParameters
    stage: PlacingStage
    since: float
    movement: Movement | None = None
    origin: tuple[float, float] | None = None
    began: bool = False
    presses: int = 0

    @property
    def trigger(self) -> bool:
        """Whether the trigger is pressed."""
        return self.stage in (PlacingStage.TAKE, PlacingStage.HAND_OVER)

    @property
    def done(self) -> bool:
        """Whether there is nothing left to put down."""
        return self.stage is PlacingStage.DONE

    def after(self, time: float, view: OperatorView, X_SH: Pose) -> PuttingDown:
        """Return what is done one sample later, at ``time`` [s], with the hand at ``X_SH``."""
        waited, human = time - self.since, self.human
        rested = self.movement is None or time >= self.movement.end + human.reaction
        match self.stage:
            case PlacingStage.ALIGN if self.movement is None:
                x, y, _ = view.X_WT.translation.tolist()
                return self._replace(movement=self._alignment(time + human.reaction, view, X_SH), origin=(x, y))
            case PlacingStage.ALIGN if rested:
                return self._at(PlacingStage.TAKE, time)
            case PlacingStage.TAKE if waited >= human.press:
                return self._at(PlacingStage.BRING, time)
            case PlacingStage.BRING if view.automatic and waited >= human.retrigger:
                return self._at(PlacingStage.TAKE, time)
            case PlacingStage.BRING if self.movement is None and waited >= human.reaction and not view.automatic:
                return self._replace(movement=self._carriage(time, view))
            case PlacingStage.BRING if self.movement is not None and rested and waited >= human.retrigger:
                return self._at(PlacingStage.HAND_OVER, time)._replace(began=False, presses=self.presses + 1)
            case PlacingStage.HAND_OVER | PlacingStage.WATCH if view.automatic and not self.began:
                return self._replace(began=True)
            case PlacingStage.HAND_OVER if waited >= human.press:
                return self._at(PlacingStage.WATCH, time)
            case PlacingStage.WATCH:
                return self._watched(time, waited, view)
        return self

    def _at(self, stage: PlacingStage, time: float) -> PuttingDown:
        return self._replace(stage=stage, since=time, movement=None)

    def _watched(self, time: float, waited: float, view: OperatorView) -> PuttingDown:
        if view.automatic or waited < self.human.retrigger:
            return self
        if view.held is None or view.halted or self.presses >= _MOST_PRESSES:
            return self._at(PlacingStage.DONE, time)
        # Where it cannot be put down it is brought back to where it came from.
        return self._at(PlacingStage.BRING, time)._replace(place=self.origin, began=False)

    def _alignment(self, start: float, view: OperatorView, X_SH: Pose) -> Movement:
        R_SH = rotation.multiply(self.R_SW, view.X_WT.quaternion)
        turn = rotation.log(rotation.multiply(R_SH, rotation.conjugate(X_SH.quaternion)))
        return Movement.towards(start, np.zeros(3), turn, self.human)

    def _carriage(self, start: float, view: OperatorView) -> Movement:
        x, y, _ = view.X_WT.translation
        to_x, to_y = (x, y) if self.place is None else self.place
        shift = rotation.rotate(self.R_SW, [to_x - x, to_y - y, 0.0])
        return Movement.towards(start, shift, np.zeros(3), self.human)
