"""State of the shared controller, what it decides at a tick, and its snapshots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

from optsc.control.activities import Activity, Assistance
from optsc.control.choice_state import ChoiceState
from optsc.control.fine_tuning import Tuning
from optsc.control.holding import Holding
from optsc.control.jaws import Held, Jaws
from optsc.control.measured_arm import MeasuredArm
from optsc.control.modes import Event, Mode
from optsc.control.operator_input import InputMonitor
from optsc.control.state import ServoSnapshot, same
from optsc.control.status import Command
from optsc.operators import ClutchSettings
from optsc.operators.smoothing import Smoothing
from optsc.selection import Ranking, Target
from optsc.selection.selector_state import SelectorState


class ControllerState(NamedTuple):
    """What a shared controller remembers from tick to tick, besides the servo's numbers and the selector's state.

    Attributes:
        clutch: how the hand's motion maps to the tool's; `SharedController.recentre` and `couple_by` change it.
        smoothing: how the hand is smoothed before that, if at all; `SharedController.couple_by` changes it.
        opening: commanded distance of the jaws [m].
        jaws: what is known of them, and what they hold.
        mode, entered: the control mode, and since when [s].
        activity: what is done in it.
        monitor: the operator's last sample.
        arm: where the arm is measured to be.
        wish: how the operator has asked to leave hold, until the arm is ready for it.
        choice: what is known of the grasps and of the intended object.
        target: the grasp that is being executed.
        tuning: the same while the operator may shift it.
        confirmed: whether the operator has confirmed it.
        stepped_in: whether the operator has taken over from the robot.
        tried: when the robot tried to begin by itself last [s].
        doubt: why the target can no longer be trusted, in words.
        touchable: the obstacle that the hand may touch.
        pressed: when the trigger was pressed last [s].
        moved: names of objects that have been let go of elsewhere than where they were observed.
        tasks: how many objects have been carried long enough, or put down.
        counted: whether the one in the jaws is among them.
        stop: why the arm holds, in words, for as long as it does.
        failure: what the last tick failed with, in words; empty where it did not.
    """

    clutch: ClutchSettings
    smoothing: Smoothing | None
    opening: float
    mode: Mode = Mode.HOLD
    entered: float = 0.0
    activity: Activity = Holding()
    monitor: InputMonitor = InputMonitor()
    arm: MeasuredArm = MeasuredArm()
    wish: Event | None = None
    choice: ChoiceState = ChoiceState()
    target: Target | None = None
    tuning: Tuning | None = None
    confirmed: bool = False
    stepped_in: bool = False
    tried: float = -inf
    doubt: str = ""
    touchable: str | None = None
    pressed: float = -inf
    moved: frozenset[str] = frozenset()
    tasks: int = 0
    counted: bool = False
    stop: str = ""
    failure: str = ""
    jaws: Jaws = Jaws()

    @property
    def held(self) -> Held | None:
        """What is between the jaws; None where nothing is known to be."""
        return self.jaws.held


@dataclass(frozen=True, eq=False, slots=True)
class ControllerSnapshot:
    """The whole state of a shared controller at one moment, see `SharedController.snapshot`."""

    state: ControllerState
    servo: ServoSnapshot
    selector: SelectorState

    def __eq__(self, other: object) -> bool:
        return same(self, other)


class ControlStep(NamedTuple):
    """What the controller decided at one tick.

    Attributes:
        time: since the reset [s].
        mode: the mode of this tick.
        event: what happened at this tick, if anything.
        command: the joint command.
        opening: commanded distance of the jaws [m].
        ranking: the newest ranking, None before there are candidates.
        target: the grasp that is being executed, None in manual mode.
        reason: why motion is held back or a request refused, in words; empty when all is well.
        belief: how likely each object is intended, where a belief is kept.
        assistance: how the hand's velocity and the robot's were blended, where they were.
        held: what the jaws are measured to hold, None for nothing.
    """

    time: float
    mode: Mode
    event: Event | None
    command: Command
    opening: float
    ranking: Ranking | None
    target: Target | None
    reason: str
    belief: Mapping[str, float] | None = None
    assistance: Assistance | None = None
    held: Held | None = None
