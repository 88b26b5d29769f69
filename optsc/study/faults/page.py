"""The page of the faults and of the answers that are expected, as text for ``docs/faults.md``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isinf

from optsc.control.modes import Mode
from optsc.study.faults.catalogue import FAULTS
from optsc.study.faults.fault import KINDS, Answer, Fault
from optsc.study.faults.world import MODES

ANSWERS = {
    "goes on": "the mode goes on as if nothing had happened; in manual mode the tool ends where the hand leads it,\n"
    "  and the status is following",
    "holds": "hold, at rest, and the reason can be read as long as that lasts (given words are in it)",
    "stays in hold": "hold is not left while the fault lasts, and the reason says why",
    "stops": "the arm is at rest, in hold or in manual mode, and the reason says why",
    "is safe": "more than one answer is right, as long as all of the above is kept, and no hold is without a reason;\n"
    "  modes that must not follow are named",
}
"""What the answers mean."""
_HEAD = """# Faults

What a real loop, a real tracker and a real arm do wrong, and what the shared controller answers. This page is generated
from `optsc/study/faults`; after a change there run `optsc bench faults --page docs/faults.md`.

`optsc bench faults` drives the controller into each mode (by a snapshot of a run without a fault), does the fault once,
for a while or from then on, and goes on for 1.6 s; in hold the operator closes the clutch meanwhile, in manual mode the
hand moves 6 cm, otherwise it keeps still. Then the operator lets go, closes the clutch and leads the arm 3 cm. Whatever
the fault is:

* nothing is raised by `step`, and no interrupt leaves half a tick behind;
* finite differences of all commands keep position, velocity, acceleration and jerk limits at 1e-9, and are one motion;
* the arm itself never moves faster than its limits, also where it stood elsewhere;
* "following" at rest means that the tool is within 1 mm and 5 mrad of where the hand leads it, and "finished" that the
  object is between the jaws;
* afterwards the operator takes over, and the tool is where it is led to.

The answers:

"""


def page() -> str:
    """Return the page."""
    lines = [_HEAD + "\n".join(f"* **{name}**: {words}." for name, words in ANSWERS.items())]
    for kind in KINDS:
        faults = [fault for fault in FAULTS.values() if fault.kind == kind]
        if faults:
            lines += ["", f"## {kind.capitalize()}", "", "| fault | lasts | in hold | in manual mode | by itself |"]
            lines += ["|---|---|---|---|---|", *_rows(faults)]
    return "\n".join(lines) + "\n"


def _rows(faults: Sequence[Fault]) -> Iterator[str]:
    """Yield a row for all faults that last as long and have the same answers."""
    alike: dict[tuple[str, ...], list[str]] = {}
    for fault in faults:
        lasts = "once" if fault.lasts == 0.0 else "from then on" if isinf(fault.lasts) else f"{fault.lasts:g} s"
        alike.setdefault((lasts, *_answers(fault)), []).append(fault.name)
    for cells, names in alike.items():
        yield "| " + " | ".join(["; ".join(names), *cells]) + " |"


def _answers(fault: Fault) -> Iterator[str]:
    """Yield the answers of the three columns; a dash where the fault cannot be."""
    automatic = tuple(mode for mode in MODES if mode.automatic)
    for modes in ((Mode.HOLD,), (Mode.MANUAL,), automatic):
        by_answer: dict[str, list[str]] = {}
        for mode in modes:
            if mode in fault.modes:
                by_answer.setdefault(_words(fault.expected.of(mode), mode), []).append(mode.value)
        if len(by_answer) <= 1:
            yield next(iter(by_answer), "-")
        else:
            yield "; ".join(f"{', '.join(names)}: {words}" for words, names in by_answer.items())


def _words(answer: Answer, mode: Mode) -> str:
    """Return an answer in words; where the robot moves by itself the hand leads the tool nowhere."""
    return (answer._replace(within=None) if mode.automatic else answer).words
