"""Operator input: one sample in, checked, and what is new in it."""

from __future__ import annotations

from typing import NamedTuple

from optsc.control.modes import Event
from optsc.operators import Button, OperatorSample, fault_of
from optsc.operators.clutch import Hand


class OperatorInput(NamedTuple):
    """What a tick brought from the operator.

    Attributes:
        event: what happened, if anything; a press of the trigger is `Event.TRIGGERED` whatever it will mean.
        reason: what is wrong, in words.
        new: whether a good sample has come.
        engaged: whether the clutch was closed, also where the trigger was pressed with it.
        pressed: buttons that went down.
        moved_from: the hand at the sample before, where this one and that are good.
        nudge: as in the sample.
    """

    event: Event | None = None
    reason: str = ""
    new: bool = False
    engaged: bool = False
    pressed: frozenset[Button] = frozenset()
    moved_from: Hand | None = None
    nudge: tuple[float, float, float, float, float, float] | None = None


NOTHING = OperatorInput()


class InputMonitor(NamedTuple):
    """The operator's last good sample, to tell what changes with the next.

    Attributes:
        hand: where it was; None before the first sample.
        clutch: whether it was coupled to the arm.
        trigger: whether the trigger was held.
        buttons: what was held down.
        stamp: when that was [s].
    """

    hand: Hand | None = None
    clutch: bool = False
    trigger: bool = False
    buttons: frozenset[Button] = frozenset()
    stamp: float | None = None

    def silent(self, time: float, timeout: float) -> bool:
        """Tell whether there were samples before, and none for ``timeout`` [s]."""
        return self.stamp is not None and time - self.stamp > timeout

    def read(self, sample: OperatorSample | None) -> tuple[InputMonitor, OperatorInput]:
        """Return the monitor after a sample, and what is new in it; a sample that is refused changes nothing."""
        if sample is None:
            return self, NOTHING
        fault = fault_of(sample, self.stamp)
        if fault:
            return self, OperatorInput(Event.FAULT, f"operator sample refused: {fault}")
        engaged, triggered = sample.clutch and not self.clutch, sample.trigger and not self.trigger
        p, q = sample.X_SH.translation.tolist(), sample.X_SH.quaternion.tolist()
        hand = Hand(tuple(p), tuple(q), float(sample.stamp))
        buttons = frozenset(sample.buttons)  # the operator may go on writing into its own set
        after = InputMonitor(hand, bool(sample.clutch), bool(sample.trigger), buttons, float(sample.stamp))
        event = Event.TRIGGERED if triggered else Event.ENGAGED if engaged else None
        return after, OperatorInput(event, "", True, engaged, buttons - self.buttons, self.hand, sample.nudge)
