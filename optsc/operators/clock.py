"""Clock mapping: a device's time stamps on the loop's clock; offset and drift are learnt from when samples arrive.

What a sample's arrival is later than its stamp, its delay, is the offset of the two clocks, which may drift, plus the
time that it was under way. The second is never negative and now and then close to nothing, so the line below all
delays tells the first: the edge of their lower convex hull over the mean of the arrivals (S. B. Moon, P. Skelly,
D. Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999). What a delay is above
that line is how old the sample was when it came.

A clock whose stamps are within `OWN` of the arrivals, not after them, and do not drift from them is taken to be the
loop's own: then its stamps are times of the loop as they are, and known latencies are latencies.
"""

from __future__ import annotations

from enum import Enum
from itertools import pairwise
from math import inf, nan
from typing import NamedTuple

import numpy as np

OWN = 0.1
"""Delay of the first sample [s] up to which a clock may be the loop's own."""
OWN_DRIFT, DRIFTING = 0.02, 4
"""Where the least delay has been larger by this [s] for so many quarter seconds, the clock is not the loop's own ..."""
FAST_DRIFT, FAST_DRIFTING = 0.008, 3
"""... nor where it has grown by this [s] in so many of them in a row, as in a loop that goes faster than it counts."""
NOISE = 0.005
"""A stamp that is further ahead [s] than this needs a second one that says the same."""
JUMP = 0.1
"""A stamp that is further ahead than this is not used before that."""
OLDEST = 0.25
"""A sample that was under way for longer than this [s] is late: what it tells is over."""
AGREEMENT = 0.25
"""Two stamps in a row agree on another clock where their delays differ by less than this [s] ..."""
REORDERED, ALONE = 1.0, 0.02
"""... and are earlier by more than this [s], where nothing else has come for so long [s]; what is earlier by less may
be packets out of order ..."""
PERSISTENT = 0.12
"""... unless nothing else comes for this long [s]."""
BACKLOG = 1.0
"""A delay that has grown, with stamps in order, is the clock's only after this [s] ..."""
CONSTANT = 0.03
"""... in which it has changed by less than this [s]: otherwise samples wait in a queue. Where the loop's time is a
count of ticks, that says nothing."""
QUARTER, QUARTERS = 0.25, 40
"""The least delay of every quarter second is kept for ten seconds."""
STEADY = (1e-2, 10.0)
"""Drift at most [-] between two clocks: beyond it, delays grow; and for how long [s] it is looked back for it."""
COUNTED = (0.5, 2.0)
"""The same where the loop's time is a count of ticks, which may be late or missed, now more and now less of them."""
LARGEST_STAMP = 1e12
"""Beyond this a number is no time in seconds."""


def number(value: object) -> float:
    """Return a number of any type as a plain float; NaN where it is none."""
    try:
        return float(value) if isinstance(value, (int, float, np.floating, np.integer)) else nan
    except OverflowError:
        return nan


class Refusal(Enum):
    """Why a stamp is refused."""

    NOT_A_TIME = "is not a time in seconds"
    DUPLICATE = "is that of the sample before"
    LATE = "is earlier than that of a sample before, or too old"
    AHEAD = "is ahead of the device's clock as known so far"


class Line(NamedTuple):
    """The least delay [s] as it changes with time: ``offset`` at ``at``, and ``drift`` per second."""

    offset: float = 0.0
    drift: float = 0.0
    at: float = 0.0


class Suspect(NamedTuple):
    """The last stamp that does not fit, and the first of those that agree with it."""

    stamp: float
    arrival: float
    first_arrival: float
    first_delay: float


