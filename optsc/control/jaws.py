"""Grip detection: what the jaws hold, judged by their measured opening.

A parallel gripper that closes comes to rest on what is between its pads. Where that agrees with the width that the
grasp says, the object is held; where the pads meet, or something wider stops them, it is not. What is held is watched
from then on: an opening that falls means that it slips or is gone.

No single reading decides anything: readings that are no opening of these jaws are skipped, the rest go through a
running median, and what they say has to last.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import isfinite, nan
from statistics import median
from typing import Annotated, NamedTuple

from optsc.checks import Checked, Positive
from optsc.control.modes import Event
from optsc.geometry.scalar import Quaternion, Vector
from optsc.selection import Target

LEAST_CLOSING_TIME = 0.3
"""Jaws are judged after this [s] at the earliest ..."""
LONGEST_START_TIME = 1.0
"""... and after this [s] where they have not moved, as they may not have begun to."""
LONGEST_CLOSING_TIME = 3.0
"""Jaws are judged after this [s] however their readings scatter, unless they are still moving."""
BLIND_TIME = 0.5
"""Jaws without a usable reading for this [s] are not measured."""
_READINGS = 5
_REST_TIME = 0.2
"""Jaws are at rest where the two halves of this time [s] agree ..."""
_REST_TRAVEL = 2e-4
"""... within this [m] ..."""
_MOVING_TRAVEL = 1e-3
"""... and moving where they differ by more than this."""
_BIN_TIME = 0.02
_LASTING = 0.04
"""What the readings say about something held counts once they have said so for this [s] ..."""
_LASTING_TICKS = 3
"""... and so many ticks."""
_BEYOND = 5e-3
"""A reading further outside of the jaws' range than this [m] is none."""


@dataclass(frozen=True)
class JawSettings(Checked):
    """What the opening of closed jaws means.

    Attributes:
        narrower, wider: how far it may differ from the width that the grasp says, with the object held [m]; at less
            than half of that width it is never held.
        closed: jaws within this of closed hold nothing [m], unless the grasp says that its width is as small.
        slip: a fall of the opening by more than this means that what is held slips [m]; half of a narrow object's width
            does, too.
    """

    narrower: Annotated[float, Positive] = 0.015
    wider: Annotated[float, Positive] = 0.01
    closed: Annotated[float, Positive] = 2e-3
    slip: Annotated[float, Positive] = 4e-3

    def range(self, target: Target | None, open_jaws: float) -> tuple[float, float]:
        """Return between which openings [m] the object of a grasp is held; ``open_jaws`` is the greatest opening [m].

        A width that is no number, zero, or that of the open jaws is none: then held means clearly more than closed
        and less than open.
        """
        width = nan if target is None else target.opening
        if not 0.0 < width < open_jaws:
            return self.closed, open_jaws - self.closed
        return max(width - self.narrower, 0.5 * width), width + self.wider


class GripStatus(Enum):
    """What the jaws are doing, or hold."""

    OPEN = "open"
    CLOSING = "closing"
    HELD = "holding the object"
    EMPTY = "closed on nothing"
    TOO_WIDE = "stopped by something wider than the grasp"

    @property
    def may_drop(self) -> bool:
        """Whether something could fall out of the jaws if they opened."""
        return self in (GripStatus.CLOSING, GripStatus.HELD, GripStatus.TOO_WIDE)


class Held(NamedTuple):
    """What is between the jaws.

    Attributes:
        object_name: of the object; empty where it is not known, as where the hand grasped anywhere.
        target: the grasp that holds it; None where it is not known.
        opening: of the jaws when they came to rest on it, or to which it has slipped since [m].
        at: position and orientation of the tool in W where it was grasped: there it stood on something.
    """

    object_name: str
    target: Target | None
    opening: float
    at: tuple[Vector, Quaternion]


class JawChange(NamedTuple):
    """What a reading has told: an event and its reason in words; None for nothing."""

    event: Event | None = None
    reason: str = ""


