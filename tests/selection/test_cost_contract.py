"""What every cost and every filter of grasps has to do, tried on each of them."""

from dataclasses import dataclass

import numpy as np
import pytest

from optsc.selection import (
    AtMost,
    ClearanceLoss,
    JointTravel,
    ManipulabilityLoss,
    OrientationDistance,
    PathClearanceLoss,
    PathLength,
    PathManipulabilityLoss,
    PathSpeed,
    PoseDistance,
    PositionDistance,
    QualityLoss,
    StraightPathFilter,
    TableCost,
    Vetoed,
)
from optsc.selection.costs import SumOfCosts
from optsc.study.sweep.space import COSTS
from optsc.testing import GraspCostContract, GraspFilterContract

POSE = PoseDistance((1.0, 0.5, 0.2), (1.0, 2.0, 0.1), 0.12)
ALL = [
    ClearanceLoss(),
    JointTravel(),
    ManipulabilityLoss(),
    OrientationDistance(),
    POSE,
    PositionDistance(),
    QualityLoss(),
    SumOfCosts(((POSE, 1.0), (ManipulabilityLoss(), 0.2), (JointTravel(), 0.01), (PathSpeed(), 0.0))),
    PathClearanceLoss(0.08),
    PathLength(),
    PathManipulabilityLoss(),
    PathSpeed(),
]


def test_no_cost_is_forgotten_here():
    assert set(COSTS.values()) <= {type(cost) for cost in ALL}


class TestCosts(GraspCostContract):
    @pytest.fixture(autouse=True, params=ALL, ids=lambda cost: cost.name)
    def _each(self, request):
        self.cost = request.param

    def make_cost(self):
        return self.cost


class TestFilters(GraspFilterContract):
    @pytest.fixture(
        autouse=True,
        params=[
            AtMost(POSE, 0.2),
            AtMost(PathSpeed(), 0.5),
            StraightPathFilter(),
            Vetoed(frozenset({("can", 3)})),
        ],
    )
    def _each(self, request):
        self.filter = request.param

    def make_filter(self):
        return self.filter


@dataclass(frozen=True)
class FromAbove(TableCost):
    """How far the approach axis is from straight down."""

    name = "from above"
    unit = "rad"

    def per_twin(self, grid):
        _, x, y, _ = grid.quaternions
        return np.arccos(np.clip(2.0 * (x * x + y * y) - 1.0, -1.0, 1.0))


class TestFromAbove(GraspCostContract):
    depends_on_world = True

    def make_cost(self):
        return FromAbove()
