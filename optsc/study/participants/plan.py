"""Study plan: design, scenes and arm of a study with participants, in one file with every trial of everybody."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from optsc.cache import write_atomically
from optsc.checks import Between, Checked, OneOf
from optsc.control.policies import make_policy
from optsc.errors import DamagedFile, InvalidValue
from optsc.robot import ROBOT_NAMES
from optsc.sim import OBJECT_NAMES
from optsc.study.episode_setup import EpisodeSettings
from optsc.study.fingerprint import fingerprint
from optsc.study.participants.design import PlannedTrial, StudyDesign
from optsc.study.participants.participant_session import ParticipantSession
from optsc.study.scenes import LEVELS, Scene, random_scene

PLAN_FILE = "plan.json"
FORMAT = 1
"""Version of the file; others are refused."""


@dataclass(frozen=True)
class StudyPlan(Checked):
    """A study with people in full.

    Attributes:
        design: who does what when; its conditions are names of arbitration policies.
        participants: how many there are, numbered from 1.
        robot: name of an arm in the catalogue.
        objects: how many lie in a scene.
        level: difficulty of the scenes, one of `optsc.study.scenes.LEVELS`.
        follower: ``ideal``, an arm that is where it was commanded to be, or ``pybullet``, one in a simulated world.
        rate: control rate [Hz].

    Raises:
        InvalidValue: a number out of its range.
        UnknownName: no such policy, arm, level or follower.
    """

    design: StudyDesign
    participants: Annotated[int, Between(1, 999)]
    robot: Annotated[str, OneOf(ROBOT_NAMES, "robot")] = "panda"
    objects: Annotated[int, Between(1, len(OBJECT_NAMES))] = 3
    level: Annotated[str, OneOf(LEVELS, "level")] = "easy"
    follower: str = "ideal"
    rate: float = 250.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for condition in self.design.conditions:
            make_policy(condition)
        _ = self.settings

    @cached_property
    def settings(self) -> EpisodeSettings:
        """What all trials share."""
        return EpisodeSettings(rate=self.rate, longest=self.design.time_limit, follower=self.follower)

    @cached_property
    def key(self) -> str:
        """Hash of everything but the number of participants, which may grow."""
        return fingerprint([FORMAT, replace(self, participants=1)])

    def scene(self, trial: PlannedTrial) -> Scene:
        """Return the scene of a trial; raise `InvalidValue` where so many objects do not fit."""
        return random_scene(self.robot, trial.scene_seed, objects=self.objects, level=self.level)

    def session(self, participant: int, directory: Path) -> ParticipantSession:
        """Return the session of a participant, whose files are in ``directory``; raise as `ParticipantSession` does."""
        if not 1 <= participant <= self.participants:
            raise InvalidValue("participant", participant, f"1 to {self.participants}, as planned")
        return ParticipantSession(self.design, participant, directory)

    def save(self, directory: Path) -> Path:
        """Write the plan, with every trial of every participant, and return its file.

        A plan that is there already may only gain participants: trials that were done are of that plan.

        Raises:
            InvalidValue: another plan is there.
            DamagedFile: what is there is no plan.
        """
        path = directory / PLAN_FILE
        if path.exists():
            self._check_replaces(StudyPlan.load(directory))
        directory.mkdir(parents=True, exist_ok=True)
        write_atomically(path, _text(self._content()))
        return path

    @classmethod
    def load(cls, directory: Path) -> StudyPlan:
        """Read what `save` wrote.

        Raises:
            DamagedFile: it is not there, or not what was written; the trials have to be those of the settings.
            InvalidValue, UnknownName: a setting that cannot be.
        """
        path = directory / PLAN_FILE
        if not path.exists():
            raise DamagedFile(path, "is not there; `optsc study people plan` makes one")
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["format"] != FORMAT:
                raise DamagedFile(path, f"has format {content['format']!r}, and this version reads {FORMAT}")
            settings = {field.name: content["plan"][field.name] for field in fields(cls)}
            plan = cls(**{**settings, "design": StudyDesign(**settings["design"])})
        except (OSError, ValueError, KeyError, TypeError) as error:
            if isinstance(error, InvalidValue):
                raise
            raise DamagedFile(path, f"is no plan of a study ({error})") from None
        if content.get("sittings") != plan._content()["sittings"]:
            raise DamagedFile(
                path,
                "lists other trials than its settings give: it was changed by hand; plan again in another folder",
            )
        return plan

    def _check_replaces(self, there: StudyPlan) -> None:
        if there == self or (
            replace(there, participants=self.participants) == self and self.participants > there.participants
        ):
            return
        old, new = _flat(there), _flat(self)
        differing = {name: old[name] for name in old if old[name] != new[name]}
        raise InvalidValue(
            "plan of this folder",
            {name: new[name] for name in differing},
            f"{differing} as it was planned (only participants may be added), or another folder",
        )

    def _content(self) -> dict[str, Any]:
        sittings = [
            {
                "participant": participant,
                "blocks": [
                    {"condition": block.condition, "trials": [_brief(trial) for trial in block.trials]}
                    for block in self.design.blocks(participant)
                ],
            }
            for participant in range(1, self.participants + 1)
        ]
        settings = json.loads(json.dumps(asdict(self)))
        return {"format": FORMAT, "plan": settings, "sittings": sittings}


def _brief(trial: PlannedTrial) -> dict[str, Any]:
    return {"run": trial.run, "practice": trial.practice, "scene_seed": trial.scene_seed}


def _flat(plan: StudyPlan) -> Mapping[str, Any]:
    settings = asdict(plan)
    return {**settings.pop("design"), **settings}


def _text(content: Mapping[str, Any]) -> str:
    """Return JSON for people: one line for each trial."""
    head = json.dumps({name: content[name] for name in ("format", "plan")}, indent=2)[:-2]
    lines = []
    for session in content["sittings"]:
        blocks = []
        for block in session["blocks"]:
            trials = ",\n        ".join(json.dumps(trial) for trial in block["trials"])
            name = json.dumps(block["condition"])
            blocks.append(f'      {{"condition": {name}, "trials": [\n        {trials}]}}')
        listed = ",\n".join(blocks)
        lines.append(f'    {{"participant": {session["participant"]}, "blocks": [\n{listed}]}}')
    sittings = ",\n".join(lines)
    return f'{head},\n  "sittings": [\n{sittings}\n  ]\n}}\n'
