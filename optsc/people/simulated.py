"""Simulated operator: reaches for objects by hand, hands over to the robot, steps in again."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import rotation
from optsc.operators.sample import OperatorSample, OperatorView
from optsc.people.decision import Phase, SimulatedPerson
from optsc.people.parameters import AimParameters, HumanParameters, Intention, OperatorType, operator_type

R_WS_DEFAULT = (sqrt(0.5), 0.0, 0.0, sqrt(0.5))
"""The station turned by 90 degrees about the vertical (w, x, y, z): the operator sits beside the robot."""

_CATCH_UP = 900
"""Most samples lived through in one call: who is not asked for longer than that has sat still."""


class Simulated:
    """An `Operator` that plays a person with the habits of ``human``.

    The person thinks in the paper's mapping: the tool turns as the hand does, R_WT = R_WS R_SH, and moves as
    the hand moves, by R_WS times its displacement. A ready pose near the object is reached with one primary
    movement; as long as the tool is seen elsewhere, corrective movements follow one after another (move and
    wait, Ferrell 1965). The trigger hands over. If the robot abandons the motion, or never starts, the person aims a
    little differently and triggers again; where the plan says so, takes over and goes on with the next Intention;
    takes over too where the robot is seen to go for another object, and shows it once more which one is wanted.
    When the task is finished, or the plan is, the hand rests for good.

    Where the trigger closes the jaws (``by_hand``), the person goes on from about the ready pose to the pre-grasp and
    to the grasp that is shown for the object by then, and triggers there; a planned change of mind comes before that.

    Everything random comes from ``seed``: the same views give the same samples, bit for bit, and what trembles and
    drifts is the same whatever the views. One object plays one run.

    Args:
        seed: of everything random.
        plan: intentions in order; None: one object of the first view, chosen at random.
        R_WS: orientation of the station frame S in the world (w, x, y, z); the controller gets the same.
        human: motor habits.
        aims: which ready poses the person likes.
        by_hand: whether the trigger closes the jaws, instead of handing over.

    Raises `InvalidValue` for an empty plan or a quaternion that is not unit; the first `read` raises
    `UnknownName` when the view lacks an object of the plan, and `InvalidValue` when it has no object at all.
    """

    def __init__(
        self,
        seed: int,
        plan: Sequence[Intention] | None = None,
        R_WS: ArrayLike = R_WS_DEFAULT,
        human: HumanParameters | None = None,
        aims: AimParameters | None = None,
        by_hand: bool = False,
    ) -> None:
        if plan is not None and len(plan) == 0:
            raise InvalidValue("plan", plan, "at least one Intention, or None")
        self.R_WS = rotation.checked(R_WS, "R_WS")
        self.human = human or HumanParameters()
        self.aims = aims or AimParameters()
        self._plan = None if plan is None else tuple(plan)
        self.by_hand = by_hand
        self._rng = np.random.default_rng(seed)
        self._person: SimulatedPerson | None = None
        self._start, self._next = 0.0, 0

    @classmethod
    def of_type(
        cls,
        kind: str | OperatorType,
        wanted: str,
        objects: Collection[str],
        *,
        seed: int,
        R_WS: ArrayLike = R_WS_DEFAULT,
        by_hand: bool = False,
    ) -> Simulated:
        """Return a person of a kind, or of the built-in kind of that name, who wants one of ``objects``.

        Raises:
            UnknownName: no such kind or object.
        """
        kind = operator_type(kind) if isinstance(kind, str) else kind
        return cls(seed, kind.plan(wanted, objects, seed), R_WS, kind.human, by_hand=by_hand)

    @property
    def plan(self) -> tuple[Intention, ...] | None:
        """The intentions; with none given, the one chosen at the first view, and None before it."""
        return self._plan

    @property
    def doing(self) -> str:
        """What the person is about, in words."""
        return Phase.REST.value if self._person is None else self._person.phase.value

    def read(self, view: OperatorView) -> OperatorSample | None:
        """Return the newest sample of the tracker if its time has come since the last call, else None."""
        if self._person is None:
            self._plan = _plan_for(self._rng, self._plan, view)
            self._person = SimulatedPerson(self._rng, self._plan, self.R_WS, self.human, self.aims, self.by_hand, view)
            self._start = view.time
        # The thousandth of a period absorbs the rounding of a clock that adds up its ticks.
        due = int((view.time - self._start) * self.human.sample_rate + 1e-3)
        if due < self._next:
            return None
        for index in range(max(self._next, due - _CATCH_UP), due):
            self._person.step(self._start + index / self.human.sample_rate, view)
        stamp = self._start + due / self.human.sample_rate
        X_SH, clutch, trigger = self._person.step(stamp, view)
        self._next = due + 1
        return OperatorSample(stamp, X_SH, clutch=clutch, trigger=trigger)


def _plan_for(
    rng: np.random.Generator, plan: tuple[Intention, ...] | None, view: OperatorView
) -> tuple[Intention, ...]:
    names = sorted(view.objects)
    if not names:
        raise InvalidValue("objects in the operator's view", names, "at least one object to reach for")
    if plan is None:
        return (Intention(names[int(rng.integers(len(names)))]),)
    for intention in plan:
        if intention.object not in view.objects:
            raise UnknownName("object", intention.object, names)
    return plan
