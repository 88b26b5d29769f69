from .interaction import (
    Agreement as Agreement,
)
from .interaction import (
    agreement as agreement,
)
from .interaction import (
    hand_velocity as hand_velocity,
)
from .interaction import (
    interaction_measures as interaction_measures,
)
from .interaction import (
    intervention_ratio as intervention_ratio,
)
from .interaction import (
    operator_effort as operator_effort,
)
from .interaction import (
    switch_count as switch_count,
)
from .interaction import (
    time_in_mode as time_in_mode,
)
from .limits import (
    LimitMargins as LimitMargins,
)
from .limits import (
    LimitViolations as LimitViolations,
)
from .limits import (
    limit_margins as limit_margins,
)
from .limits import (
    limit_violations as limit_violations,
)
from .motion import HandMotion as HandMotion
from .motion import Measures as Measures
from .motion import Motion as Motion
from .movements import (
    angular_velocity as angular_velocity,
)
from .movements import (
    movement_window as movement_window,
)
from .movements import (
    moving_stretches as moving_stretches,
)
from .movements import (
    resample as resample,
)
from .movements import (
    smoothness_measures as smoothness_measures,
)
from .movements import (
    stretch_smoothness as stretch_smoothness,
)
from .paths import (
    NearestDistance as NearestDistance,
)
from .paths import (
    PathClearance as PathClearance,
)
from .paths import (
    is_lifted as is_lifted,
)
from .paths import (
    motion_measures as motion_measures,
)
from .paths import (
    path_clearance as path_clearance,
)
from .paths import (
    path_length as path_length,
)
from .paths import (
    rotation_path as rotation_path,
)
from .paths import (
    straightness as straightness,
)
from .smoothness import (
    dimensionless_jerk as dimensionless_jerk,
)
from .smoothness import (
    log_dimensionless_jerk as log_dimensionless_jerk,
)
from .smoothness import (
    sparc as sparc,
)
from .switching import (
    SwitchJump as SwitchJump,
)
from .switching import (
    jump_measures as jump_measures,
)
from .switching import (
    switch_jump as switch_jump,
)
from .switching import (
    worst_jumps as worst_jumps,
)
