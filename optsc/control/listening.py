"""Reading the operator: one sample in, checked, and what is new in it."""

from __future__ import annotations

from typing import NamedTuple

from optsc.control.modes import Event
from optsc.operators import Button, OperatorSample, fault_of
from optsc.operators.clutch import Hand


class Heard(NamedTuple):
    """What a tick brought from the operator.

    Attributes:
        event: what happened, if anything; a press of the trigger is `Event.TRIGGERED` whatever it will mean.
        reason: what is wrong, in words.
        new: whether a good sample has come.
        pressed: buttons that went down.
        moved_from: the hand at the sample before, where this one and that are good.
        nudge: as in the sample.
    """

    event: Event | None = None
    reason: str = ""
    new: bool = False
    pressed: frozenset[Button] = frozenset()
    moved_from: Hand | None = None
    nudge: tuple[float, float, float, float, float, float] | None = None


NOTHING = Heard()


class Listener:
    """Remembers the operator's last sample, to tell what changed.

    Attributes:
        hand: the last good one, None before.
        clutch: whether it was coupled to the arm.
        buttons: what was held down.
        stamp: when that was [s].
    """

    def __init__(self) -> None:
        self.hand: Hand | None = None
        self.clutch = False
        self.buttons: frozenset[Button] = frozenset()
        self.stamp: float | None = None
        self._trigger = False

    def silent(self, time: float, timeout: float) -> bool:
        """Tell whether the operator was heard before, and not for ``timeout`` [s]."""
        return self.stamp is not None and time - self.stamp > timeout

    def hear(self, sample: OperatorSample | None) -> Heard:
        """Take in what came at this tick; never raises."""
        if sample is None:
            return NOTHING
        fault = fault_of(sample, self.stamp)
        if fault:
            return Heard(Event.FAULT, f"operator sample refused: {fault}")
        engaged, triggered = sample.clutch and not self.clutch, sample.trigger and not self._trigger
        pressed, before = sample.buttons - self.buttons, self.hand
        self.clutch, self._trigger = bool(sample.clutch), bool(sample.trigger)
        self.buttons, self.stamp = sample.buttons, sample.stamp
        p, q = sample.X_SH.translation.tolist(), sample.X_SH.quaternion.tolist()
        self.hand = Hand(tuple(p), tuple(q), sample.stamp)
        event = Event.TRIGGERED if triggered else Event.ENGAGED if engaged else None
        return Heard(event, "", True, pressed, before, sample.nudge)
