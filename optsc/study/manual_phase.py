"""Manual phase of an episode, lived through once up to each hand-over; from there a fork goes on to every target."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import NamedTuple, NoReturn

import numpy as np

from optsc.control.controller import SharedController
from optsc.control.controller_state import ControllerSnapshot, ControlStep
from optsc.control.modes import Mode
from optsc.display import Display
from optsc.errors import InvalidValue
from optsc.followers import IdealFollower
from optsc.followers.protocol import FollowerState
from optsc.geometry import Pose
from optsc.operators import Operator, OperatorSample
from optsc.session import Session
from optsc.study.conditions import Condition, OperatorSpec
from optsc.study.episode_setup import EpisodeSetup
from optsc.study.motion_recorder import MotionRecorder
from optsc.study.stateless_selector import StatelessSelector


class HandOver(NamedTuple):
    """A moment at which the operator hands over: everything that a choice follows from, and the way back to it.

    Attributes:
        tick: number of the tick.
        X_WT: the tool as the controller leads it.
        q: commanded configuration (n,) [rad].
        sample, measured: what came in at this tick.
        controller: the controller before this tick.
        operator: the operator after it.
    """

    tick: int
    X_WT: Pose
    q: np.ndarray
    sample: OperatorSample
    measured: FollowerState
    controller: ControllerSnapshot
    operator: Operator


class ManualPhase:
    """The controller in manual mode, tick by tick, up to one hand-over after the other."""

    def __init__(self, setup: EpisodeSetup, person: OperatorSpec, condition: Condition) -> None:
        self.setup = setup
        self.controller = setup.controller(condition, setup.tables)
        self.recorder = MotionRecorder(setup.robot, setup.settings.rate)
        self._session = Session.start(
            self.controller,
            operator=person.operator(setup.scene.goal, setup.scene.objects),
            follower=setup.follower(),
            candidates=setup.candidates,
            clear=setup.clear,
            rate=setup.settings.rate,
            display=_NoMarkers(self.controller),
        )
        self._pressed = False

    @property
    def selector(self) -> StatelessSelector:
        """The controller's selector."""
        selector = self.controller.selector
        if not isinstance(selector, StatelessSelector):
            raise TypeError("the controller's selector was exchanged")
        return selector

    def next_hand_over(self) -> HandOver | None:
        """Go on to the next moment at which the operator hands over; None when time is up before."""
        controller, session = self.controller, self._session
        while controller.time < self.setup.settings.longest:
            sample = session.read()
            pressed = self._pressed
            if sample is not None:
                self._pressed = bool(sample.trigger)
                if sample.trigger and not pressed and controller.mode is Mode.MANUAL:
                    p, q = controller.servo.reference
                    return HandOver(
                        len(self.recorder),
                        Pose(np.array(q), np.array(p)),
                        controller.servo.guard.q.copy(),
                        sample,
                        session.measured,
                        controller.snapshot(),
                        copy.deepcopy(session.operator),
                    )
            self.recorder.add(session.advance(sample))
        return None

    def refuse(self, hand_over: HandOver, condition: Condition) -> None:
        """Live through a hand-over that is refused under ``condition``; raise `RuntimeError` if it is not."""
        self.back_to(hand_over, condition)
        tick = self._session.advance(hand_over.sample)
        self.recorder.add(tick)
        if tick.mode.automatic:
            raise RuntimeError("the controller took over where it was expected to refuse")

    def back_to(self, hand_over: HandOver, condition: Condition) -> SharedController:
        """Return the controller as it was before the tick of ``hand_over``, deciding by ``condition``."""
        self.controller.restore(hand_over.controller)
        self.selector.decide_by(condition.rule, condition.measure)
        return self.controller


ARRIVED, STEPPED_IN, TIME_IS_UP = "arrived", "the operator stepped in", "time is up"


def execute(phase: ManualPhase, hand_over: HandOver, condition: Condition) -> tuple[MotionRecorder, str]:
    """Return the automatic motion from ``hand_over`` on, the manual one before it in front, and how it ended."""
    setup = phase.setup
    controller = phase.back_to(hand_over, condition)
    recorder = phase.recorder.first(hand_over.tick)
    session = Session(
        controller,
        operator=copy.deepcopy(hand_over.operator),
        follower=IdealFollower(setup.robot, setup.world.X_WO, setup.candidates).at(hand_over.measured),
        display=_NoMarkers(controller),
    )
    end = controller.time + setup.settings.longest
    tick = session.advance(hand_over.sample)
    recorder.add(tick)
    ended = ending(tick.step, True)
    while not ended and controller.time < end:
        tick = session.tick()
        recorder.add(tick)
        ended = ending(tick.step, False)
    return recorder, ended or TIME_IS_UP


def ending(step: ControlStep, first: bool) -> str:
    """Return how the first automatic motion ends with ``step``; "" while it goes on."""
    if step.mode is Mode.CLOSE:
        return ARRIVED
    if step.mode is Mode.MANUAL:
        return "refused" if first else STEPPED_IN
    if step.mode is Mode.HOLD:
        return "fault"
    return ""


class _NoMarkers(Display):
    """A display whose markers nobody may look at: until the hand-over they depend on the rule."""

    def grasps(self) -> Mapping[str, Pose]:
        return _UNSEEN


class _Unseen(Mapping[str, Pose]):
    def _refuse(self) -> NoReturn:
        raise InvalidValue("operator", "one that looks at the grasps shown", "one that moves the same under every rule")

    def __getitem__(self, name: str) -> Pose:
        self._refuse()

    def __iter__(self) -> Iterator[str]:
        self._refuse()

    def __len__(self) -> int:
        self._refuse()


_UNSEEN = _Unseen()
