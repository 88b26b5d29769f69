"""Scenes of a study: an arm, objects on a table, and the one that is wanted; random, or of a chosen difficulty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Annotated, Any

import numpy as np

from optsc.checks import Checked, Share
from optsc.errors import InvalidValue, Mismatch, UnknownName
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.robot import ROBOT_NAMES, RobotModel
from optsc.sim import OBJECT_NAMES, ObjectModel, Tabletop, object_model, tabletop
from optsc.study.arms import Arm, arm
from optsc.study.fingerprint import fingerprint

DRAWS = 24
"""Arrangements that are drawn to find one of the wanted difficulty."""
TIGHT, WIDE = (0.14, 0.035), (0.20, 0.10)
"""Spacing and gap [m] of the tightest and the widest arrangements, see `optsc.sim.tabletop`."""
PROBES = 24
"""Grasps of an object by which its nearness to joint limits is measured."""


@dataclass(frozen=True)
class Difficulty(Checked):
    """How hard a scene is among those there could be, as quantiles in [0, 1]; None leaves a part to chance.

    Attributes:
        distance: of the wanted object from the tool at the start.
        clutter: how near the next object stands to it.
        limits: how near to a joint limit its grasps are.
    """

    distance: Annotated[float | None, Share] = None
    clutter: Annotated[float | None, Share] = None
    limits: Annotated[float | None, Share] = None

    @property
    def graded(self) -> bool:
        """Whether any part is asked for."""
        return any(value is not None for value in asdict(self).values())


LEVELS: Mapping[str, Difficulty] = {
    "random": Difficulty(),
    "easy": Difficulty(0.1, 0.1, 0.1),
    "medium": Difficulty(0.5, 0.5, 0.5),
    "hard": Difficulty(0.9, 0.9, 0.9),
    "far": Difficulty(distance=1.0),
    "cluttered": Difficulty(clutter=1.0),
    "near-limits": Difficulty(limits=1.0),
}
"""Difficulties that have a name."""


@dataclass(frozen=True)
class Grade:
    """What makes a scene hard, measured.

    Attributes:
        distance: from the tool at the start to the middle of the wanted object [m].
        gap: between the circles around the wanted object and the nearest other one [m].
        margin: median over the reachable grasps of the wanted object of the least share of a joint's half range that
            is left [-]; 0 where none can be reached.
        reachable: share of the probed grasps that can be reached [-].
    """

    distance: float
    gap: float
    margin: float
    reachable: float


@dataclass(frozen=True)
class Scene:
    """An arm, objects on a table, and the one that the operator wants.

    Attributes:
        robot: name of an arm in the catalogue, or that of ``arm``.
        objects: their names, each once; of the catalogue unless ``models`` has one of that name.
        places: of each object x, y [m] and yaw [rad] on the table.
        goal: name of the object that the operator wants.
        seed: what it was drawn with.
        level: name of its difficulty.
        arm: an arm that the catalogue does not have.
        models: objects that the catalogue does not have, or has otherwise.
    """

    robot: str
    objects: tuple[str, ...]
    places: tuple[tuple[float, float, float], ...]
    goal: str
    seed: int = 0
    level: str = "random"
    arm: Arm | None = None
    models: tuple[ObjectModel, ...] = ()

    def __post_init__(self) -> None:
        if self.arm is None and self.robot not in ROBOT_NAMES:
            raise UnknownName("robot", self.robot, ROBOT_NAMES)
        if self.arm is not None and self.robot != self.arm.name:
            raise InvalidValue("robot", self.robot, f"the name of its arm, {self.arm.name!r}")
        if len(set(self.objects)) != len(self.objects) or len(self.objects) != len(self.places):
            raise InvalidValue("objects and places", (self.objects, self.places), "each object once, with a place")
        known = (*OBJECT_NAMES, *(model.name for model in self.models))
        for name in self.objects:
            if name not in known:
                raise UnknownName("object", name, known)
        if self.goal not in self.objects:
            raise UnknownName("object of the scene", self.goal, self.objects)
        if not np.all(np.isfinite(self.places)):
            raise InvalidValue("places", self.places, "finite")

    @cached_property
    def hash(self) -> str:
        """Hash of what is there: the arm, the objects with their surfaces and places, and the goal.

        Neither seed nor level are in it: the same scene drawn twice is the same scene.
        """
        given = {model.name: _content(model) for model in self.models if model.name in self.objects}
        surfaces = [given.get(name) or object_model(name).mesh.hash for name in self.objects]
        robot = self.robot if self.arm is None else self.arm.key
        return fingerprint(["scene", robot, self.objects, surfaces, self.places, self.goal])

    def robot_model(self) -> RobotModel:
        """Return the arm, the same object for the same arm: what is built for it is kept with it."""
        return arm(self.arm or self.robot)

    def object_models(self) -> dict[str, ObjectModel]:
        """Return what the objects are, in order, the same object for the same content."""
        given = {model.name: _kept(_Content(_content(model), model)) for model in self.models}
        return {name: given.get(name) or object_model(name) for name in self.objects}

    def world(self) -> Tabletop:
        """Return the arm and the objects in their places."""
        poses = {
            name: Pose.from_rotation_vector([0.0, 0.0, yaw], [x, y, 0.0])
            for name, (x, y, yaw) in zip(self.objects, self.places, strict=True)
        }
        return Tabletop(self.robot_model(), self.object_models(), poses, self.seed)

    def to_json(self) -> dict[str, Any]:
        """Return the scene as JSON holds it; of what is not in the catalogue the names alone, and the hash of all."""
        names = ("robot", "objects", "places", "goal", "seed", "level", "hash")
        return {name: getattr(self, name) for name in names}

    @classmethod
    def from_json(
        cls, content: Mapping[str, Any], *, arm: Arm | None = None, models: Sequence[ObjectModel] = ()
    ) -> Scene:
        """Return the scene that `to_json` gave.

        What it has from outside of the catalogue has to be given again; `Mismatch` where that is not the same.
        """
        scene = cls(
            content["robot"],
            tuple(content["objects"]),
            tuple((float(x), float(y), float(yaw)) for x, y, yaw in content["places"]),
            content["goal"],
            int(content["seed"]),
            content["level"],
            arm,
            tuple(models),
        )
        if content.get("hash", scene.hash) != scene.hash:
            raise Mismatch(f"stored scene of {scene.robot}", content["hash"], scene.hash)
        return scene


@dataclass(frozen=True)
class _Content:
    """An object by what it is, not by where it lies in memory."""

    key: str
    model: ObjectModel = field(compare=False)


@lru_cache(maxsize=64)
def _kept(content: _Content) -> ObjectModel:
    """Return the first object of that content, so that what is kept for it survives being sent to another process."""
    return content.model


def _content(model: ObjectModel) -> str:
    return fingerprint([model.name, model.mesh.hash, [p.hash for p in model.parts], model.mass, model.friction])


def random_scene(
    robot: str | Arm,
    seed: int,
    *,
    objects: int | Sequence[str | ObjectModel] = 3,
    level: str = "random",
) -> Scene:
    """Return a scene of ``seed``; the same arguments give the same scene.

    Args:
        robot: name of an arm in the catalogue, or a user-defined one.
        seed: of objects, places and goal.
        objects: how many of the catalogue to draw; or which, by name or as user-defined models.
        level: one of `LEVELS`. A graded scene is, of `DRAWS` arrangements, the one whose `grade` lies nearest to the
            wanted quantiles among them.

    Raises:
        UnknownName: no such robot, object or level.
        InvalidValue: a number of objects that there are not, or that do not fit on the table.
    """
    if level not in LEVELS:
        raise UnknownName("level", level, LEVELS)
    rng = np.random.default_rng([seed, 0])
    if isinstance(objects, int):
        if not 1 <= objects <= len(OBJECT_NAMES):
            raise InvalidValue("number of objects", objects, f"1 to {len(OBJECT_NAMES)}")
        chosen: Sequence[str | ObjectModel] = sorted(rng.choice(OBJECT_NAMES, objects, replace=False).tolist())
    else:
        chosen = tuple(objects)
    if not chosen:
        raise InvalidValue("number of objects", 0, "1 or more")
    index = int(rng.integers(len(chosen)))
    wanted = LEVELS[level]
    if not wanted.graded:
        return replace(_arranged(robot, chosen, index, seed, rng), level=level)
    scenes = [_arranged(robot, chosen, index, seed, rng, spread=True) for _ in range(DRAWS)]
    return replace(scenes[_nearest([grade(scene) for scene in scenes], wanted)], level=level)


def scene_set(
    robots: Sequence[str | Arm],
    count: int,
    seed: int,
    *,
    level: str = "random",
    objects: int | Sequence[str | ObjectModel] = 3,
) -> list[Scene]:
    """Return ``count`` scenes for each of ``robots``: scene k of every arm has the same objects and goal."""
    if count < 1:
        raise InvalidValue("number of scenes", count, "1 or more")
    seeds = [int(s) for s in np.random.SeedSequence(seed).generate_state(count)]
    return [random_scene(robot, s, objects=objects, level=level) for robot in robots for s in seeds]


def grade(scene: Scene) -> Grade:
    """Return what makes ``scene`` hard."""
    from optsc.ik.batch import solve_ik
    from optsc.metrics import limit_margins
    from optsc.study.libraries import library_of

    world = scene.world()
    robot, X_WO, models = world.robot, world.X_WO, world.objects
    at = np.array(scene.places)[:, :2]
    radii = np.array([_radius(model) for model in models.values()])
    index = scene.objects.index(scene.goal)
    gaps = np.linalg.norm(at - at[index], axis=1) - radii - radii[index]
    gaps[index] = np.inf
    middle = np.array([*at[index], 0.5 * _height(models[scene.goal])])
    distance = float(np.linalg.norm(middle - robot.forward(robot.home).translation))
    grasps = library_of(robot, (models[scene.goal],))[scene.goal].X_OG
    picked = np.linspace(0, len(grasps) - 1, PROBES).astype(int)
    found = solve_ik(robot, X_WO[scene.goal] @ grasps[picked], seeds=robot.home, restarts=4)
    shares = [
        limit_margins(q[None], robot.limits.lower, robot.limits.upper).least_share for q in found.q[found.success]
    ]
    margin = float(np.median(shares)) if shares else 0.0
    gap = float(gaps.min()) if len(gaps) > 1 else float("inf")
    return Grade(distance, gap, margin, float(np.mean(found.success)))


def _arranged(
    robot: str | Arm,
    chosen: Sequence[str | ObjectModel],
    goal: int,
    seed: int,
    rng: np.random.Generator,
    *,
    spread: bool = False,
) -> Scene:
    draw = int(rng.integers(2**31))
    if spread:
        share = rng.uniform()
        spacing, gap = ((1.0 - share) * a + share * b for a, b in zip(TIGHT, WIDE, strict=True))
        world = tabletop(arm(robot), chosen, draw, spacing=spacing, gap=gap)
    else:
        world = tabletop(arm(robot), chosen, draw)
    names = tuple(world.objects)
    places = tuple(_place(world.X_WO[name]) for name in names)
    given = robot if isinstance(robot, Arm) else None
    models = tuple(entry for entry in chosen if isinstance(entry, ObjectModel))
    return Scene(
        str(robot) if given is None else given.name,
        names,
        places,
        names[goal],
        int(seed),
        arm=given,
        models=models,
    )


def _place(X_WO: Pose) -> tuple[float, float, float]:
    w, _, _, z = X_WO.quaternion.tolist()
    x, y, _ = X_WO.translation.tolist()
    return x, y, 2.0 * float(np.arctan2(z, w))


def _nearest(grades: Sequence[Grade], wanted: Difficulty) -> int:
    """Return the index of the grade whose quantiles among all come nearest to the wanted ones."""
    hardness = {
        "distance": [g.distance for g in grades],
        "clutter": [-g.gap for g in grades],
        "limits": [-g.margin for g in grades],
    }
    miss: Array = np.zeros(len(grades))
    for name, quantile in asdict(wanted).items():
        if quantile is not None:
            order = np.argsort(np.argsort(hardness[name], kind="stable"), kind="stable")
            miss += (order / max(len(grades) - 1, 1) - quantile) ** 2
    # Where nothing can be grasped there is nothing to compare.
    miss += np.where(np.array([g.reachable for g in grades]) > 0.0, 0.0, len(grades))
    return int(np.argmin(miss))


def _radius(model: ObjectModel) -> float:
    return float(np.linalg.norm(model.mesh.vertices[:, :2], axis=1).max())


def _height(model: ObjectModel) -> float:
    return float(model.mesh.vertices[:, 2].max())
