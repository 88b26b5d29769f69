"""Study design: conditions in counterbalanced order (Williams designs), practice, trials, scenes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from optsc.checks import AtLeast, Checked, Each, NonNegative, Positive, Where
from optsc.errors import DamagedFile, InvalidValue


def williams_design(count: int) -> tuple[tuple[int, ...], ...]:
    """Return the orders of ``count`` conditions in a Williams design: rows of condition numbers.

    Every condition stands at every place equally often, and follows every other equally often, so that neither fatigue
    nor carry-over favours one. An even number needs ``count`` rows, an odd one twice as many (E. J. Williams,
    "Experimental designs balanced for the estimation of residual effects of treatments", Austral. J. Sci. Res., 1949).

    Raises:
        InvalidValue: less than one condition.
    """
    if count < 1:
        raise InvalidValue("number of conditions", count, "1 or more")
    # 0, 1, n - 1, 2, n - 2, ...: neighbours differ by each number once.
    first = [(k + 1) // 2 if k % 2 else (count - k // 2) % count for k in range(count)]
    rows = [tuple((x + shift) % count for x in first) for shift in range(count)]
    if count % 2 and count > 1:
        rows += [tuple(reversed(row)) for row in rows]
    return tuple(rows)


class PlannedTrial(NamedTuple):
    """One trial.

    Attributes:
        participant: number, from 1.
        condition: its name.
        condition_number: from 1, in the order of the design's conditions.
        run: number among the participant's runs of this condition, from 1; practice counts.
        practice: whether it only serves to learn.
        scene_seed: of the scene.
    """

    participant: int
    condition: str
    condition_number: int
    run: int
    practice: bool
    scene_seed: int

    def file_name(self, kind: str, suffix: str) -> str:
        """Return the name of a file of this trial, by the pattern of the EUROBENCH project."""
        return f"subject_{self.participant:02d}_cond_{self.condition_number:02d}_run_{self.run:02d}_{kind}.{suffix}"


class Block(NamedTuple):
    """All trials of one participant under one condition; the questionnaire comes at its end."""

    condition: str
    condition_number: int
    trials: tuple[PlannedTrial, ...]


_NAME = Where("a name", lambda name: isinstance(name, str))
_DISTINCT = Where("at least one, each once", lambda names: 0 < len(names) == len(set(names)))


@dataclass(frozen=True)
class StudyDesign(Checked):
    """What the participants of a study do.

    Attributes:
        name: of the study.
        conditions: their names, in any order; what they mean is up to the caller.
        trials: that count, for each condition.
        practice: trials before those, for each condition.
        time_limit: of a trial [s].
        seed: of the scenes.
    """

    name: str
    conditions: Annotated[tuple[str, ...], Each(_NAME), _DISTINCT]
    trials: Annotated[int, AtLeast(1)] = 6
    practice: Annotated[int, NonNegative] = 2
    time_limit: Annotated[float, Positive] = 60.0
    seed: Annotated[int, NonNegative] = 0

    @property
    def group(self) -> int:
        """With a multiple of this number of participants the order is balanced."""
        return len(williams_design(len(self.conditions)))

    def order(self, participant: int) -> tuple[str, ...]:
        """Return the conditions in the order in which a participant meets them; raise `InvalidValue`."""
        if participant < 1:
            raise InvalidValue("participant", participant, "1 or more")
        rows = williams_design(len(self.conditions))
        return tuple(self.conditions[i] for i in rows[(participant - 1) % len(rows)])

    def blocks(self, participant: int) -> tuple[Block, ...]:
        """Return all a participant does, in order.

        The trials that count have the same scenes under every condition, so that differences can be paired, in an order
        that is drawn for each block, so that it cannot be learnt. Practice has other scenes.
        """
        return tuple(self._block(participant, condition) for condition in self.order(participant))

    def _block(self, participant: int, condition: str) -> Block:
        number = self.conditions.index(condition) + 1
        practice = self._seeds(participant, 0, number, self.practice)
        scenes = self._seeds(participant, 1, 0, self.trials)
        shuffled = np.random.default_rng([self.seed, participant, 2, number]).permutation(scenes)
        trials = []
        for run, seed in enumerate([*practice, *shuffled], start=1):
            trials.append(PlannedTrial(participant, condition, number, run, run <= self.practice, int(seed)))
        return Block(condition, number, tuple(trials))

    def _seeds(self, participant: int, purpose: int, number: int, count: int) -> Sequence[int]:
        rng = np.random.default_rng([self.seed, participant, purpose, number])
        return [int(seed) for seed in rng.integers(2**31, size=count)]

    def save(self, path: Path) -> None:
        """Write the design as JSON."""
        path.write_text(json.dumps(asdict(self), indent=2) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> StudyDesign:
        """Read what `save` wrote, or what was written by hand; raise `DamagedFile` or `InvalidValue`."""
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            return cls(**content)
        except (OSError, ValueError, TypeError) as error:
            if isinstance(error, InvalidValue):
                raise
            raise DamagedFile(path, f"is no design of a study ({error})") from None
