"""Faults of the operator and of the tracker: silence, jumps, hands out of reach, chattering buttons."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import inf, pi
from typing import Any

import numpy as np

from optsc.control.modes import Mode
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.operators import Button, OperatorSample
from optsc.study.faults.fault import (
    FROM_THEN_ON,
    ONCE,
    Answer,
    Expected,
    Fault,
    Inject,
    Injection,
    everywhere,
    goes_on,
    goes_on_everywhere,
    holds,
    is_safe,
    stops,
)
from optsc.study.faults.world import World, smooth

Act = Callable[[float, OperatorSample], OperatorSample | None]
LOOSELY = 0.02
"""Where the hand is coupled again while it moves, the tool is where it was then, up to this [m]."""
STEADY = 0.06
"""What does not turn the tool leaves it within this angle [rad]."""


def acts(act: Act) -> Inject:
    """Return what an operator does."""
    return lambda _, __: Injection(hand=act)


def _silent(_: float, __: OperatorSample) -> None:
    return None


def _moved(sample: OperatorSample, shift: Array | None = None, turn: Array | None = None) -> OperatorSample:
    X = sample.X_SH
    p = X.translation if shift is None else X.translation + shift
    q = X.quaternion if turn is None else rotation.multiply(rotation.exp(turn), X.quaternion)
    return sample._replace(X_SH=Pose(q, p))


def _jump(distance: float) -> Inject:
    def inject(_: World, rng: np.random.Generator) -> Injection:
        away = rng.normal(size=3)
        away *= distance / np.linalg.norm(away)
        return Injection(hand=lambda _, sample: _moved(sample, shift=away))

    return inject


def _turn(angle: float) -> Inject:
    def inject(_: World, rng: np.random.Generator) -> Injection:
        axis = rng.normal(size=3)
        turn = axis * angle / np.linalg.norm(axis)
        return Injection(hand=lambda _, sample: _moved(sample, turn=turn))

    return inject


def _identity(_: float, sample: OperatorSample) -> OperatorSample:
    """What some trackers report when they are lost."""
    return sample._replace(X_SH=Pose.identity())


def _unturned(_: float, sample: OperatorSample) -> OperatorSample:
    return sample._replace(X_SH=Pose(np.array([1.0, 0.0, 0.0, 0.0]), sample.X_SH.translation))


def _back_turned(_: World, rng: np.random.Generator) -> Injection:
    """The tracker is lost for a while, and the hand comes back turned by half a turn."""
    axis = rng.normal(size=3)
    turn = axis * 0.98 * pi / np.linalg.norm(axis)
    return Injection(hand=lambda elapsed, sample: None if elapsed < 0.4 else _moved(sample, turn=turn))


def _lost(_: float, sample: OperatorSample) -> OperatorSample | None:
    """The device says that it is gone; one that cannot say so is silent."""
    fields: dict[str, Any] = {"lost": True}
    return sample._replace(**fields) if "lost" in sample._fields else None


def _ahead_then_silent(elapsed: float, sample: OperatorSample) -> OperatorSample | None:
    return sample._replace(stamp=sample.stamp + 1.0) if elapsed < 0.3 else None


def _chatter(of: str) -> Inject:
    """A contact that opens and closes at every sample."""

    def inject(_: World, __: np.random.Generator) -> Injection:
        count: list[None] = []

        def hand(_: float, sample: OperatorSample) -> OperatorSample:
            count.append(None)
            closed: dict[str, Any] = {of: len(count) // 5 % 2 == 0}
            return sample._replace(**closed)

        return Injection(hand=hand)

    return inject


def _buttons(*pressed: Button, blinking: bool = False) -> Inject:
    def hand(elapsed: float, sample: OperatorSample) -> OperatorSample:
        on = not blinking or int(elapsed / 0.05) % 2 == 0
        return sample._replace(buttons=frozenset(pressed) if on else frozenset())

    return acts(hand)


def _double_press(_: World, __: np.random.Generator) -> Injection:
    """Two presses of the trigger a few milliseconds apart; every sample is one that arrives."""
    return Injection(hand=lambda elapsed, sample: sample._replace(trigger=int(elapsed / 0.004) in (0, 2)))


def _steps_in_turned(angle: float) -> Inject:
    """The operator, whose hand is turned from where the tool is, presses the trigger, and keeps still."""

    def inject(_: World, rng: np.random.Generator) -> Injection:
        axis = rng.normal(size=3)
        turn = axis * angle / np.linalg.norm(axis)
        return Injection(hand=lambda elapsed, sample: _moved(sample, turn=turn)._replace(trigger=0.1 <= elapsed < 0.25))

    return inject


def _carried_away(world: World, rng: np.random.Generator) -> Injection:
    """The hand goes a metre away, too far for the arm, quickly and smoothly."""
    away = rng.normal(size=3)
    away /= np.linalg.norm(away)
    return Injection(hand=lambda elapsed, sample: _moved(sample, shift=smooth(elapsed / 0.8) * away))


def _turned_over(_: World, __: np.random.Generator) -> Injection:
    """The hand turns by 150 degrees about its y axis."""

    def hand(elapsed: float, sample: OperatorSample) -> OperatorSample:
        angle = -smooth(elapsed / 0.8) * np.radians(150.0)
        X = sample.X_SH
        return sample._replace(
            X_SH=Pose(rotation.multiply(X.quaternion, rotation.exp([0.0, angle, 0.0])), X.translation)
        )

    return Injection(hand=hand)


def _trembling(_: World, rng: np.random.Generator) -> Injection:
    return Injection(hand=lambda _, sample: _moved(sample, shift=rng.normal(0.0, 1e-3, 3)))


def _nudging(size: float) -> Inject:
    def inject(_: World, rng: np.random.Generator) -> Injection:
        return Injection(
            hand=lambda _, sample: sample._replace(nudge=tuple((size * rng.uniform(-1.0, 1.0, 6)).tolist()))
        )

    return inject


def _over_contact(answer: Answer, otherwise: Answer) -> Expected:
    """One answer where the hand is at the object, another elsewhere."""
    contact = dict.fromkeys((Mode.ADVANCE, Mode.CLOSE, Mode.LIFT), answer)
    return Expected(otherwise, otherwise, otherwise, contact)


def _jumps() -> Iterator[Fault]:
    steady = goes_on(LOOSELY, 2 * LOOSELY, STEADY)
    by_robot = goes_on(turning=inf)
    kept = Expected(is_safe(turning=STEADY), steady, by_robot)
    for distance in (0.3, 1.0):
        yield Fault(
            f"the hand jumps by {distance:g} m", "operator", FROM_THEN_ON, _jump(distance), kept, recouples=True
        )
    yield Fault("the hand is elsewhere once", "operator", ONCE, _jump(0.5), kept, recouples=True)
    for degrees in (50, 90, 113, 179):
        yield Fault(
            f"the axes of the tracker turn by {degrees} degrees",
            "operator",
            FROM_THEN_ON,
            _turn(np.radians(degrees)),
            # Who closes the clutch with a hand that is turned means it, where orientation is absolute.
            Expected(is_safe(), steady, by_robot),
            recouples=True,
            far=True,
        )
    yield Fault("the tracker says identity once", "operator", ONCE, acts(_identity), kept, recouples=True)
    # What the hand does meanwhile is not seen.
    lost = Expected(is_safe(), goes_on(2 * LOOSELY, 2 * LOOSELY, STEADY), by_robot)
    yield Fault("the tracker says identity", "operator", FROM_THEN_ON, acts(_identity), lost, recouples=True, far=True)
    yield Fault("the tracker says identity for 0.3 s", "operator", 0.3, acts(_identity), lost, recouples=True, far=True)
    yield Fault("the orientation is lost", "operator", FROM_THEN_ON, acts(_unturned), lost, recouples=True, far=True)
    back = Expected(is_safe(), is_safe(turning=STEADY), is_safe(turning=inf))
    yield Fault("the hand comes back turned", "operator", FROM_THEN_ON, _back_turned, back, recouples=True, far=True)
    for degrees in (30, 49, 120):
        yield Fault(
            f"stepping in with a hand turned by {degrees} degrees",
            "operator",
            FROM_THEN_ON,
            _steps_in_turned(np.radians(degrees)),
            _over_contact(is_safe(turning=0.25 + STEADY), is_safe()),
            recouples=True,
            far=True,
        )


def faults() -> Iterator[Fault]:
    """Yield them all."""
    gone = Expected(is_safe(Mode.MANUAL), stops(), holds("operator", "sample"))
    yield Fault("silence of 50 ms", "operator", 0.05, acts(_silent), goes_on_everywhere(moving=0.03))
    rests = Expected(is_safe(), is_safe(), holds("operator", "sample"))
    yield Fault("silence of 0.4 s", "operator", 0.4, acts(_silent), rests, recouples=True)
    yield Fault("the operator is gone", "operator", FROM_THEN_ON, acts(_silent), gone)
    yield Fault("the device says that it is lost", "operator", FROM_THEN_ON, acts(_lost), gone)
    ahead, later = acts(_ahead_then_silent), gone._replace(hold=is_safe())
    yield Fault("the operator is gone with a clock ahead", "operator", FROM_THEN_ON, ahead, later, patient=True)
    yield from _jumps()
    yield Fault(
        "the clutch chatters", "operator", FROM_THEN_ON, _chatter("clutch"), everywhere(is_safe()), recouples=True
    )
    yield Fault(
        "the trigger chatters", "operator", FROM_THEN_ON, _chatter("trigger"), everywhere(is_safe()), recouples=True
    )
    yield Fault(
        "two presses of the trigger 4 ms apart",
        "operator",
        0.02,
        _double_press,
        everywhere(is_safe()),
        recouples=True,
        keeps_jaws=True,
        quick=True,
    )
    yield Fault(
        "all buttons at once", "operator", FROM_THEN_ON, _buttons(*Button), everywhere(is_safe()), recouples=True
    )
    for button in Button:
        yield Fault(
            f"the button {button.name.lower()} blinks",
            "operator",
            FROM_THEN_ON,
            _buttons(button, blinking=True),
            everywhere(is_safe()),
            recouples=True,
        )
    yield Fault("the hand goes out of reach", "operator", FROM_THEN_ON, _carried_away, _free(), far=True)
    yield Fault("the hand turns by 150 degrees", "operator", FROM_THEN_ON, _turned_over, _free(), far=True)
    yield Fault("the hand trembles by 1 mm", "operator", FROM_THEN_ON, _trembling, _trembled())
    yield Fault("nudges as large as they may be", "operator", FROM_THEN_ON, _nudging(1.0), everywhere(is_safe()))
    yield Fault("nudges of a denormal number", "operator", FROM_THEN_ON, _nudging(5e-324), goes_on_everywhere())


def _trembled() -> Expected:
    """A slow arm is at the limits of its rates all the time."""
    return everywhere(goes_on(5e-3, 0.03)._replace(follows=False))


def _free() -> Expected:
    return Expected(is_safe(Mode.APPROACH), is_safe(Mode.HOLD), goes_on())
