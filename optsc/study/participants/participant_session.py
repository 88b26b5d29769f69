"""Session of a participant: runs block by block, keeps every result, and resumes where it was interrupted."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from optsc.cache import write_atomically
from optsc.errors import DamagedFile, InvalidValue, UnknownName
from optsc.records import Run
from optsc.study.participants.design import Block, PlannedTrial, StudyDesign
from optsc.study.participants.workload import SCALES, Workload
from optsc.study.results_folder import strict_json

DESIGN_FILE = "design.json"


class TrialResult(NamedTuple):
    """Result of a trial: its run, whether the task was done, and measures for the table (JSON values)."""

    run: Run
    success: bool
    measures: Mapping[str, Any]


RunTrial = Callable[[PlannedTrial, float], TrialResult]
"""Executes a trial within a time limit [s]."""


class ParticipantSession:
    """One participant of a study, whose files are below a directory.

    Every trial leaves ``subject_XX_cond_YY_run_ZZ_run.npz`` (see `optsc.records.Run.save`) and
    ``..._measures.json``; every block leaves ``subject_XX_cond_YY_tlx.csv``. A trial counts as done when its
    measures are there, which are written last and at once; whatever was interrupted before is done again.

    Args:
        design: of the study. The first session keeps it in the directory.
        participant: number, from 1.
        directory: of the study.

    Raises:
        InvalidValue: no such participant, or the directory holds another design.
        DamagedFile: the design kept there cannot be read.
    """

    def __init__(self, design: StudyDesign, participant: int, directory: Path) -> None:
        self.design, self.participant, self.directory = design, participant, directory
        self.blocks = design.blocks(participant)
        directory.mkdir(parents=True, exist_ok=True)
        kept = directory / DESIGN_FILE
        if kept.exists():
            if StudyDesign.load(kept) != design:
                raise InvalidValue("design", design.name, f"the one of {DESIGN_FILE}, which the study began with")
        else:
            design.save(kept)

    @property
    def remaining(self) -> tuple[PlannedTrial, ...]:
        """The trials that are not done yet, in order; raise `DamagedFile` for one whose measures cannot be read."""
        return tuple(trial for block in self.blocks for trial in block.trials if self.row(trial) is None)

    @property
    def unrated(self) -> tuple[Block, ...]:
        """The blocks whose trials are done and whose questions are not answered, in order."""
        left = {trial.condition for trial in self.remaining}
        return tuple(
            block for block in self.blocks if block.condition not in left and not self._tlx_path(block).exists()
        )

    @property
    def finished(self) -> bool:
        """Whether all trials are done and all questions answered."""
        return not self.remaining and not self.unrated

    def block(self, condition: str) -> Block:
        """Return the block of a condition; raise `UnknownName`."""
        for block in self.blocks:
            if block.condition == condition:
                return block
        raise UnknownName("condition", condition, self.design.conditions)

    def row(self, trial: PlannedTrial) -> dict[str, Any] | None:
        """Return what was kept of a trial, None where it is not done; raise `DamagedFile`."""
        path = self._path(trial)
        if not path.exists():
            return None
        row = _read_measures(path)
        if any(row[name] != value for name, value in trial._asdict().items()):
            raise DamagedFile(
                path, "is of another trial than the design has there; remove it, and the trial is done again"
            )
        return row

    def execute(self, trial: PlannedTrial, run_trial: RunTrial) -> TrialResult:
        """Execute a trial, keep its result, and return it."""
        result = run_trial(trial, self.design.time_limit)
        result.run.save(self.directory / trial.file_name("run", "npz"))
        row = {**trial._asdict(), "success": result.success, **result.measures}
        write_atomically(self._path(trial), strict_json(row))
        return result

    def rate(self, condition: str, answers: Workload, *, replace: bool = False) -> Path:
        """Keep a participant's answers about a condition and return their file; raise as `check_rating`."""
        path = self.check_rating(condition, replace=replace)
        names = ",".join((*answers._fields, "raw"))
        values = ",".join(f"{value:g}" for value in (*answers, answers.raw))
        write_atomically(path, f"{names}\n{values}\n")
        return path

    def check_rating(self, condition: str, *, replace: bool = False) -> Path:
        """Return where the answers about a condition go.

        Raises:
            UnknownName: no such condition.
            InvalidValue: not all of its trials are done, or it was answered already and is not to be replaced.
        """
        block = self.block(condition)
        left = sum(trial.condition == condition for trial in self.remaining)
        if left:
            raise InvalidValue(f"trials of {condition} that are left", left, "0 before it is rated")
        path = self._tlx_path(block)
        if path.exists() and not replace:
            raise InvalidValue("answers", f"there already, in {path.name}", "given once; --replace puts new ones there")
        return path

    def run_remaining(
        self,
        run_trial: RunTrial,
        ask: Callable[[Block], Workload],
        say: Callable[[str], None] = print,
    ) -> None:
        """Execute what remains, block by block; ``ask`` returns the answers at the end of each.

        An exception, such as a keyboard interrupt, leaves everything up to the last whole trial in its place.
        """
        for block in self.blocks:
            for trial in block.trials:
                if self.row(trial) is None:
                    say(self.announce(trial))
                    self.execute(trial, run_trial)
            if not self._tlx_path(block).exists():
                self.rate(block.condition, ask(block))

    def announce(self, trial: PlannedTrial) -> str:
        """Return which trial is next, in words."""
        number = self.blocks.index(self.block(trial.condition)) + 1
        kind = "practice" if trial.practice else "trial"
        return f"block {number} of {len(self.blocks)}, {trial.condition}: {kind}, run {trial.run}"

    def _path(self, trial: PlannedTrial) -> Path:
        return self.directory / trial.file_name("measures", "json")

    def _tlx_path(self, block: Block) -> Path:
        return self.directory / f"subject_{self.participant:02d}_cond_{block.condition_number:02d}_tlx.csv"


def collect(directory: Path) -> list[dict[str, Any]]:
    """Return a row for each trial of all participants, practice included, with the answers of its block.

    Raises:
        DamagedFile: a file that is not what was written.
    """
    rows = []
    for path in sorted(directory.glob("subject_*_measures.json")):
        row = _read_measures(path)
        tlx = directory / f"subject_{row['participant']:02d}_cond_{row['condition_number']:02d}_tlx.csv"
        if tlx.exists():
            answers = read_workload(tlx)
            row |= {f"tlx_{name}": value for name, value in answers._asdict().items()}
            row["tlx_raw"] = answers.raw
        rows.append(row)
    return rows


def read_workload(path: Path) -> Workload:
    """Return the answers that `ParticipantSession.rate` kept; raise `DamagedFile`."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            (answers,) = csv.DictReader(file)
        return Workload.of(**{name: float(answers[name]) for name in SCALES})
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise DamagedFile(
            path, f"holds no answers on the six scales ({error}); rate it again, with --replace"
        ) from None


def _read_measures(path: Path) -> dict[str, Any]:
    try:
        row = json.loads(path.read_text(encoding="utf-8"))
        missing = [name for name in (*PlannedTrial._fields, "success") if name not in row]
        if missing:
            raise ValueError(f"without {', '.join(missing)}")
        int(row["participant"]), int(row["condition_number"])
    except (OSError, ValueError, TypeError) as error:
        advice = "remove it, and the trial is done again"
        raise DamagedFile(path, f"holds no measures of a trial ({error}); {advice}") from None
    return row
