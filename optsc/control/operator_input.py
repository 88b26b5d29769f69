"""Operator input: one sample in, checked, its stamp on the loop's clock, and what is new in it."""

from __future__ import annotations

from typing import NamedTuple

from optsc.control.modes import Event
from optsc.operators import Button, OperatorSample, fault_of
from optsc.operators.clock import ClockMapping, Refusal, number
from optsc.operators.clutch import Hand
from optsc.operators.input_counts import InputCounts
from optsc.operators.sample import Nudge

LOST = "the operator's device says that it no longer tracks the hand"


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
    nudge: Nudge | None = None


NOTHING = OperatorInput()
NO_BUTTONS: frozenset[Button] = frozenset()


class InputMonitor(NamedTuple):
    """The operator's last usable sample, to tell what changes with the next, and what could not be used.

    Attributes:
        hand: where it was, and when on the loop's clock; None before the first sample and while the device has lost it.
        clutch: whether it was coupled to the arm.
        trigger: whether the trigger was held.
        buttons: what was held down.
        arrived: when it arrived [s]; None before the first.
        clock: of the device.
        counts: samples that could not be used.
    """

    hand: Hand | None = None
    clutch: bool = False
    trigger: bool = False
    buttons: frozenset[Button] = frozenset()
    arrived: float | None = None
    clock: ClockMapping = ClockMapping()
    counts: InputCounts = InputCounts()

    def silence(self, time: float, timeout: float) -> str:
        """Return that there were usable samples before and none for ``timeout`` [s], in words; empty otherwise."""
        if self.arrived is None or time - self.arrived <= timeout:
            return ""
        lately = self.counts.lately
        return f"the operator's samples have stopped{lately and ': '}{lately}"

    def read(
        self, sample: OperatorSample | None, time: float, zero: float | None
    ) -> tuple[InputMonitor, OperatorInput]:
        """Return the monitor after a sample, and what is new in it; one that cannot be used is skipped and counted.

        Args:
            sample: as it came, if one did.
            time: now [s].
            zero: of the clock that the loop tells, if it does, see `ClockMapping.read`.
        """
        if sample is None:
            return self, NOTHING
        fault = fault_of(sample)
        if fault:
            counts = self.counts.refusing(fault)
            return self._replace(counts=counts), OperatorInput(None, f"an operator sample was refused: {fault}")
        if sample.lost:
            return self._replace(hand=None), OperatorInput(Event.FAULT, LOST)
        clock, stamp, refusal = self.clock.read(sample.stamp, time, zero)
        counts = self.counts.using() if stamp is not None else self.counts.skipping(refusal, sample.stamp)
        if stamp is None and refusal is not Refusal.DUPLICATE:
            return self._replace(clock=clock, counts=counts), NOTHING
        clutch, trigger = bool(sample.clutch), bool(sample.trigger)
        engaged, triggered = clutch and not self.clutch, trigger and not self.trigger
        # A set of its own: the operator may go on writing into the sample's.
        buttons = NO_BUTTONS if not sample.buttons else frozenset(b for b in sample.buttons if isinstance(b, Button))
        pressed = buttons - self.buttons
        event = Event.TRIGGERED if triggered else Event.ENGAGED if engaged else None
        if stamp is None:
            # The hand has not been seen again, which is no sign of life; what is pressed may be new all the same.
            after = InputMonitor(self.hand, clutch, trigger, buttons, self.arrived, clock, counts)
            return after, OperatorInput(event, engaged=engaged, pressed=pressed)
        hand = Hand(tuple(sample.X_SH.translation.tolist()), tuple(sample.X_SH.quaternion.tolist()), stamp)
        after = InputMonitor(hand, clutch, trigger, buttons, time, clock, counts)
        return after, OperatorInput(event, "", True, engaged, pressed, self.hand, _nudge(sample))


def _nudge(sample: OperatorSample) -> Nudge | None:
    if sample.nudge is None:
        return None
    x, y, z, a, b, c = (number(part) for part in sample.nudge)
    return x, y, z, a, b, c
