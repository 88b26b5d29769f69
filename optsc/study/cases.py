"""A sweep as a value: which scenes, people and settings; and the jobs that it comes down to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from optsc.errors import InvalidValue
from optsc.people.parameters import TYPES
from optsc.sim import ObjectModel
from optsc.study.arms import Arm
from optsc.study.conditions import Condition, OperatorSpec
from optsc.study.episode_setup import EpisodeSettings
from optsc.study.outcomes import Job
from optsc.study.scenes import Scene, scene_set


@dataclass(frozen=True)
class Cases:
    """What conditions are tried on: scenes times people.

    Attributes:
        robots: names of arms, or arms of one's own.
        scenes: how many scenes to draw for each arm; or the scenes themselves, and then robots, seed, level and
            objects mean nothing.
        seed: of scenes, and by them of people: a person's is that of the scene.
        level: difficulty of the scenes, one of `optsc.study.scenes.LEVELS`.
        objects: how many objects a scene has; or which, by name or as models of one's own.
        people: kinds of people.
        repetitions: people of each kind in each scene.
        settings: what everything shares.
    """

    robots: tuple[str | Arm, ...] = ("panda",)
    scenes: int | Sequence[Scene] = 50
    seed: int = 0
    level: str = "random"
    objects: int | tuple[str | ObjectModel, ...] = 3
    people: tuple[str, ...] = ("typical",)
    repetitions: int = 1
    settings: EpisodeSettings = field(default_factory=EpisodeSettings)

    def __post_init__(self) -> None:
        if not isinstance(self.scenes, int):
            object.__setattr__(self, "scenes", tuple(self.scenes))
            if not self.scenes or not all(isinstance(scene, Scene) for scene in self.scenes):
                raise InvalidValue("scenes", self.scenes, "a number, or at least one `Scene`")
        elif self.scenes < 1:
            raise InvalidValue("scenes", self.scenes, "1 or more")
        if self.repetitions < 1:
            raise InvalidValue("repetitions", self.repetitions, "1 or more")
        if self.seed < 0:
            raise InvalidValue("seed", self.seed, "0 or more")
        for name in ("robots", "people"):
            if not getattr(self, name):
                raise InvalidValue(name, (), "at least one")

    def all_scenes(self) -> list[Scene]:
        """Return every scene, those that are drawn arm by arm."""
        if not isinstance(self.scenes, int):
            return list(self.scenes)
        return scene_set(self.robots, self.scenes, self.seed, level=self.level, objects=self.objects)

    def pairs(self) -> list[tuple[Scene, OperatorSpec]]:
        """Return every scene with every person: the same people for the same scene number of every arm."""
        return [
            (scene, OperatorSpec(kind, (scene.seed + repetition) % 2**31))
            for scene in self.all_scenes()
            for kind in self.people
            for repetition in range(self.repetitions)
        ]

    def jobs(self, conditions: Sequence[Condition]) -> list[Job]:
        """Return the jobs that try all ``conditions`` on all cases.

        Raises `InvalidValue` for people who step in on the way: what they do depends on the target, so conditions
        could not share their work. `optsc.study.policy_jobs` takes them.
        """
        for kind in self.people:
            if OperatorSpec(kind).steps_in:
                valid = [name for name in TYPES if not OperatorSpec(name).steps_in]
                raise InvalidValue("people", kind, f"those who do not step in on the way: {', '.join(valid)}")
        return [Job(scene, person, self.settings, tuple(conditions)) for scene, person in self.pairs()]
