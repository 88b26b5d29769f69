"""Cases of a study, scenes times simulated operators, and the jobs that try conditions on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Generic, Protocol, TypeVar

from optsc.checks import AtLeast, Checked, NonNegative, Where
from optsc.errors import InvalidValue
from optsc.people import TYPES
from optsc.sim import ObjectModel
from optsc.study.arms import Arm
from optsc.study.conditions import Condition, OperatorSpec
from optsc.study.episode_setup import EpisodeSettings, episode_key
from optsc.study.fingerprint import fingerprint
from optsc.study.scenes import Scene, scene_set

_SOME = Where("at least one", lambda names: len(names) > 0)


class Tested(Protocol):
    """What a study tries: a `optsc.study.Condition` or a `optsc.study.PolicyCondition`."""

    @property
    def key(self) -> str:
        """Fingerprint of everything that determines it."""
        ...

    def labels(self) -> dict[str, Any]:
        """Return what a table says about it."""
        ...


C = TypeVar("C", bound=Tested)


@dataclass(frozen=True)
class Job(Generic[C]):
    """Work that belongs together: conditions in one scene with one operator."""

    scene: Scene
    person: OperatorSpec
    settings: EpisodeSettings
    conditions: tuple[C, ...]

    def keys(self) -> list[str]:
        """Return the key of each condition's row."""
        episode = episode_key(self.scene, self.person, self.settings)
        return [fingerprint([episode, condition.key]) for condition in self.conditions]

    def labels(self, condition: C) -> dict[str, Any]:
        """Return what a table says about a row besides its outcome; not stored, for names may change."""
        return {
            "robot": self.scene.robot,
            "scene": self.scene.hash,
            "scene_seed": self.scene.seed,
            "level": self.scene.level,
            "goal": self.scene.goal,
            "person": self.person.kind,
            "person_seed": self.person.seed,
            "follower": self.settings.follower,
            **condition.labels(),
        }


@dataclass(frozen=True)
class Cases(Checked):
    """What conditions are tried on: scenes times simulated operators.

    Attributes:
        robots: names of arms, or user-defined arms.
        scenes: how many scenes to draw for each arm; or the scenes themselves, and then robots, seed, level and
            objects mean nothing.
        seed: of scenes, and by them of people: a person's is that of the scene.
        level: difficulty of the scenes, one of `optsc.study.scenes.LEVELS`.
        objects: how many objects a scene has; or which, by name or as user-defined models.
        people: kinds of people.
        repetitions: people of each kind in each scene.
        settings: what everything shares.
    """

    robots: Annotated[tuple[str | Arm, ...], _SOME] = ("panda",)
    scenes: int | Sequence[Scene] = 50
    seed: Annotated[int, NonNegative] = 0
    level: str = "random"
    objects: int | tuple[str | ObjectModel, ...] = 3
    people: Annotated[tuple[str, ...], _SOME] = ("typical",)
    repetitions: Annotated[int, AtLeast(1)] = 1
    settings: EpisodeSettings = field(default_factory=EpisodeSettings)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.scenes, int):
            object.__setattr__(self, "scenes", tuple(self.scenes))
            if not self.scenes or not all(isinstance(scene, Scene) for scene in self.scenes):
                raise InvalidValue("scenes", self.scenes, "a number, or at least one `Scene`")
        elif self.scenes < 1:
            raise InvalidValue("scenes", self.scenes, "1 or more")

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

    def jobs(self, conditions: Sequence[Condition]) -> list[Job[Condition]]:
        """Return the jobs that try all ``conditions``, rules that choose a grasp, on all cases.

        Raises `InvalidValue` for operators who step in during the approach: what they do depends on the target, so
        conditions could not share their work. `policy_jobs` takes them.
        """
        for kind in self.people:
            if OperatorSpec(kind).steps_in:
                valid = [name for name in TYPES if not OperatorSpec(name).steps_in]
                raise InvalidValue("people", kind, f"those who do not step in during the motion: {', '.join(valid)}")
        return self.policy_jobs(conditions)

    def policy_jobs(self, conditions: Sequence[C]) -> list[Job[C]]:
        """Return the jobs that try all ``conditions`` on all cases: no work is shared, so operators may do anything."""
        return [Job(scene, person, self.settings, tuple(conditions)) for scene, person in self.pairs()]
