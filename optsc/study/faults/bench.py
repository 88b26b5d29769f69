"""The fault test: every fault in every mode on every arm, and the table of what came of it."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from zlib import crc32

from optsc.checks import Positive, require
from optsc.control.modes import Mode
from optsc.errors import InvalidValue, UnknownName
from optsc.processes import process_pool
from optsc.study.faults import world
from optsc.study.faults.arms import ARMS, DEFAULT_ARMS
from optsc.study.faults.catalogue import FAULTS
from optsc.study.faults.check import problems
from optsc.study.faults.fault import KINDS, Fault
from optsc.study.faults.run import run
from optsc.study.faults.session_faults import session_problems
from optsc.study.faults.world import World

MODES = tuple(mode.value for mode in world.MODES)
"""Names of the modes that a fault is done in."""
RATE = 250.0
"""Control rate [Hz] where nothing else is said."""


class Case(NamedTuple):
    """One run: arm, mode and fault by their names, the seed of the test, and the control rate [Hz]."""

    arm: str
    mode: str
    fault: str
    seed: int
    rate: float

    @property
    def command(self) -> str:
        """The command that repeats it."""
        return (
            f'optsc bench faults --arms {self.arm} --modes {self.mode} --faults "{self.fault}" '
            f"--seed {self.seed} --rate {self.rate:g}"
        )


class CaseResult(NamedTuple):
    """What came of a case: what is wrong, in words; empty where nothing is."""

    case: Case
    kind: str
    expected: str
    problems: tuple[str, ...]


@dataclass(eq=False)
class FaultTest:
    """What a test has found so far."""

    outcomes: list[CaseResult] = field(default_factory=list)

    @property
    def failures(self) -> list[CaseResult]:
        """The outcomes with problems."""
        return [outcome for outcome in self.outcomes if outcome.problems]

    @property
    def passed(self) -> bool:
        """Whether there is an outcome, and none has a problem."""
        return bool(self.outcomes) and not self.failures

    def table(self) -> dict[str, dict[str, tuple[int, int]]]:
        """Return by kind and mode how many runs there were, and how many of them failed."""
        runs = Counter((o.kind, o.case.mode) for o in self.outcomes)
        failed = Counter((o.kind, o.case.mode) for o in self.failures)
        return {
            kind: {mode: (runs[kind, mode], failed[kind, mode]) for mode in MODES if runs[kind, mode]}
            for kind in KINDS
            if any(runs[kind, mode] for mode in MODES)
        }

    def summary(self) -> dict[str, Any]:
        """Return the counts, and how to repeat every failure, as plain values for a JSON file."""
        exceptions = sum(any(p.startswith("raised") for p in o.problems) for o in self.failures)
        untrue = sum(any(p.startswith(("following", "finished")) for p in o.problems) for o in self.failures)
        return {
            "faults": len({o.case.fault for o in self.outcomes}),
            "modes": sorted({o.case.mode for o in self.outcomes}),
            "arms": sorted({o.case.arm for o in self.outcomes}),
            "runs": len(self.outcomes),
            "failed": len(self.failures),
            "exceptions": exceptions,
            "untrue": untrue,
            "passed": self.passed,
            "table": {
                kind: {mode: {"runs": n, "failed": bad} for mode, (n, bad) in row.items()}
                for kind, row in self.table().items()
            },
            "failures": [
                {**o.case._asdict(), "expected": o.expected, "problems": list(o.problems), "again": o.case.command}
                for o in self.failures
            ],
        }


def seed_of(case: Case) -> tuple[int, ...]:
    """Return the seed of a run: another one for every arm, mode and fault."""
    return case.seed, *(crc32(name.encode()) for name in (case.arm, case.mode, case.fault))


class Worlds:
    """Worlds that have been made, by arm and kind; making one takes a third of a second."""

    def __init__(self, rate: float) -> None:
        self._rate, self._made = rate, dict[tuple[str, bool, bool], World]()

    def of(self, arm: str, fault: Fault) -> World:
        """Return the world that a fault is done in."""
        key = arm, fault.assisted, fault.timed
        if key not in self._made:
            self._made[key] = World(arm, self._rate, assisted=fault.assisted, timed=fault.timed)
        return self._made[key]


def outcome(worlds: Worlds, case: Case) -> CaseResult:
    """Return what comes of a case: a pure function of the case."""
    fault, mode = FAULTS[case.fault], Mode(case.mode)
    here = worlds.of(case.arm, fault)
    if fault.kind == "session":
        found = session_problems(here, mode, fault, seed_of(case))
    else:
        found = problems(here.robot, here.period, run(here, mode, fault, seed_of(case)))
    return CaseResult(case, fault.kind, fault.expected.of(mode).words, tuple(found))


def cases(
    faults: Sequence[Fault], *, arms: Sequence[str], modes: Sequence[str], seed: int, rate: float
) -> Iterator[Case]:
    """Yield all cases, arm by arm."""
    for arm in arms:
        for fault in faults:
            for mode in modes:
                if Mode(mode) in fault.modes:
                    yield Case(arm, mode, fault.name, seed, rate)


def _some(many: Sequence[Case]) -> list[CaseResult]:
    logging.disable(logging.ERROR)
    worlds = Worlds(many[0].rate)
    return [outcome(worlds, case) for case in many]


def bench(
    faults: Sequence[Fault] | None = None,
    *,
    arms: Sequence[str] = DEFAULT_ARMS,
    modes: Sequence[str] = MODES,
    seed: int = 0,
    rate: float = RATE,
    workers: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> FaultTest:
    """Return what faults in all ``modes`` on all ``arms`` came to.

    Args:
        faults: which; all by default.
        arms: names of `ARMS`.
        modes: names of `MODES`.
        seed: of everything random.
        rate: control rate [Hz].
        workers: processes; 0 for this one alone.
        progress: called with the number of runs that are done, and of all.

    Raises `UnknownName` for an arm or a mode that there is not, and `InvalidValue` for a rate that is not positive, a
    negative seed, and where there is nothing to do.
    """
    require("rate", rate, Positive)
    if seed < 0:
        raise InvalidValue("seed", seed, "0 or more")
    for kind, names, known in (("arm", arms, ARMS), ("mode", modes, MODES)):
        for name in names:
            if name not in known:
                raise UnknownName(kind, name, known)
    all_faults = tuple(FAULTS.values()) if faults is None else faults
    todo = list(cases(all_faults, arms=arms, modes=modes, seed=seed, rate=rate))
    if not todo:
        raise InvalidValue("faults, modes and arms", 0, "at least one run")
    test = FaultTest()
    for some in _in_parts(todo, workers):
        test.outcomes.extend(some)
        if progress is not None:
            progress(len(test.outcomes), len(todo))
    return test


def _in_parts(todo: list[Case], workers: int) -> Iterator[list[CaseResult]]:
    size = 200
    parts = [todo[k : k + size] for k in range(0, len(todo), size)]
    if workers == 0:
        worlds = Worlds(todo[0].rate)
        before = logging.root.manager.disable
        logging.disable(logging.ERROR)
        try:
            for part in parts:
                yield [outcome(worlds, case) for case in part]
        finally:
            logging.disable(before)
        return
    with process_pool(workers) as pool:
        yield from pool.map(_some, parts)
