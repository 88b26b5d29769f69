"""Measures of a motion as pure functions of arrays.

Rules that hold for all of them: what adds up is 0 for a motion of no samples; what divides by the amount of
motion is NaN when there is none, so that it cannot be mistaken for a good score; NaN or infinity in the input
raises `InvalidValue`, naming the first bad row.
"""

from optsc.metrics.clearance import Nearest, PathClearance, path_clearance
from optsc.metrics.interaction import (
    Agreement,
    agreement,
    authority,
    intervention_ratio,
    operator_effort,
    rising_edges,
    switch_count,
    time_in_mode,
)
from optsc.metrics.limits import (
    LimitMargins,
    LimitViolations,
    limit_margins,
    limit_violations,
    rms_jerk_ratio,
)
from optsc.metrics.motion import Hand, Motion
from optsc.metrics.paths import path_length, rotation_path, straightness
from optsc.metrics.smoothness import (
    angular_velocity,
    dimensionless_jerk,
    joint_log_dimensionless_jerk,
    log_dimensionless_jerk,
    movement_window,
    moving_stretches,
    resample,
    sparc,
)
from optsc.metrics.summary import (
    hand_velocity,
    interaction_measures,
    jump_measures,
    motion_measures,
    smoothness,
    stretch_smoothness,
    summarise,
    worst_jumps,
)
from optsc.metrics.switching import SwitchJump, switch_indices, switch_jump

__all__ = [
    "Agreement",
    "Hand",
    "LimitMargins",
    "LimitViolations",
    "Motion",
    "Nearest",
    "PathClearance",
    "SwitchJump",
    "agreement",
    "angular_velocity",
    "authority",
    "dimensionless_jerk",
    "hand_velocity",
    "interaction_measures",
    "intervention_ratio",
    "joint_log_dimensionless_jerk",
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
    "rising_edges",
    "rms_jerk_ratio",
    "rotation_path",
    "smoothness",
    "sparc",
    "straightness",
    "stretch_smoothness",
    "summarise",
    "switch_count",
    "switch_indices",
    "switch_jump",
    "time_in_mode",
    "worst_jumps",
]
