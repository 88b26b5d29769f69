"""Grasp selection: reach table, cost terms, filters, ranking rules, explanation."""

from optsc.selection.costs import (
    ClearanceLoss,
    GraspCost,
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
    TableCost,
)
from optsc.selection.explanation import CandidateRow
from optsc.selection.filters import AtMost, GraspFilter, StraightPathFilter, Vetoed
from optsc.selection.hysteresis import Hysteresis
from optsc.selection.ranking import Ranking, Target
from optsc.selection.reach import ReachSolver, ReachTable
from optsc.selection.reach_columns import StraightMotion
from optsc.selection.rules import Cascade, Lexicographic, RankingRule, Stage, WeightedSum
from optsc.selection.selector import GraspSelector

__all__ = [
    "AtMost",
    "CandidateRow",
    "Cascade",
    "ClearanceLoss",
    "GraspCost",
    "GraspFilter",
    "GraspSelector",
    "Hysteresis",
    "JointTravel",
    "Lexicographic",
    "ManipulabilityLoss",
    "OrientationDistance",
    "PathClearanceLoss",
    "PathLength",
    "PathManipulabilityLoss",
    "PathSpeed",
    "PoseDistance",
    "PositionDistance",
    "QualityLoss",
    "Ranking",
    "RankingRule",
    "ReachSolver",
    "ReachTable",
    "Stage",
    "StraightMotion",
    "StraightPathFilter",
    "TableCost",
    "Target",
    "Vetoed",
    "WeightedSum",
]
