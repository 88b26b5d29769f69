"""Grasp selection: reach table, cost terms, filters, ranking rules, explanation."""

from optsc.selection.breakdown import CandidateRow
from optsc.selection.clearance import GraspClearance
from optsc.selection.costs import (
    ClearanceLoss,
    GraspCost,
    JointTravel,
    ManipulabilityLoss,
    OrientationDistance,
    PoseDistance,
    PositionDistance,
    QualityLoss,
    TableCost,
)
from optsc.selection.filters import AtMost, GraspFilter
from optsc.selection.hysteresis import Hysteresis
from optsc.selection.motion import StraightMotion
from optsc.selection.predicted import (
    StraightWay,
    WayClearanceLoss,
    WayLength,
    WayManipulabilityLoss,
    WaySpeed,
)
from optsc.selection.ranking import Ranking, Target
from optsc.selection.reach import ReachTable, refresh, solve_reach
from optsc.selection.rules import Cascade, Lexicographic, Rule, Stage, WeightedSum
from optsc.selection.selector import GraspSelector
from optsc.selection.veto import Vetoed

__all__ = [
    "AtMost",
    "CandidateRow",
    "Cascade",
    "ClearanceLoss",
    "GraspClearance",
    "GraspCost",
    "GraspFilter",
    "GraspSelector",
    "Hysteresis",
    "JointTravel",
    "Lexicographic",
    "ManipulabilityLoss",
    "OrientationDistance",
    "PoseDistance",
    "PositionDistance",
    "QualityLoss",
    "Ranking",
    "ReachTable",
    "Rule",
    "Stage",
    "StraightMotion",
    "StraightWay",
    "TableCost",
    "Target",
    "Vetoed",
    "WayClearanceLoss",
    "WayLength",
    "WayManipulabilityLoss",
    "WaySpeed",
    "WeightedSum",
    "refresh",
    "solve_reach",
]
