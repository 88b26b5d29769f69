"""A fault: what goes wrong, for how long, and the answer that is expected of the controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from optsc.control.modes import Mode
from optsc.followers.protocol import FollowerState
from optsc.operators import OperatorSample

if TYPE_CHECKING:
    from optsc.study.faults.world import World

KINDS = (
    "clock",
    "loop",
    "sample",
    "reading",
    "jaws",
    "operator",
    "solver",
    "policy",
    "selection",
    "time law",
    "avoidance",
    "calls",
    "session",
)
"""Where a fault comes from."""
ONCE = 0.0
"""A fault of one tick, one sample or one call."""
FROM_THEN_ON = inf
"""A fault that lasts until the operator begins again."""

Hook = Callable[[Callable[..., Any], tuple[Any, ...]], Any]
"""``hook(genuine, arguments)``: what a part answers in place of ``genuine(*arguments)``."""


@dataclass(eq=False)
class Injection:
    """What a fault does to one run; every function is given the time since the fault began [s].

    Attributes:
        start: called once, when the fault begins.
        tick: called before every tick.
        sample: the sample that arrives in place of the true one.
        reading: what is measured in place of the true state.
        now: the time that the loop says in place of the true one [s].
        duration: how long a tick truly takes, in periods.
        hand: the sample that the operator's hand makes, in place of one that suits the script of the run.
        parts: what user-defined parts answer, by the name of the part, see `World`.
        end: called once, when the fault is over.
    """

    start: Callable[[World], None] | None = None
    tick: Callable[[World, float], None] | None = None
    sample: Callable[[float, OperatorSample], Any] | None = None
    reading: Callable[[float, FollowerState], Any] | None = None
    now: Callable[[float, float], Any] | None = None
    duration: Callable[[float], float] | None = None
    hand: Callable[[float, OperatorSample], OperatorSample | None] | None = None
    parts: Mapping[str, Hook] = field(default_factory=dict)
    end: Callable[[World], None] | None = None


class Answer(NamedTuple):
    """What the controller has to do.

    Attributes:
        name: one of "goes on", "rests", "holds", "stays in hold", "stops", "is safe", see `words`.
        says: words of which the reason has at least one.
        within: how far the tool may be from where the hand leads it at the end [m]; None where that is not known.
        moving: the same while the hand moves [m].
        turning: how far the tool may turn from the orientation that the hand leads it to [rad].
        never: modes that it must not come to.
        led: whether the command may still be on its way to where the arm is.
        follows: whether the status at the end has to be that the arm follows.
    """

    name: str
    says: tuple[str, ...] = ()
    within: float | None = None
    moving: float = inf
    turning: float = inf
    never: tuple[Mode, ...] = ()
    led: bool = False
    follows: bool = True

    @property
    def words(self) -> str:
        """The answer in words, for tables."""
        text = self.name
        if self.says:
            text += " (" + " / ".join(self.says) + ")"
        if self.within is not None:
            text += f", within {1e3 * self.within:g} mm of the hand"
        if self.turning < inf:
            text += f", turned by {self.turning:g} rad at most"
        if self.led:
            text += ", led to where the arm is"
        if self.never:
            text += ", never " + ", ".join(mode.value for mode in self.never)
        return text


def goes_on(within: float | None = 1e-3, moving: float = 0.02, turning: float = inf) -> Answer:
    """The mode goes on as if nothing had happened, and the tool is where the hand leads it."""
    return Answer("goes on", within=within, moving=moving, turning=turning)


def rests() -> Answer:
    """Manual mode goes on with the arm at rest, and says why."""
    return Answer("rests")


def holds(*says: str) -> Answer:
    """The mode is hold, the arm is at rest, and the reason can be read as long as that lasts."""
    return Answer("holds", says)


def holds_led(*says: str) -> Answer:
    """The same, but the command may be on its way to where the arm is measured to be."""
    return Answer("holds", says, led=True)


def stays_in_hold(*says: str) -> Answer:
    """Hold is not left while the fault lasts, and the reason says why."""
    return Answer("stays in hold", says)


def stops(*says: str) -> Answer:
    """The arm is at rest, in hold or in manual mode, and the reason says why."""
    return Answer("stops", says)


def is_safe(*never: Mode, turning: float = inf) -> Answer:
    """Anything that keeps the limits, tells the truth and can be led on: where nothing more can be asked for."""
    return Answer("is safe", never=never, turning=turning)


class Expected(NamedTuple):
    """The answers in hold, which the operator tries to leave, in manual mode, and while the robot moves by itself."""

    hold: Answer
    manual: Answer
    automatic: Answer
    others: Mapping[Mode, Answer] = MappingProxyType({})

    def of(self, mode: Mode) -> Answer:
        """Return the answer in a mode."""
        if mode in self.others:
            return self.others[mode]
        if mode is Mode.HOLD:
            return self.hold
        return self.manual if mode is Mode.MANUAL else self.automatic


Inject = Callable[["World", np.random.Generator], Injection]


@dataclass(frozen=True, eq=False)
class Fault:
    """One fault.

    Attributes:
        name: unique.
        kind: one of `KINDS`.
        lasts: for how long [s]; `ONCE` or `FROM_THEN_ON`.
        inject: makes the injection of a run from a random generator; the same seed gives the same run.
        expected: the answers.
        permanent: whether it also lasts while the operator begins again, as a device's clock does that is off.
        assisted: whether the run is one with a user-defined arbitration policy.
        timed: whether the loop tells the controller what time it is.
        leaving: whether in hold it begins at the tick at which the operator wants to leave, not before.
        restarts: whether the caller itself begins the commands again.
        recouples: whether the hand is coupled again, so that it is not known where it leads the tool to.
        far: whether the arm may end where it cannot be led on in all directions.
        patient: whether the operator waits before taking over until a clock that was wrong is believed again.
        interrupts: whether an interrupt may come out of `step`.
        quick: whether the hand is sampled at every tick.
        keeps_jaws: whether jaws that are closed have to stay so.
        modes: in which it can be.
    """

    name: str
    kind: str
    lasts: float
    inject: Inject
    expected: Expected
    permanent: bool = False
    assisted: bool = False
    timed: bool = False
    leaving: bool = False
    restarts: bool = False
    recouples: bool = False
    far: bool = False
    patient: bool = False
    interrupts: bool = False
    quick: bool = False
    keeps_jaws: bool = False
    modes: tuple[Mode, ...] = tuple(Mode)


def everywhere(answer: Answer) -> Expected:
    """The same answer in all modes."""
    return Expected(answer, answer, answer)


def goes_on_everywhere(within: float | None = 1e-3, moving: float = 0.02) -> Expected:
    """All modes go on."""
    return everywhere(goes_on(within, moving))
