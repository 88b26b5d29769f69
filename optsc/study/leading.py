"""The operator leads the arm to the hand-over, once; from there the way goes on to each target by itself."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import NamedTuple, NoReturn

import numpy as np

from optsc.control.controller import ControlStep, SharedController
from optsc.control.modes import Mode
from optsc.errors import InvalidValue
from optsc.followers import Follower
from optsc.followers.protocol import FollowerState
from optsc.geometry import Pose
from optsc.operators import Operator, OperatorSample, OperatorView
from optsc.robot import RobotModel
from optsc.sim.settings import PhysicsSettings
from optsc.study.conditions import Condition, OperatorSpec
from optsc.study.episode_setup import EpisodeSetup
from optsc.study.fresh import FreshSelector
from optsc.study.memento import Memento
from optsc.study.tracks import Track


class HandOver(NamedTuple):
    """A moment at which the operator hands over: everything that a choice follows from, and the way back to it.

    Attributes:
        tick: number of the tick.
        X_WT: the tool as the controller leads it.
        q: commanded posture (n,) [rad].
        sample, measured: what came in at this tick.
        memento, operator: the controller before this tick; the operator after it.
    """

    tick: int
    X_WT: Pose
    q: np.ndarray
    sample: OperatorSample
    measured: FollowerState
    memento: Memento
    operator: Operator


class Leading:
    """The operator leads: the controller in manual mode, tick by tick, up to one hand-over after the other."""

    def __init__(self, stage: EpisodeSetup, person: OperatorSpec, condition: Condition) -> None:
        self.stage = stage
        self.controller = stage.controller(condition, stage.tables)
        self.track = Track(stage.robot, stage.settings.rate)
        self._operator = person.operator(stage.scene.goal, stage.scene.objects)
        robot, settings = stage.robot, stage.settings
        self._follower: Follower = stage.follower()
        self.controller.reset(robot.home, settings.rate)
        self._measured = self._follower.reset(robot.home)
        self.controller.observe(stage.candidates, stage.clear)
        self._pressed = False

    @property
    def selector(self) -> FreshSelector:
        """The controller's selector."""
        selector = self.controller.selector
        if not isinstance(selector, FreshSelector):
            raise TypeError("the controller's selector was exchanged")
        return selector

    def next_hand_over(self) -> HandOver | None:
        """Go on to the next moment at which the operator hands over; None when time is up before."""
        stage, controller = self.stage, self.controller
        while controller.time < stage.settings.longest:
            view = _view(controller, stage.robot, self._measured, None, self._follower.objects())
            sample = self._operator.read(view)
            pressed = self._pressed
            if sample is not None:
                self._pressed = bool(sample.trigger)
                if sample.trigger and not pressed and controller.mode is Mode.MANUAL:
                    p, q = controller.servo.reference
                    return HandOver(
                        len(self.track),
                        Pose(np.array(q), np.array(p)),
                        controller.servo.guard.q.copy(),
                        sample,
                        self._measured,
                        Memento(controller, shared=(controller.selector, stage.clear, stage.candidates)),
                        copy.deepcopy(self._operator),
                    )
            self._advance(sample)
        return None

    def go_on(self, hand_over: HandOver, condition: Condition) -> None:
        """Live through a hand-over that is refused under ``condition``; raise `RuntimeError` if it is not."""
        self.back_to(hand_over, condition)
        if self._advance(hand_over.sample).mode.automatic:
            raise RuntimeError("the controller took over where it was expected to refuse")

    def back_to(self, hand_over: HandOver, condition: Condition) -> SharedController:
        """Return the controller as it was before the tick of ``hand_over``, deciding by ``condition``."""
        hand_over.memento.restore()
        self.selector.decide_by(condition.rule, condition.measure)
        return self.controller

    def _advance(self, sample: OperatorSample | None) -> ControlStep:
        step = self.controller.step(sample, self._measured)
        self.track.add(step, sample)
        period = 1.0 / self.stage.settings.rate
        self._measured = self._follower.apply(step.command.q, step.command.v, step.opening, period)
        return step


def execute(leading: Leading, hand_over: HandOver, condition: Condition) -> tuple[Track, str]:
    """Return the automatic motion from ``hand_over`` on, the manual one before it in front, and how it ended."""
    stage = leading.stage
    controller = leading.back_to(hand_over, condition)
    track = leading.track.first(hand_over.tick)
    operator, measured = copy.deepcopy(hand_over.operator), hand_over.measured
    sample: OperatorSample | None = hand_over.sample
    period, end = 1.0 / stage.settings.rate, controller.time + stage.settings.longest
    while controller.time < end:
        step = controller.step(sample, measured)
        track.add(step, sample)
        ended = ending(step, len(track) - 1 == hand_over.tick)
        if ended:
            return track, ended
        measured = _followed(measured, step, period)
        view = _view(controller, stage.robot, measured, step, stage.world.X_WO)
        sample = operator.read(view)
    return track, "time is up"


ARRIVED, STEPPED_IN = "arrived", "the operator stepped in"


def ending(step: ControlStep, first: bool) -> str:
    """Return how the first automatic motion ends with ``step``; "" while it goes on."""
    if step.mode is Mode.CLOSE:
        return ARRIVED
    if step.mode is Mode.MANUAL:
        return "refused" if first else STEPPED_IN
    if step.mode is Mode.HOLD:
        return "fault"
    return ""


class _Unseen(Mapping[str, Pose]):
    """The markers of the ranking, which nobody here may look at: until the hand-over they depend on the rule."""

    def _refuse(self) -> NoReturn:
        raise InvalidValue(
            "operator", "one that looks at the grasps shown", "one that moves the same under every rule"
        )

    def __getitem__(self, name: str) -> Pose:
        self._refuse()

    def __iter__(self) -> Iterator[str]:
        self._refuse()

    def __len__(self) -> int:
        self._refuse()


_UNSEEN = _Unseen()


def _view(
    controller: SharedController,
    robot: RobotModel,
    measured: FollowerState,
    step: ControlStep | None,
    objects: Mapping[str, Pose],
) -> OperatorView:
    """Return what the operator sees after ``step``, the last one; None for one in manual mode."""
    automatic = step is not None and step.mode.automatic
    target = step.target.object_name if automatic and step is not None and step.target is not None else None
    X_WT = robot.forward(measured.q)
    return OperatorView(controller.time, X_WT, automatic, controller.finished, objects, _UNSEEN, target)


def _followed(last: FollowerState, step: ControlStep, period: float) -> FollowerState:
    """Return where `IdealFollower` would be after ``step``; it has no way to start from the middle of a run."""
    way = PhysicsSettings.jaw_speed * period
    jaws = min(max(step.opening, last.opening - way), last.opening + way)
    return FollowerState(last.time + period, step.command.q.copy(), step.command.v.copy(), jaws)
