"""Faults of parts that a user may have written: QP solver, policy, cost, filter, inverse kinematics, collision check.

Besides: a time law that cannot be made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import patch

import numpy as np

from optsc.control.arbitration import Blend
from optsc.control.modes import Mode
from optsc.errors import SolverFailure
from optsc.ik.solvers import QpSolution, Rows
from optsc.operators import Button, OperatorSample
from optsc.shaping.time_law import PathPoint
from optsc.study.faults.fault import (
    FROM_THEN_ON,
    ONCE,
    Expected,
    Fault,
    Hook,
    Inject,
    Injection,
    everywhere,
    goes_on,
    goes_on_everywhere,
    holds,
    is_safe,
    stops,
)
from optsc.study.faults.sample_faults import INF, NAN, Raises
from optsc.study.faults.world import World


class FailureError(Exception):
    """What a part of the user's raises; it cannot even say why."""

    def __str__(self) -> str:
        raise RuntimeError


def fails(*_: Any) -> Any:
    """Raise."""
    raise FailureError


def interrupted(*_: Any) -> Any:
    """Be interrupted from the keyboard."""
    raise KeyboardInterrupt


def answers(value: Any) -> Hook:
    """Return a hook that answers with the same every time."""
    return lambda genuine, arguments: value


def alters(change: Callable[[Any], Any]) -> Hook:
    """Return a hook that alters the true answer."""
    return lambda genuine, arguments: change(genuine(*arguments))


def part(*names: str, hook: Hook) -> Inject:
    """Return a fault of user-defined parts."""
    return lambda _, __: Injection(parts=dict.fromkeys(names, hook))


def _solved(x: Callable[[int], Any]) -> Hook:
    return lambda genuine, arguments: QpSolution(x(len(arguments[1])), True, 1)


