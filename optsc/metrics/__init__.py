"""Measures of a motion as pure functions of arrays.

Rules that hold for all of them: what adds up is 0 for a motion of no samples; what divides by the amount of
motion is NaN when there is none, so that it cannot be mistaken for a good score; NaN or infinity in the input
raises `InvalidValue`, naming the first bad row.
"""

from optsc.metrics.interaction import (
    Agreement,
    agreement,
    intervention_ratio,
    operator_effort,
    rising_edges,
    switch_count,
    time_in_mode,
)
from optsc.metrics.limits import LimitViolations, limit_violations, rms_jerk_ratio
from optsc.metrics.paths import path_length, rotation_path, straightness
from optsc.metrics.smoothness import (
    angular_velocity,
    dimensionless_jerk,
    joint_log_dimensionless_jerk,
    log_dimensionless_jerk,
    movement_window,
    resample,
    sparc,
)
from optsc.metrics.switching import SwitchJump, switch_indices, switch_jump

__all__ = [
    "Agreement",
    "LimitViolations",
    "SwitchJump",
    "agreement",
    "angular_velocity",
    "dimensionless_jerk",
    "intervention_ratio",
    "joint_log_dimensionless_jerk",
    "limit_violations",
    "log_dimensionless_jerk",
    "movement_window",
    "operator_effort",
    "path_length",
    "resample",
    "rising_edges",
    "rms_jerk_ratio",
    "rotation_path",
    "sparc",
    "straightness",
    "switch_count",
    "switch_indices",
    "switch_jump",
    "time_in_mode",
]
