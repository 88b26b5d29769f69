"""The engine: many conditions in one scene for little more than the price of one.

What does not depend on the condition is done once. The arm's geometry (grasps, reach, collisions) is solved once for
each configuration at which a decision is made. The operator leads the arm to the hand-over once, since until then no
rule has a say. And each distinct target is executed once, however many rules choose it. A test holds the result equal,
to the last bit, to that of `optsc.session.run` for every condition by itself.

An episode counts up to the end of the first automatic motion: the arm arrives at the grasp, or something ends the
motion before, or the operator steps in because the wrong object is approached. Where the controller refuses (no grasp
can be reached), the operator tries again, as in a plain run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from optsc.control.deciding import CHOICES
from optsc.control.modes import Mode
from optsc.control.path_feasibility import PathFeasibility, grasp_path_feasibility, most_feasible
from optsc.errors import InvalidValue
from optsc.metrics import is_lifted
from optsc.records import Tick
from optsc.selection import Ranking, Target
from optsc.session import Session
from optsc.study.conditions import Condition, OperatorSpec
from optsc.study.episode_setup import EpisodeSettings, EpisodeSetup, episode_key
from optsc.study.manual_phase import TIME_IS_UP, HandOver, ManualPhase, ending, execute
from optsc.study.motion_recorder import MotionRecorder
from optsc.study.scenes import Scene

LONGEST_MOTION = 30.0
"""Time that the robot has in a simulated world from the last moment at which it may take over [s]."""


class Executed(NamedTuple):
    """A motion, the operator's part in front; how it ended; whether the goal was lifted, None where nobody can tell."""

    motion: MotionRecorder
    ended: str
    lifted: bool | None = None


@dataclass(frozen=True, eq=False)
class Choice:
    """What a condition chose at a hand-over: the target, and the ranking that it was chosen from."""

    hand_over: int
    target: Target
    ranking: Ranking
    place: int
    """How many better ranked grasps were passed over, because no straight path leads to them, or none that is free."""


def choose(
    phase: ManualPhase,
    hand_over: HandOver,
    index: int,
    condition: Condition,
    paths: dict[tuple[int, bool], PathFeasibility],
) -> Choice | None:
    """Return what the controller chooses at ``hand_over``, the one of number ``index``; None where it refuses.

    It is the controller's own decision, but for ``paths``: how feasible the straight paths to grasps are is
    remembered there.
    """
    setup, selector = phase.setup, phase.selector
    selector.decide_by(condition.rule, condition.measure)
    ranking = selector.rank(hand_over.X_WT, hand_over.q, refresh_limit=1)
    if ranking.best is None:
        return None
    places = ranking.of(ranking.best)[:CHOICES].tolist()

    def feasibility(place: int) -> PathFeasibility:
        target = ranking.target_of(places[place])
        path = (target.candidate, target.half_turn)
        if path not in paths:
            paths[path] = grasp_path_feasibility(
                setup.robot,
                setup.settings.approach,
                hand_over.q,
                hand_over.X_WT,
                target,
                setup.candidates,
                setup.clear,
            )
        return paths[path]

    place = most_feasible(range(len(places)), feasibility)
    return None if place is None else Choice(index, ranking.target_of(places[place]), ranking, place)


def execute_physically(setup: EpisodeSetup, person: OperatorSpec, condition: Condition) -> Executed:
    """Return the motion in a simulated world, in a run of its own from the start, and whether the goal was lifted.

    A physics engine cannot be set back to the hand-over to the last bit; but it gives the same bytes after every
    reset, so a run that repeats the operator's part arrives at the same hand-over.
    """
    recorder, heights = MotionRecorder(setup.robot, setup.settings.rate), []
    began, ended = False, ""
    with setup.follower() as follower:
        session = Session.start(
            setup.controller(condition, setup.tables),
            operator=person.operator(setup.scene.goal, setup.scene.objects),
            follower=follower,
            candidates=setup.candidates,
            clear=setup.clear,
            rate=setup.settings.rate,
        )

        def sink(tick: Tick) -> None:
            nonlocal began, ended
            heights.append(tick.objects[setup.scene.goal].translation[2])
            if not ended:
                recorder.add(tick)
                began = began or tick.mode is Mode.APPROACH
                ended = ending(tick.step, False) if began else ""

        end, controller = setup.settings.longest + LONGEST_MOTION, session.controller
        # Up to the end of the first automatic motion: what the operator tries after it does not count.
        while controller.time < end and not controller.finished and not (began and not controller.mode.automatic):
            sink(session.tick())
    return Executed(recorder, ended or TIME_IS_UP, is_lifted(heights, setup.settings.rate))


class Engine:
    """All conditions of one person in one scene; see the module."""

    def __init__(self, scene: Scene, person: OperatorSpec, settings: EpisodeSettings | None = None) -> None:
        if person.steps_in:
            raise InvalidValue("person", person.kind, "one who does not step in on the way, see `optsc.people.TYPES`")
        self.setup, self.person = EpisodeSetup(scene, settings or EpisodeSettings()), person
        self.key = episode_key(scene, person, self.setup.settings)
        self._phase: ManualPhase | None = None
        self._hand_overs: list[HandOver | None] = []
        self._paths: list[dict[tuple[int, bool], PathFeasibility]] = []
        self._motions: dict[tuple[int, int, bool], Executed] = {}

    def hand_over(self, index: int) -> HandOver | None:
        """Return the hand-over of that number, as far as it has been come to; None where the time was up."""
        return self._hand_overs[index] if index < len(self._hand_overs) else None

    @property
    def executions(self) -> int:
        """How many motions were executed so far."""
        return len(self._motions)

    def choices(self, conditions: Sequence[Condition]) -> list[Choice | None]:
        """Return what each condition chooses, None where it never finds anything within the time."""
        found: list[Choice | None] = [None] * len(conditions)
        waiting = list(range(len(conditions)))
        index = 0
        while waiting:
            hand_over = self._come_to(index, conditions[waiting[0]])
            if hand_over is None or self._phase is None:
                break
            for i in waiting:
                found[i] = choose(self._phase, hand_over, index, conditions[i], self._paths[index])
            waiting = [i for i in waiting if found[i] is None]
            index += 1
        return found

    def motion(self, condition: Condition, choice: Choice) -> Executed:
        """Return the motion to what was chosen under ``condition``, executed at most once for each target."""
        target = choice.target
        place = (choice.hand_over, target.candidate, target.half_turn)
        if place not in self._motions:
            hand_over = self._hand_overs[choice.hand_over]
            if hand_over is None or self._phase is None:
                raise InvalidValue("hand-over of a choice", choice.hand_over, "one of this engine's")
            if self.setup.settings.follower == "pybullet":
                executed = execute_physically(self.setup, self.person, condition)
            else:
                executed = Executed(*execute(self._phase, hand_over, condition))
            self._motions[place] = executed
        return self._motions[place]

    def _come_to(self, index: int, refusing: Condition) -> HandOver | None:
        """Return a hand-over; all before it are refused, as they are under ``refusing``."""
        if self._phase is None:
            self._phase = ManualPhase(self.setup, self.person, refusing)
        if index == len(self._hand_overs):
            last = self._hand_overs[-1] if self._hand_overs else None
            if last is not None:
                self._phase.refuse(last, refusing)
            self._hand_overs.append(self._phase.next_hand_over())
            self._paths.append({})
        return self._hand_overs[index]
