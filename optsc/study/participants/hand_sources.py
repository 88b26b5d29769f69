"""Hand sources of trials: a simulated person, a recording, or a device behind a user-defined function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from optsc.errors import DamagedFile, InvalidValue, UnknownName
from optsc.operators import HandRecording, Operator, Recorded
from optsc.people.parameters import TYPES
from optsc.study.conditions import OperatorSpec
from optsc.study.loading import load_named
from optsc.study.participants.design import PlannedTrial
from optsc.study.scenes import Scene

RECORDING, LIVE = "recording", "live"


class TrialContext(NamedTuple):
    """The trial that a hand is for.

    Attributes:
        trial: the planned trial.
        scene: of the trial; `Scene.goal` is the object to be grasped.
        by_hand: whether the trigger closes the jaws, instead of handing over to the robot.
    """

    trial: PlannedTrial
    scene: Scene
    by_hand: bool


@dataclass(frozen=True)
class HandSource:
    """Where the hands of trials come from.

    Attributes:
        kind: for tables: a kind of simulated person, ``recording`` or ``live``.
        operator: makes a new one for each trial.
    """

    kind: str
    operator: Callable[[TrialContext], Operator]

    @property
    def live(self) -> bool:
        """Whether there is a person, who needs the clock's pace and answers questions."""
        return self.kind == LIVE


def hand_source(text: str) -> HandSource:
    """Return the hand that ``text`` names.

    * a kind of simulated person, one of `optsc.people.TYPES`: for rehearsals. Its seed is that of the scene, so that
      the same person with the same tremor meets every condition;
    * ``FILE.csv``: a recorded hand, the same in every trial, see `optsc.operators.HandRecording.from_csv`;
    * a folder: of recorded hands, named ``subject_XX_cond_YY_run_ZZ_hand.csv``;
    * ``FILE.py:FUNCTION`` or ``MODULE:FUNCTION``: whatever ``FUNCTION(context)`` returns, an `Operator`.

    Raises:
        UnknownName: it is none of them.
        DamagedFile: there is no such recording or function, or it cannot be read.
    """
    if text in TYPES:
        return simulated(text)
    if ":" in text:
        return HandSource(LIVE, _hook(text))
    path = Path(text)
    if path.is_dir():
        return HandSource(RECORDING, lambda context: _played(path / context.trial.file_name("hand", "csv")))
    if path.suffix == ".csv":
        _played(path)
        return HandSource(RECORDING, lambda context: _played(path))
    raise UnknownName("operator", text, [*TYPES, "FILE.csv", "FOLDER", "FILE.py:FUNCTION", "MODULE:FUNCTION"])


def simulated(kind: str) -> HandSource:
    """Return simulated people of a kind; raise `UnknownName`."""
    OperatorSpec(kind)

    def operator(context: TrialContext) -> Operator:
        trial, scene, by_hand = context
        return OperatorSpec(kind, trial.scene_seed).operator(scene.goal, scene.objects, by_hand=by_hand)

    return HandSource(kind, operator)


def device(operator: Callable[[TrialContext], Operator]) -> HandSource:
    """Return a human participant, whose device ``operator`` makes ready for a trial."""
    return HandSource(LIVE, operator)


def _played(path: Path) -> Operator:
    try:
        return Recorded(HandRecording.from_csv(path))
    except OSError as error:
        raise DamagedFile(path, f"is no recorded hand ({error.strerror or error})") from None


def _hook(text: str) -> Callable[[TrialContext], Operator]:
    function = load_named(text)
    if not callable(function):
        raise InvalidValue(text, function, "a function that returns an operator")

    def operator(context: TrialContext) -> Operator:
        made = function(context)
        if not callable(getattr(made, "read", None)):
            raise InvalidValue(f"what {text} returned", made, "an operator: something with read(view)")
        return made

    return operator
