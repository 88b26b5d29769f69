"""The control modes and their one transition table.

`docs/state-machine.md` is generated from this table, and a test holds the two equal.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType


class Mode(Enum):
    """What the controller is doing."""

    HOLD = "hold"
    MANUAL = "manual"
    APPROACH = "approach"
    ADJUST = "adjust"
    ADVANCE = "advance"
    CLOSE = "close"
    LIFT = "lift"
    CARRY = "carry"
    PLACE = "place"
    RELEASE = "release"
    RETREAT = "retreat"

    @property
    def automatic(self) -> bool:
        """Whether the robot moves by itself."""
        return self not in (Mode.HOLD, Mode.MANUAL)


class Event(Enum):
    """What can end a mode."""

    ENGAGED = "the operator closes the clutch"
    TRIGGERED = "the operator presses the trigger"
    GRASPED = "the operator presses the trigger, which closes the jaws here"
    BEGUN = "the robot begins by itself"
    CANCELLED = "the operator cancels"
    RETARGETED = "the operator takes another grasp"
    WAITED = "the pre-grasp is reached, and the operator has the last word"
    CONFIRMED = "the operator confirms"
    ARRIVED = "the end of the path is reached"
    HELD = "the jaws hold the object"
    EMPTY = "the jaws have closed on nothing"
    TOO_WIDE = "something wider than the grasp has stopped the jaws"
    SLIPPED = "what the jaws hold slips"
    LOST = "what the jaws held is gone"
    RELEASED = "the operator opens the jaws here"
    PUT_DOWN = "the operator has the robot put down what the jaws hold"
    SUPPORTED = "what the jaws hold stands on something"
    UNSUPPORTED = "there is nothing to put it down on"
    OPENED = "the jaws are open"
    FAULT = "something cannot be trusted any more"


_HOLDING = (Mode.LIFT, Mode.CARRY, Mode.PLACE)
"""The robot moves by itself with something between the jaws."""

_BY_EVENT: dict[tuple[Mode, Event], Mode] = {
    (Mode.HOLD, Event.ENGAGED): Mode.MANUAL,
    (Mode.HOLD, Event.TRIGGERED): Mode.MANUAL,
    (Mode.MANUAL, Event.TRIGGERED): Mode.APPROACH,
    (Mode.MANUAL, Event.GRASPED): Mode.CLOSE,
    (Mode.MANUAL, Event.BEGUN): Mode.APPROACH,
    (Mode.APPROACH, Event.TRIGGERED): Mode.MANUAL,
    (Mode.APPROACH, Event.RETARGETED): Mode.APPROACH,
    (Mode.APPROACH, Event.WAITED): Mode.ADJUST,
    (Mode.APPROACH, Event.ARRIVED): Mode.ADVANCE,
    (Mode.ADJUST, Event.TRIGGERED): Mode.MANUAL,
    (Mode.ADJUST, Event.RETARGETED): Mode.APPROACH,
    (Mode.ADJUST, Event.CONFIRMED): Mode.ADVANCE,
    (Mode.ADVANCE, Event.TRIGGERED): Mode.MANUAL,
    (Mode.ADVANCE, Event.ARRIVED): Mode.CLOSE,
    (Mode.CLOSE, Event.TRIGGERED): Mode.MANUAL,
    (Mode.CLOSE, Event.HELD): Mode.LIFT,
    (Mode.CLOSE, Event.EMPTY): Mode.HOLD,
    (Mode.CLOSE, Event.TOO_WIDE): Mode.HOLD,
    (Mode.LIFT, Event.TRIGGERED): Mode.MANUAL,
    (Mode.LIFT, Event.ARRIVED): Mode.CARRY,
    (Mode.CARRY, Event.TRIGGERED): Mode.MANUAL,
    **{(mode, event): Mode.HOLD for mode in _HOLDING for event in (Event.SLIPPED, Event.LOST)},
    **{(mode, Event.RELEASED): Mode.MANUAL for mode in (Mode.CLOSE, Mode.LIFT, Mode.CARRY)},
    **{(mode, Event.PUT_DOWN): Mode.PLACE for mode in (Mode.MANUAL, Mode.LIFT, Mode.CARRY)},
    (Mode.PLACE, Event.TRIGGERED): Mode.MANUAL,
    (Mode.PLACE, Event.RELEASED): Mode.RELEASE,
    (Mode.PLACE, Event.SUPPORTED): Mode.RELEASE,
    (Mode.PLACE, Event.UNSUPPORTED): Mode.MANUAL,
    (Mode.RELEASE, Event.TRIGGERED): Mode.MANUAL,
    (Mode.RELEASE, Event.OPENED): Mode.RETREAT,
    (Mode.RETREAT, Event.TRIGGERED): Mode.MANUAL,
    (Mode.RETREAT, Event.ARRIVED): Mode.MANUAL,
}

TRANSITIONS: Mapping[tuple[Mode, Event], Mode] = MappingProxyType(
    {
        **_BY_EVENT,
        **{(mode, Event.CANCELLED): Mode.MANUAL for mode in Mode if mode.automatic},
        **{(mode, Event.FAULT): Mode.HOLD for mode in Mode},
    }
)
"""The mode that follows on an event; an event that is not listed for a mode changes nothing."""


def next_mode(mode: Mode, event: Event | None) -> Mode:
    """Return the mode after ``event``."""
    return mode if event is None else TRANSITIONS.get((mode, event), mode)


def markdown() -> str:
    """Return the table and its diagram as the text of ``docs/state-machine.md``."""
    lines = [
        "# State machine",
        "",
        "Generated from `optsc/control/modes.py`; after a change there run",
        "`optsc doctor --state-machine docs/state-machine.md`.",
        "",
        "| mode | event | next mode |",
        "|---|---|---|",
    ]
    lines += [f"| {mode.value} | {event.value} | {after.value} |" for (mode, event), after in TRANSITIONS.items()]
    lines += ["", "```mermaid", "stateDiagram-v2", f"    [*] --> {Mode.HOLD.value}"]
    lines += [
        f"    {mode.value} --> {after.value}: {event.name.lower()}"
        for (mode, event), after in TRANSITIONS.items()
        if event not in (Event.FAULT, Event.CANCELLED)
    ]
    lines += [
        "```",
        "",
        "Closing ends in what the jaws are measured to be. With the object between them the robot lifts it; closed on",
        "nothing, or stopped by something wider than the grasp, it holds. In manual mode, what the jaws hold slips, is",
        "lost or is let go of without a change of mode. While they hold something, the trigger has it put down.",
        "",
        "A fault leads from every mode to hold. Hold is left only by the operator, with the clutch or the trigger.",
        "Cancelling leads from every mode in which the robot moves by itself to manual, as the trigger does.",
        "",
        "Which of the events of manual mode a press of the trigger is depends on the arbitration policy, see",
        "[arbitration](arbitration.md). The robot waits in adjust only where fine-tuning is switched on.",
        "",
    ]
    return "\n".join(lines)