class Readings(NamedTuple):
    """Measured openings of the jaws as far as they can be believed.

    Attributes:
        newest: the last usable ones [m].
        blind: for how many ticks there was none.
        window: means over short times since the jaws began to move [m].
        total, summed: sum and number of the readings of the next mean.
    """

    newest: tuple[float, ...] = ()
    blind: int = 0
    window: tuple[float, ...] = ()
    total: float = 0.0
    summed: int = 0

    @property
    def opening(self) -> float:
        """The running median [m]; NaN before there are three readings."""
        return median(self.newest) if len(self.newest) > 2 else nan

    def after(self, opening: object, widest: float, period: float) -> Readings:
        """Return the readings with one more, after ``period`` [s], of jaws that open by ``widest`` [m] at most."""
        value = float(opening) if isinstance(opening, (int, float)) else nan
        if not -_BEYOND <= value <= widest + _BEYOND:
            return self._replace(blind=self.blind + 1)
        after = self._replace(newest=(*self.newest[1 - _READINGS :], value), blind=0)
        filtered = after.opening
        if not isfinite(filtered):
            return after
        total, count = self.total + filtered, self.summed + 1
        each, length = _bins(period)
        if count < each:
            return after._replace(total=total, summed=count)
        return after._replace(window=(*self.window[1 - length :], total / count), total=0.0, summed=0)

    def begun(self) -> Readings:
        """Return the readings of jaws that begin to move now."""
        return Readings(self.newest, self.blind)

    def travel(self, period: float) -> float:
        """Return by how much the opening fell in the time in which rest shows [m]; NaN before that time is over."""
        window, (_, length) = self.window, _bins(period)
        half = length // 2
        return (sum(window[:half]) - sum(window[half:])) / half if len(window) == length else nan

    @property
    def rest(self) -> float:
        """The opening of jaws at rest [m]: the mean of the later half of that time; NaN before there is one."""
        late = self.window[len(self.window) // 2 :]
        return sum(late) / len(late) if late else nan


def _bins(period: float) -> tuple[int, int]:
    """Return how many ticks of ``period`` [s] one mean is of, and how many means show rest: an even number."""
    each = max(1, round(_BIN_TIME / period))
    return each, max(4, 2 * round(0.5 * _REST_TIME / (each * period)))


class Jaws(NamedTuple):
    """What is known of the jaws.

    Attributes:
        readings: of their opening.
        grip: what they are doing, or hold.
        held: what is between them; None where nothing is known to be.
        target: the grasp that they closed at, if any.
        at: where the tool was when they began to close.
        ticks: since they began to move.
        start: their opening then [m]; NaN where it was not known.
        judged: their opening when they came to rest [m].
        suspicion: for how many ticks the opening has been that of something that slips.
    """

    readings: Readings = Readings()
    grip: GripStatus = GripStatus.OPEN
    held: Held | None = None
    target: Target | None = None
    at: tuple[Vector, Quaternion] = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    ticks: int = 0
    start: float = nan
    judged: float = nan
    suspicion: int = 0

    def closing(self, target: Target | None, at: tuple[Vector, Quaternion]) -> Jaws:
        """Return the jaws that begin to close on the object of a grasp, with the tool at a pose in W."""
        return Jaws(self.readings.begun(), GripStatus.CLOSING, None, target, at, start=self.readings.opening)

    def opening(self) -> Jaws:
        """Return the jaws that begin to open: they hold nothing any more."""
        return Jaws(self.readings.begun(), start=self.readings.opening)

    def updated(
        self, settings: JawSettings, open_jaws: float, period: float, opening: object
    ) -> tuple[Jaws, JawChange]:
        """Return the jaws after a reading of their ``opening`` [m], and what it has told."""
        jaws = self._replace(readings=self.readings.after(opening, open_jaws, period), ticks=self.ticks + 1)
        if jaws.grip is GripStatus.CLOSING:
            return jaws._judged(settings, open_jaws, period)
        if jaws.grip in (GripStatus.HELD, GripStatus.TOO_WIDE):
            return jaws._watched(settings, open_jaws, period)
        return jaws, JawChange()

    def blind(self, period: float) -> bool:
        """Tell whether the opening has not been measured for too long."""
        return self.readings.blind * period > BLIND_TIME

    def at_rest(self, period: float) -> bool:
        """Tell whether the jaws have come to rest since they began to move."""
        time, travel = self.ticks * period, self.readings.travel(period)
        if time < LEAST_CLOSING_TIME or not isfinite(travel):
            return False
        if time < LONGEST_START_TIME and abs(self.readings.rest - self.start) < _MOVING_TRAVEL:
            return False
        return abs(travel) <= (_REST_TRAVEL if time < LONGEST_CLOSING_TIME else _MOVING_TRAVEL)

    def opened(self, open_jaws: float) -> bool:
        """Tell whether jaws at rest have opened, at least a little: what is beside them may be in their way."""
        opening = self.readings.rest
        return opening > min(self.start + _MOVING_TRAVEL, open_jaws - _BEYOND)

    def _judged(self, settings: JawSettings, open_jaws: float, period: float) -> tuple[Jaws, JawChange]:
        if not self.at_rest(period):
            return self, JawChange()
        least, most = settings.range(self.target, open_jaws)
        opening = self.readings.rest
        judged = self._replace(judged=opening, suspicion=0)
        if opening < least:
            return judged._replace(grip=GripStatus.EMPTY), JawChange(Event.EMPTY, judged._told("closed on nothing"))
        if opening > most:
            reason = judged._told("were stopped by something wider than the grasp")
            return judged._replace(grip=GripStatus.TOO_WIDE), JawChange(Event.TOO_WIDE, reason)
        name = "" if self.target is None else self.target.object_name
        held = Held(name, self.target, opening, self.at)
        return judged._replace(grip=GripStatus.HELD, held=held), JawChange(Event.HELD)

    def _watched(self, settings: JawSettings, open_jaws: float, period: float) -> tuple[Jaws, JawChange]:
        held, opening = self.held, self.readings.opening
        if self.readings.blind:
            return self, JawChange()
        if opening >= self.judged - min(settings.slip, 0.5 * self.judged):
            return (self._replace(suspicion=0) if self.suspicion else self), JawChange()
        suspicion = self.suspicion + 1
        if suspicion < _LASTING_TICKS or suspicion * period < _LASTING:
            return self._replace(suspicion=suspicion), JawChange()
        moving = Jaws(self.readings.begun(), GripStatus.CLOSING, None, self.target, self.at)
        if held is None:
            # What had stopped the jaws is gone: they are judged again.
            return moving, JawChange()
        name = f"the {held.object_name}" if held.object_name else "what the jaws held"
        fall = f"the opening fell from {_mm(self.judged)} to {_mm(opening)}"
        if opening < settings.range(held.target, open_jaws)[0]:
            return moving, JawChange(Event.LOST, f"{name} is no longer between the jaws: {fall}")
        slipped = self._replace(held=held._replace(opening=opening), judged=opening, suspicion=0)
        return slipped, JawChange(Event.SLIPPED, f"{name} slips in the jaws: {fall}")

    def _told(self, words: str) -> str:
        target, text = self.target, f"the jaws {words}: opening {_mm(self.judged)}"
        if target is None or not isfinite(target.opening):
            return text
        return f"{text}, expected {_mm(target.opening)} for the {target.object_name}"


def _mm(length: float) -> str:
    return f"{1e3 * length:.1f} mm"
