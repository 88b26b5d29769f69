"""A participant's sitting: goes through the blocks, keeps every result, and goes on where it was interrupted."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from optsc.errors import DamagedFile, InvalidValue
from optsc.records import Run
from optsc.study.people.design import Block, StudyDesign, Trial
from optsc.study.people.workload import Workload

DESIGN_FILE = "design.json"


class TrialResult(NamedTuple):
    """What came of a trial: its run, whether the task was done, and measures for the table (JSON values)."""

    run: Run
    success: bool
    measures: Mapping[str, Any]


RunTrial = Callable[[Trial, float], TrialResult]
"""Carries out a trial within a time limit [s]."""


class Sitting:
    """One participant of a study, whose files are below a directory.

    Every trial leaves ``subject_XX_cond_YY_run_ZZ_run.npz`` (see `optsc.records.Run.save`) and
    ``..._measures.json``; every block leaves ``subject_XX_cond_YY_tlx.csv``. A trial counts as done when its
    measures are there, which are written last and at once; whatever was interrupted before is done again.

    Args:
        design: of the study. The first sitting keeps it in the directory.
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
                raise InvalidValue(
                    "design", design.name, f"the one of {DESIGN_FILE}, which the study began with"
                )
        else:
            design.save(kept)

    @property
    def remaining(self) -> tuple[Trial, ...]:
        """The trials that are not done yet, in order."""
        return tuple(
            trial for block in self.blocks for trial in block.trials if not self._path(trial).exists()
        )

    @property
    def finished(self) -> bool:
        """Whether all trials are done and all questions answered."""
        return not self.remaining and all(self._tlx_path(block).exists() for block in self.blocks)

    def go_on(
        self,
        run_trial: RunTrial,
        ask: Callable[[Block], Workload],
        say: Callable[[str], None] = print,
    ) -> None:
        """Carry out what remains, block by block; ``ask`` hands in the answers at the end of each.

        An exception, such as a keyboard interrupt, leaves everything up to the last whole trial in its place.
        """
        for number, block in enumerate(self.blocks, start=1):
            for trial in block.trials:
                if not self._path(trial).exists():
                    kind = "practice" if trial.practice else "trial"
                    say(f"block {number} of {len(self.blocks)}, {trial.condition}: {kind}, run {trial.run}")
                    self._keep(trial, run_trial(trial, self.design.time_limit))
            if not self._tlx_path(block).exists():
                self._keep_answers(block, ask(block))

    def _path(self, trial: Trial) -> Path:
        return self.directory / trial.file_name("measures", "json")

    def _tlx_path(self, block: Block) -> Path:
        return self.directory / f"subject_{self.participant:02d}_cond_{block.condition_number:02d}_tlx.csv"

    def _keep(self, trial: Trial, result: TrialResult) -> None:
        result.run.save(self.directory / trial.file_name("run", "npz"))
        row = {**trial._asdict(), "success": result.success, **result.measures}
        _write_at_once(self._path(trial), json.dumps(row, indent=2) + "\n")

    def _keep_answers(self, block: Block, answers: Workload) -> None:
        names = ",".join((*answers._fields, "raw"))
        values = ",".join(f"{value:g}" for value in (*answers, answers.raw))
        _write_at_once(self._tlx_path(block), f"{names}\n{values}\n")


def collect(directory: Path) -> list[dict[str, Any]]:
    """Return a row for each trial of all participants, practice included, with the answers of its block.

    Raises:
        DamagedFile: a file that is not what was written.
    """
    rows = []
    for path in sorted(directory.glob("subject_*_measures.json")):
        try:
            row = json.loads(path.read_text(encoding="utf-8"))
            tlx = directory / f"subject_{row['participant']:02d}_cond_{row['condition_number']:02d}_tlx.csv"
        except (ValueError, KeyError, TypeError) as error:
            raise DamagedFile(path, f"holds no measures of a trial ({error})") from None
        if tlx.exists():
            with tlx.open(newline="", encoding="utf-8") as file:
                (answers,) = csv.DictReader(file)
            row |= {f"tlx_{name}": float(value) for name, value in answers.items()}
        rows.append(row)
    return rows


def _write_at_once(path: Path, text: str) -> None:
    """Write a file so that it is there whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
