"""Grasp libraries of a study: made once per gripper and set of objects, kept in the user's cache."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from optsc.errors import InvalidValue
from optsc.grasps import GraspLibrary, build_library
from optsc.robot import Gripper, RobotModel
from optsc.robot.cache import cache_directory
from optsc.sim import object_model
from optsc.study.keys import key

LIBRARY_SEED = 0
"""Libraries are stored and reused, so their seed is not the scene's."""


def library_of(robot: RobotModel, objects: Sequence[str]) -> GraspLibrary:
    """Return grasps of ``objects`` for the jaws of ``robot``; raise `InvalidValue` where it has none."""
    if robot.gripper is None:
        raise InvalidValue("robot.gripper", None, "a gripper")
    return GraspLibrary({name: _grasps(robot.gripper, name)[name] for name in objects})


@lru_cache(maxsize=64)
def _grasps(gripper: Gripper, name: str) -> GraspLibrary:
    mesh = object_model(name).mesh
    return build_library({name: mesh}, gripper, seed=LIBRARY_SEED, directory=cache_directory("grasps"))


def grasps_hash(robot: RobotModel, objects: Sequence[str]) -> str:
    """Return a hash of every grasp that `library_of` gives."""
    if robot.gripper is None:
        raise InvalidValue("robot.gripper", None, "a gripper")
    return key([_hash(robot.gripper, name) for name in sorted(objects)])


@lru_cache(maxsize=64)
def _hash(gripper: Gripper, name: str) -> str:
    grasps = _grasps(gripper, name)[name]
    poses = [grasps.X_OG.quaternion, grasps.X_OG.translation, grasps.opening, grasps.quality]
    return key([name, gripper.name, poses])
