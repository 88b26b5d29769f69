"""A small box and a few grasps of it."""

import pytest

from optsc.geometry import TriangleMesh
from optsc.grasps import GraspSet
from optsc.robot.gripper import PANDA_HAND
from optsc.sampling.antipodal import sample_grasps
from optsc.sampling.settings import AntipodalSettings
from optsc.sim.objects.solids import cuboid


@pytest.fixture(scope="session")
def brick() -> TriangleMesh:
    """A box of 40 x 60 x 80 mm standing on the plane."""
    return cuboid([-0.02, -0.03, 0.0], [0.02, 0.03, 0.08])


@pytest.fixture(scope="session")
def few_grasps(brick: TriangleMesh) -> GraspSet:
    few = AntipodalSettings(count=12, pool=2, spacing=0.003)
    return sample_grasps(brick, PANDA_HAND, name="brick", seed=1, settings=few)
