"""Sweeps: many settings times many scenes, resumable, on one machine or many.

Names are loaded when they are first used, so that importing the room costs next to nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from optsc.study.lazily import lazily

if TYPE_CHECKING:
    from optsc.study.sweep.plan import Cases
    from optsc.study.sweep.results import TRADE_OFF, Settled, settle
    from optsc.study.sweep.runner import JobFailed, Progress, dask_executor, run_jobs
    from optsc.study.sweep.space import (
        COSTS,
        DESIGNS,
        SCALES,
        Dimension,
        Point,
        conditions,
        design,
        grid,
        one_at_a_time,
        random,
        rule_of,
        simplex,
        sobol,
    )
    from optsc.study.sweep.store import RowStore
    from optsc.study.sweep.tuning import OBJECTIVES, Trial, tune

_WHERE = {
    "COSTS": "space",
    "DESIGNS": "space",
    "OBJECTIVES": "tuning",
    "SCALES": "space",
    "TRADE_OFF": "results",
    "Cases": "plan",
    "Dimension": "space",
    "JobFailed": "runner",
    "Point": "space",
    "Progress": "runner",
    "RowStore": "store",
    "Settled": "results",
    "Trial": "tuning",
    "conditions": "space",
    "dask_executor": "runner",
    "design": "space",
    "grid": "space",
    "one_at_a_time": "space",
    "random": "space",
    "rule_of": "space",
    "run_jobs": "runner",
    "settle": "results",
    "simplex": "space",
    "sobol": "space",
    "tune": "tuning",
}

__all__ = [
    "COSTS",
    "DESIGNS",
    "OBJECTIVES",
    "SCALES",
    "TRADE_OFF",
    "Cases",
    "Dimension",
    "JobFailed",
    "Point",
    "Progress",
    "RowStore",
    "Settled",
    "Trial",
    "conditions",
    "dask_executor",
    "design",
    "grid",
    "one_at_a_time",
    "random",
    "rule_of",
    "run_jobs",
    "settle",
    "simplex",
    "sobol",
    "tune",
]

__getattr__ = lazily(__name__, _WHERE)


def __dir__() -> list[str]:
    return list(__all__)
