"""Grasp libraries of a study: sampled once per gripper and object and cached, or read from a folder."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from optsc.cache import cache_directory
from optsc.errors import InvalidValue
from optsc.grasps import GraspLibrary, GraspSet
from optsc.robot import Gripper, RobotModel
from optsc.sampling import build_library
from optsc.sim import ObjectModel, object_model
from optsc.study.fingerprint import fingerprint

LIBRARY_SEED = 0
"""Libraries are stored and reused, so their seed is not the scene's."""


def library_of(
    robot: RobotModel, objects: Sequence[str | ObjectModel], directory: str | Path | None = None
) -> GraspLibrary:
    """Return grasps of ``objects`` for the jaws of ``robot``: those stored in ``directory``, or else sampled ones.

    Raises:
        InvalidValue: the robot has no jaws.
        UnknownName: an object is not in the directory, or not in the catalogue.
        DamagedFile, Mismatch: the directory holds no grasps, or such for other jaws.
    """
    if robot.gripper is None:
        raise InvalidValue("robot.gripper", None, "a gripper")
    models = [object_model(entry) if isinstance(entry, str) else entry for entry in objects]
    if directory is None:
        return GraspLibrary({model.name: _sampled(robot.gripper, model) for model in models})
    stored = _stored(robot.gripper, Path(directory), _state(Path(directory)))
    return GraspLibrary({model.name: stored[model.name] for model in models})


@lru_cache(maxsize=64)
def _sampled(gripper: Gripper, model: ObjectModel) -> GraspSet:
    directory = cache_directory("grasps")
    return build_library({model.name: model.mesh}, gripper, seed=LIBRARY_SEED, directory=directory)[model.name]


@lru_cache(maxsize=8)
def _stored(gripper: Gripper, directory: Path, state: tuple[tuple[str, int, int], ...]) -> GraspLibrary:
    """Return the library in ``directory``, read again whenever the ``state`` of its files has changed."""
    return GraspLibrary.load(directory, gripper)


def _state(directory: Path) -> tuple[tuple[str, int, int], ...]:
    found = [(path.name, path.stat()) for path in sorted(directory.glob("*"))]
    return tuple((name, stat.st_mtime_ns, stat.st_size) for name, stat in found)


def grasps_hash(robot: RobotModel, objects: Sequence[str | ObjectModel], directory: str | Path | None = None) -> str:
    """Return a hash of every grasp that `library_of` gives, wherever they come from."""
    library = library_of(robot, objects, directory)
    return fingerprint([_hash(library[name]) for name in sorted(library)])


@lru_cache(maxsize=256)
def _hash(grasps: GraspSet) -> str:
    poses = [grasps.X_OG.quaternion, grasps.X_OG.translation, grasps.opening, grasps.quality]
    return fingerprint([grasps.object_name, grasps.gripper, grasps.jaw_symmetric, poses])
