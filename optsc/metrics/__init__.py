"""Measures of a motion as pure functions of arrays.

Rules that hold for all of them: what adds up is 0 for a motion of no samples; what divides by the amount of
motion is NaN when there is none, so that it cannot be mistaken for a good score; NaN or infinity in the input
raises `InvalidValue`, naming the first bad row.
"""

from optsc.metrics.interaction import (
    Agreement,
    agreement,
    hand_velocity,
    interaction_measures,
    intervention_ratio,
    operator_effort,
    switch_count,
    time_in_mode,
)
from optsc.metrics.limits import LimitMargins, LimitViolations, limit_margins, limit_violations
from optsc.metrics.motion import HandMotion, Measures, Motion
from optsc.metrics.movements import (
    angular_velocity,
    movement_window,
    moving_stretches,
    resample,
    smoothness,
    stretch_smoothness,
)
from optsc.metrics.paths import (
    NearestDistance,
    PathClearance,
    is_lifted,
    motion_measures,
    path_clearance,
    path_length,
    rotation_path,
    straightness,
)
from optsc.metrics.smoothness import dimensionless_jerk, log_dimensionless_jerk, sparc
from optsc.metrics.switching import SwitchJump, jump_measures, switch_jump, worst_jumps

__all__ = [
    "Agreement",
    "HandMotion",
    "LimitMargins",
    "LimitViolations",
    "Measures",
    "Motion",
    "NearestDistance",
    "PathClearance",
    "SwitchJump",
    "agreement",
    "angular_velocity",
    "dimensionless_jerk",
    "hand_velocity",
    "interaction_measures",
    "intervention_ratio",
    "is_lifted",
    "jump_measures",
    "limit_margins",
    "limit_violations",
    "log_dimensionless_jerk",
    "motion_measures",
    "movement_window",
    "moving_stretches",
    "operator_effort",
    "path_clearance",
    "path_length",
    "resample",
    "rotation_path",
    "smoothness",
    "sparc",
    "straightness",
    "stretch_smoothness",
    "switch_count",
    "switch_jump",
    "time_in_mode",
    "worst_jumps",
]
