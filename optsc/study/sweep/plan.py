"""A sweep as a value: which scenes, people and settings; and the jobs that it comes down to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from optsc.errors import InvalidValue
from optsc.study.conditions import Condition, Person
from optsc.study.outcomes import Job
from optsc.study.scenes import Scene, scene_set
from optsc.study.staging import Settings


@dataclass(frozen=True)
class Cases:
    """What conditions are tried on: scenes times people.

    Attributes:
        robots: names of arms.
        scenes: how many scenes for each arm.
        seed: of scenes and people.
        level: difficulty of the scenes, one of `optsc.study.scenes.LEVELS`.
        objects: how many objects a scene has.
        people: kinds of people.
        repetitions: people of each kind in each scene.
        settings: what everything shares.
    """

    robots: tuple[str, ...] = ("panda",)
    scenes: int = 50
    seed: int = 0
    level: str = "random"
    objects: int = 3
    people: tuple[str, ...] = ("typical",)
    repetitions: int = 1
    settings: Settings = field(default_factory=Settings)

    def __post_init__(self) -> None:
        for name in ("scenes", "repetitions"):
            if getattr(self, name) < 1:
                raise InvalidValue(name, getattr(self, name), "1 or more")
        if self.seed < 0:
            raise InvalidValue("seed", self.seed, "0 or more")
        for name in ("robots", "people"):
            if not getattr(self, name):
                raise InvalidValue(name, (), "at least one")

    def pairs(self) -> list[tuple[Scene, Person]]:
        """Return every scene with every person: the same people for the same scene number of every arm."""
        scenes = scene_set(self.robots, self.scenes, self.seed, level=self.level, objects=self.objects)
        return [
            (scene, Person(kind, (scene.seed + repetition) % 2**31))
            for scene in scenes
            for kind in self.people
            for repetition in range(self.repetitions)
        ]

    def jobs(self, conditions: Sequence[Condition]) -> list[Job]:
        """Return the jobs that try all ``conditions`` on all cases."""
        return [Job(scene, person, self.settings, tuple(conditions)) for scene, person in self.pairs()]