def _spoils(genuine: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """Write into everything that is given, where that is allowed, and answer as if nothing were."""
    answer = genuine(*arguments)
    for argument in arguments:
        for array in argument if isinstance(argument, Rows) else [argument]:
            if isinstance(array, np.ndarray) and array.flags.writeable:
                array[...] = 1e6
    return answer


SOLVERS: dict[str, Hook] = {
    "raises": fails,
    "says that it is infeasible": lambda _, a: QpSolution(np.zeros(len(a[1])), False, 7, "infeasible"),
    "answers nothing": answers(None),
    "answers a word": answers("solved"),
    "answers an object that raises": answers(Raises()),
    "answers no numbers, called solved": _solved(lambda n: np.full(n, NAN)),
    "answers infinity, called solved": _solved(lambda n: np.full(n, -INF)),
    "answers one number too few": _solved(lambda n: np.zeros(n - 1)),
    "answers one number too many": _solved(lambda n: np.zeros(n + 1)),
    "answers a matrix": _solved(lambda n: np.zeros((n, n))),
    "answers a number": _solved(lambda n: 0.0),
    "answers words, called solved": _solved(lambda n: np.array(["v"] * n)),
    "answers nothing, called solved": _solved(lambda n: None),
    "answers complex numbers": _solved(lambda n: np.full(n, 1j)),
}
"""Solvers without an answer."""
WRONG: dict[str, Hook] = {
    "answers far beyond the bounds": _solved(lambda n: np.full(n, 1e6)),
    "answers 1e300": _solved(lambda n: np.full(n, 1e300)),
    "answers denormal numbers": _solved(lambda n: np.full(n, 5e-324)),
    "answers rest every time": _solved(np.zeros),
    "answers the opposite": alters(lambda s: s._replace(x=-s.x)),
    "answers at random": lambda _, a: QpSolution(np.random.default_rng(3).normal(size=len(a[1])), True, 1),
}
"""Solvers with an answer that is none, which cannot be told."""
UNSOLVED = Expected(stops(), stops(), holds())
_ALL_STOP = everywhere(holds())


def _solver_faults() -> Iterator[Fault]:
    for name, hook in SOLVERS.items():
        inject = part("solver", hook=hook)
        yield Fault(f"the QP solver once {name}", "solver", ONCE, inject, everywhere(is_safe()))
        yield Fault(f"the QP solver {name}", "solver", FROM_THEN_ON, inject, UNSOLVED)
    for name, hook in WRONG.items():
        yield Fault(
            f"the QP solver {name}", "solver", FROM_THEN_ON, part("solver", hook=hook), everywhere(is_safe()), far=True
        )
    spoiled = part("solver", hook=_spoils)
    yield Fault("the QP solver writes into what it is given", "solver", FROM_THEN_ON, spoiled, goes_on_everywhere())
    stopped = part("solver", hook=interrupted)
    yield Fault("Ctrl-C in the QP solver", "solver", ONCE, stopped, goes_on_everywhere(), interrupts=True)


POLICIES: dict[str, Hook] = {
    "raises": fails,
    "answers nothing": answers(None),
    "answers a word": answers("all yours"),
    "answers no numbers": answers(Blend(np.full((6, 6), NAN), np.zeros(6), 0.0)),
    "answers infinity": answers(Blend(np.eye(6), np.full(6, INF), 0.0)),
    "answers a vector for a matrix": answers(Blend(np.ones(6), np.zeros(6), 0.0)),
    "answers in three dimensions": answers(Blend(np.eye(3), np.zeros(3), 0.0)),
    "answers words": answers(Blend("A", "r", "share")),  # type: ignore[arg-type]
    "has a share that is no number": answers(Blend(np.eye(6), np.zeros(6), NAN)),
    "answers two things": answers((np.eye(6), np.zeros(6))),
}
HUGE: dict[str, Hook] = {
    "answers 1e6": answers(Blend(1e6 * np.eye(6), np.full(6, 1e6), 2.0)),
    "turns the hand around": answers(Blend(-np.eye(6), np.zeros(6), -1.0)),
    "answers at random": lambda _, __: Blend(np.random.default_rng(5).normal(size=(6, 6)), np.ones(6), 0.5),
}
_BY_HAND_AT_LAST = dict.fromkeys((Mode.RELEASE, Mode.RETREAT), is_safe())
"""After these the operator leads the arm again."""
BY_POLICY = Expected(holds("Error", "blend", "policy", "user-defined"), holds(), goes_on(), _BY_HAND_AT_LAST)


def _policy_faults() -> Iterator[Fault]:
    for name, hook in POLICIES.items():
        inject = part("policy", hook=hook)
        yield Fault(f"the policy once {name}", "policy", ONCE, inject, everywhere(is_safe()), assisted=True)
        yield Fault(f"the policy {name}", "policy", FROM_THEN_ON, inject, BY_POLICY, assisted=True)
    for name, hook in HUGE.items():
        inject = part("policy", hook=hook)
        safe = everywhere(is_safe())
        yield Fault(f"the policy {name}", "policy", FROM_THEN_ON, inject, safe, assisted=True, recouples=True, far=True)
    yield Fault(
        "the policy writes into what it is given",
        "policy",
        FROM_THEN_ON,
        part("policy", hook=_spoils_moment),
        everywhere(is_safe()),
        assisted=True,
        recouples=True,
    )
    yield Fault(
        "the policy fails to say whether it begins",
        "policy",
        FROM_THEN_ON,
        part("begins", hook=fails),
        BY_POLICY,
        assisted=True,
    )
    yield Fault(
        "Ctrl-C in the policy",
        "policy",
        ONCE,
        part("policy", hook=interrupted),
        goes_on_everywhere(),
        assisted=True,
        interrupts=True,
    )


def _spoils_moment(genuine: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    answer = genuine(*arguments)
    moment = arguments[0]
    for array in (moment.hand, moment.last.hand, moment.last.robot):
        if array.flags.writeable:
            array[...] = 1e6
    return answer


COLUMNS: dict[str, Hook] = {
    "raises": fails,
    "answers nothing": answers(None),
    "answers a word": answers("cheap"),
    "answers a wrong shape": answers(np.zeros((7, 3, 2))),
    "answers words": alters(lambda values: np.full(values.shape, "a")),
    "raises in its answer": answers(Raises()),
}
NOT_FINITE: dict[str, Hook] = {
    "answers no numbers": alters(lambda values: np.full(values.shape, NAN)),
    "answers infinity": alters(lambda values: np.full(values.shape, INF)),
    "answers one number": answers(0.0),
}
MASKS: dict[str, Hook] = {
    "raises": fails,
    "answers nothing": answers(None),
    "answers a word": answers("pass"),
    "answers a wrong shape": answers(np.ones((7, 3, 2), dtype=bool)),
}
ODD_MASKS: dict[str, Hook] = {
    "answers numbers": alters(lambda mask: mask.astype(float)),
    "lets none pass": alters(np.zeros_like),
    "answers no numbers": alters(lambda mask: np.full(mask.shape, NAN)),
}
BY_RANKING = Expected(holds(), holds(), goes_on(), _BY_HAND_AT_LAST)
"""Candidates are ranked while the hand leads the arm."""
ASKED_RARELY = everywhere(is_safe())
"""The part may not be asked at all within the time."""


def _triggers(_: float, sample: OperatorSample) -> OperatorSample:
    """Hand over to the robot, or ask for the next grasp, half way through the fault."""
    pressed = 0.6 < _ < 0.7
    return sample._replace(trigger=pressed)


def _next(elapsed: float, sample: OperatorSample) -> OperatorSample:
    pressed = 0.3 < elapsed < 0.4
    return sample._replace(buttons=frozenset({Button.NEXT}) if pressed else frozenset())


def decided(hooks: dict[str, Hook]) -> Inject:
    """Return a fault of parts that are asked when a grasp is chosen, and let one be chosen."""

    def inject(world: World, _: np.random.Generator) -> Injection:
        by_robot = world.controller.mode.automatic
        return Injection(parts=hooks, hand=_next if by_robot else _triggers)

    return inject


def _selection_faults() -> Iterator[Fault]:
    for kind, hooks, odd in (("cost", COLUMNS, NOT_FINITE), ("filter", MASKS, ODD_MASKS)):
        for name, hook in hooks.items():
            inject = part(kind, hook=hook)
            yield Fault(f"a {kind} once {name}", "selection", ONCE, inject, everywhere(is_safe()))
            yield Fault(f"a {kind} {name}", "selection", FROM_THEN_ON, inject, BY_RANKING)
        for name, hook in odd.items():
            yield Fault(f"a {kind} {name}", "selection", FROM_THEN_ON, part(kind, hook=hook), everywhere(is_safe()))
    spoils = Expected(is_safe(), is_safe(), goes_on(), _BY_HAND_AT_LAST)
    inject = part("cost", "filter", hook=_spoils_situation)
    yield Fault("a cost writes into what it is given", "selection", FROM_THEN_ON, inject, spoils)
    for name, hook in {**MASKS, "raises in its answer": answers(Raises())}.items():
        yield Fault(
            f"the collision check {name}",
            "selection",
            FROM_THEN_ON,
            decided({"clear": hook}),
            ASKED_RARELY,
            recouples=True,
        )
    solutions: dict[str, Hook] = {
        "raises": fails,
        "answers nothing": answers(None),
        "answers no numbers": alters(lambda found: (np.full_like(found[0], NAN), found[1])),
        "answers too few": alters(lambda found: (found[0][:-1], found[1][:-1])),
        "answers all wrong": alters(lambda found: (found[0] + 1.0, np.ones_like(found[1]))),
    }
    for name, hook in solutions.items():
        hooks = {"inverse kinematics": hook}
        yield Fault(
            f"inverse kinematics {name}", "selection", FROM_THEN_ON, decided(hooks), ASKED_RARELY, recouples=True
        )


def _spoils_situation(genuine: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    answer = genuine(*arguments)
    situation = arguments[0]
    for array in (situation.position, situation.quaternion, situation.q, situation.similarity):
        if isinstance(array, np.ndarray) and array.flags.writeable:
            array[...] = 1e6
    return answer


class _NoLaw:
    def __init__(self, *_: Any) -> None:
        raise SolverFailure("no time law: Ruckig answers Error")


class _WrongLaw:
    """A time law whose points are no numbers."""

    duration, length = 1.0, 1.0

    def __init__(self, *_: Any) -> None:
        pass

    def at(self, time: float) -> PathPoint:
        """Return no number."""
        return PathPoint(NAN, NAN, NAN)


def _law(replacement: type) -> Inject:
    """Let the next path have no time law, and begin one: at the hand-over, or at the pre-grasp."""

    def inject(world: World, _: np.random.Generator) -> Injection:
        patched = patch("optsc.control.approach.TimeLaw", replacement)
        by_robot = world.controller.mode.automatic

        def hand(elapsed: float, sample: OperatorSample) -> OperatorSample:
            pressed = 0.3 < elapsed < 0.4
            if by_robot:
                return sample._replace(buttons=frozenset({Button.CONFIRM}) if pressed else frozenset())
            return sample._replace(trigger=0.6 < elapsed < 0.7)

        def start(_: World) -> None:
            patched.start()

        def end(_: World) -> None:
            patched.stop()

        return Injection(start=start, end=end, hand=hand)

    return inject


def _time_law_faults() -> Iterator[Fault]:
    # Elsewhere no path may begin within the time.
    expected = Expected(holds(), holds(), is_safe(), {Mode.ADJUST: holds()})
    for name, law in (("fails", _NoLaw), ("is no number", _WrongLaw)):
        yield Fault(f"the time law {name}", "time law", FROM_THEN_ON, _law(law), expected, recouples=True)


def _avoidance_faults() -> Iterator[Fault]:
    def rows(n: int, value: float) -> Rows:
        return Rows(np.full((1, n), value), np.array([value]), np.array([value]), 10.0)

    bad: dict[str, Hook] = {
        "raises": fails,
        "answers a word": answers("rows"),
        "answers rows of a wrong length": lambda _, a: rows(len(a[0]) + 1, 0.0),
        "answers rows that are no numbers": lambda _, a: rows(len(a[0]), NAN),
        "raises in its answer": answers(Raises()),
    }
    for name, hook in bad.items():
        yield Fault(f"avoidance {name}", "avoidance", FROM_THEN_ON, part("rows", hook=hook), UNSOLVED)
    spoils = part("rows", "stopping", "blocking", hook=_spoils)
    yield Fault("avoidance writes into what it is given", "avoidance", FROM_THEN_ON, spoils, goes_on_everywhere())
    stopping: dict[str, Hook] = {
        "raises": fails,
        "answers no numbers": alters(lambda v: v * NAN),
        "answers 1e300": alters(lambda v: v + 1e300),
        "answers a wrong length": alters(lambda v: v[:-1]),
        "answers nothing": answers(None),
    }
    for name, hook in stopping.items():
        yield Fault(
            f"avoidance asked how to stop {name}",
            "avoidance",
            FROM_THEN_ON,
            part("stopping", hook=hook),
            everywhere(is_safe()),
        )
    yield Fault("avoidance raises (snapshot)", "avoidance", FROM_THEN_ON, part("snapshot", hook=fails), _ALL_STOP)
    both = part("rows", "restore", hook=fails)
    yield Fault("avoidance raises (rows and restore)", "avoidance", FROM_THEN_ON, both, UNSOLVED)
    for name in ("blocking", "obstacles", "hand may touch"):
        yield Fault(
            f"avoidance raises ({name})", "avoidance", FROM_THEN_ON, part(name, hook=fails), everywhere(is_safe())
        )


def faults() -> Iterator[Fault]:
    """Yield them all."""
    yield from _solver_faults()
    yield from _policy_faults()
    yield from _selection_faults()
    yield from _time_law_faults()
    yield from _avoidance_faults()
