"""Grasps of the six objects, sampled once for all tests, and a small box."""

from collections.abc import Callable, Mapping

import pytest

from optsc.geometry import TriangleMesh
from optsc.grasps import GraspSet
from optsc.robot.gripper import PANDA_HAND
from optsc.sampling.antipodal import sample_grasps
from optsc.sampling.settings import AntipodalSettings
from optsc.sim.objects import OBJECT_NAMES, object_model
from optsc.sim.objects.solids import cuboid

FEW = AntipodalSettings(count=12, pool=2, spacing=0.003)


@pytest.fixture(scope="session")
def grasps_of() -> Callable[[str], GraspSet]:
    """Grasps of an object by name, with the settings that users get."""
    sets: dict[str, GraspSet] = {}

    def get(name: str) -> GraspSet:
        if name not in sets:
            sets[name] = sample_grasps(object_model(name).mesh, PANDA_HAND, name=name, seed=0)
        return sets[name]

    return get


@pytest.fixture(scope="session")
def meshes() -> Mapping[str, TriangleMesh]:
    return {name: object_model(name).mesh for name in OBJECT_NAMES}


@pytest.fixture(scope="session")
def few() -> AntipodalSettings:
    return FEW


@pytest.fixture(scope="session")
def brick() -> TriangleMesh:
    """A box of 40 x 60 x 80 mm standing on the plane."""
    return cuboid([-0.02, -0.03, 0.0], [0.02, 0.03, 0.08])


@pytest.fixture(scope="session")
def few_grasps(brick: TriangleMesh, few: AntipodalSettings) -> GraspSet:
    return sample_grasps(brick, PANDA_HAND, name="brick", seed=1, settings=few)