class ClockMapping(NamedTuple):
    """What is known of a device's clock.

    Attributes:
        stamp: of the newest sample that was used, on the device's clock [s]; None before the first.
        mapped: the same on the loop's clock.
        foreign: whether it is another clock than the loop's.
        line: least delay.
        least: least delay in the first quarter second [s].
        window: arrival and delay of the quickest sample of each quarter second, oldest first.
        quickest: of the quarter second that is going on.
        ends: when that is over [s].
        suspect: a stamp that does not fit, until the next tells whether the clock has changed.
        restarts: how often it has.
        told: whether it is the clock that the loop tells.
    """

    stamp: float | None = None
    mapped: float = -inf
    foreign: bool = False
    line: Line = Line()
    least: float = inf
    window: tuple[tuple[float, float], ...] = ()
    quickest: tuple[float, float] = (0.0, inf)
    ends: float = -inf
    suspect: Suspect | None = None
    restarts: int = 0
    told: bool = False

    def read(self, stamp: float, arrival: float, zero: float | None = None) -> Mapped:
        """Return the mapping after a sample stamped ``stamp`` arrived at ``arrival`` [s], and what becomes of it.

        Args:
            stamp: on the device's clock [s].
            arrival: on the loop's clock [s]; never goes back.
            zero: what the clock that the loop tells reads at the loop's time zero [s]; stamps may be on that clock.
                None where the loop's time is a count of ticks.
        """
        if type(stamp) is not float:
            stamp = number(stamp)
        if not -LARGEST_STAMP < stamp < LARGEST_STAMP:
            return Mapped(self, None, Refusal.NOT_A_TIME)
        newest, suspect = self.stamp, self.suspect
        if newest is None:
            return _first(stamp, arrival, zero, self)
        if self.told and zero is not None:
            stamp -= zero
        delay, steady = arrival - stamp, zero is not None
        if stamp == newest or (suspect is not None and stamp == suspect.stamp):
            return Mapped(self, None, Refusal.DUPLICATE)
        line = self.line
        excess = delay - line.offset - line.drift * (arrival - line.at)
        if stamp < newest or not -NOISE <= excess <= OLDEST:
            return self._doubted(stamp, arrival, excess, steady)
        return self._used(stamp, arrival, delay, excess, steady)

    def _used(self, stamp: float, arrival: float, delay: float, excess: float, steady: bool) -> Mapped:
        """Return the mapping after a sample that fits; ``delay`` is what the envelope is given."""
        _, mapped, foreign, line, least, window, quickest, ends, _, restarts, told = self
        if not foreign:
            mapped = max(mapped, min(stamp, arrival))
        else:
            mapped = max(mapped, min(arrival, arrival - excess))
            if excess < 0.0:
                line = Line(line.offset + excess, line.drift, line.at)
        if arrival >= ends:
            if quickest[1] < inf:
                least = min(least, quickest[1]) if not window else least
                window = (*window[1 - QUARTERS :], quickest)
                foreign = foreign or _drifts(window, least, steady)
                if foreign:
                    line = _line_below(window, line, arrival, *(STEADY if steady else COUNTED))
            quickest, ends = (arrival, delay), arrival + QUARTER
        elif delay <= quickest[1]:
            quickest = (arrival, delay)
        return Mapped(
            ClockMapping(stamp, mapped, foreign, line, least, window, quickest, ends, None, restarts, told),
            mapped,
            None,
        )

    def _doubted(self, stamp: float, arrival: float, excess: float, steady: bool) -> Mapped:
        """Return the mapping after a sample that does not fit: the next tells whether it or the mapping is wrong."""
        delay, before = arrival - stamp, self.suspect
        in_order = self.stamp is not None and stamp > self.stamp
        suspect = Suspect(stamp, arrival, arrival, delay)
        if before is not None and stamp > before.stamp and arrival >= before.arrival:
            before_delay = before.arrival - before.stamp
            if abs(delay - before_delay) <= AGREEMENT:
                suspect = suspect._replace(first_arrival=before.first_arrival, first_delay=before.first_delay)
                if in_order and -JUMP <= excess < 0.0:
                    return self._lowered(stamp, arrival, max(delay, before_delay), steady)
                if self.foreign and excess > OLDEST and all(-NOISE <= d <= OWN for d in (delay, before_delay)):
                    # A clock that was set is right again: two stamps agree with the loop's own clock.
                    return _begun(stamp, arrival, False, self)
                if _confirmed(suspect, in_order, excess, steady):
                    return _begun(stamp, arrival, True, self, min(delay, before_delay))
        if in_order and -JUMP <= excess < 0.0:
            # A little ahead, and nothing yet says the same: used, for it is new, but not believed.
            mapped = max(self.mapped, arrival)
            return Mapped(self._replace(mapped=mapped, suspect=suspect), mapped, None)
        refusal = Refusal.AHEAD if in_order and excess < 0.0 else Refusal.LATE
        return Mapped(self._replace(suspect=suspect), None, refusal)

    def _lowered(self, stamp: float, arrival: float, delay: float, steady: bool) -> Mapped:
        """Return the mapping with a line that two samples in a row lie below: it goes through the upper of them."""
        known = self._replace(foreign=True, line=Line(delay, self.line.drift, arrival))
        excess = min(arrival - stamp - delay, 0.0)
        return known._used(stamp, arrival, delay, excess, steady)


class Mapped(NamedTuple):
    """The mapping after a sample, when that was on the loop's clock [s], or else why it is refused."""

    clock: ClockMapping
    time: float | None
    refusal: Refusal | None


def _first(stamp: float, arrival: float, zero: float | None, nothing: ClockMapping) -> Mapped:
    """Return the mapping after the first sample: on the loop's clock, on the one that it tells, or on another."""
    if -NOISE <= arrival - stamp <= OWN:
        return _begun(stamp, arrival, False, nothing)
    if zero is not None and -NOISE <= arrival + zero - stamp <= OWN:
        return _begun(stamp - zero, arrival, False, nothing._replace(told=True))
    return _begun(stamp, arrival, True, nothing)


def _begun(stamp: float, arrival: float, foreign: bool, before: ClockMapping, least: float = inf) -> Mapped:
    """Return a mapping that begins with one sample; ``before`` is what was known of another clock."""
    delay = arrival - stamp
    least = min(least, delay)
    mapped = min(max(before.mapped, arrival + least - delay if foreign else stamp), arrival)
    line = Line(least, 0.0, arrival) if foreign else Line()
    restarts = before.restarts + (before.stamp is not None)
    clock = ClockMapping(
        stamp, mapped, foreign, line, least, (), (arrival, least), arrival + QUARTER, None, restarts, before.told
    )
    return Mapped(clock, mapped, None)


def _confirmed(suspect: Suspect, in_order: bool, excess: float, steady: bool) -> bool:
    """Tell whether stamps that agree with each other are those of a clock that has changed."""
    if in_order and excess < 0.0:
        return True
    lasting = suspect.arrival - suspect.first_arrival
    if in_order:
        change = abs(suspect.arrival - suspect.stamp - suspect.first_delay)
        return lasting >= BACKLOG and (change <= CONSTANT or not steady)
    return lasting >= (ALONE if excess > REORDERED else PERSISTENT) - 1e-9


def _drifts(window: tuple[tuple[float, float], ...], least: float, steady: bool) -> bool:
    """Tell whether delays have grown as they do not on the loop's own clock."""
    if len(window) > DRIFTING and min(delay for _, delay in window[-DRIFTING:]) > least + OWN_DRIFT:
        return True
    if steady:
        return False
    delays = [delay for _, delay in window[-FAST_DRIFTING - 1 :]]
    grown = all(after > before + FAST_DRIFT for before, after in pairwise(delays))
    return len(delays) > FAST_DRIFTING and grown


def _line_below(
    window: tuple[tuple[float, float], ...], line: Line, arrival: float, drift: float, memory: float
) -> Line:
    """Return the line below the delays of a window: ``line`` as long as there are too few to tell a drift."""
    window = tuple(point for point in window if point[0] >= arrival - memory)
    if len(window) < 3:
        return line
    hull: list[tuple[float, float]] = []
    for t, d in window:
        while len(hull) > 1 and _above(hull[-2], hull[-1], (t, d)):
            hull.pop()
        hull.append((t, d))
    middle = sum(t for t, _ in window) / len(window)
    (t0, d0), (t1, d1) = next((a, b) for a, b in pairwise(hull) if b[0] >= middle)
    slope = min(max((d1 - d0) / (t1 - t0), -drift), drift)
    # Below all of them, also where the slope is not that of the edge.
    offset = min(d + slope * (arrival - t) for t, d in window)
    return Line(offset, slope, arrival)


def _above(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    """Tell whether ``b`` lies above the line from ``a`` to ``c``, or on it."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
