"""Scenes, conditions and experiments: what a study runs and measures.

Names are loaded when they are first used, so that importing the room costs next to nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from optsc.study.lazily import lazily

if TYPE_CHECKING:
    from optsc.study.approach import (
        Comparison,
        Failure,
        Pair,
        approach_conditions,
        compare,
        explanation,
        failures,
        pair_means,
        pairs_of,
    )
    from optsc.study.arbitration import (
        PolicyCondition,
        PolicyJob,
        do_policies,
        outcome,
        play,
        policy_condition,
        policy_conditions,
        policy_jobs,
        simulated,
    )
    from optsc.study.arms import Arm
    from optsc.study.conditions import MANIPULABILITY_ONLY, PAPER, Condition, Person
    from optsc.study.demo import Demo, run_demo
    from optsc.study.engine import Choice, Engine, Executed
    from optsc.study.fresh import FreshSelector
    from optsc.study.libraries import library_of
    from optsc.study.lifting import is_lifted
    from optsc.study.outcomes import Job, Row, do, scene_means
    from optsc.study.output import save_rows, save_summary
    from optsc.study.scenes import LEVELS, Difficulty, Grade, Scene, grade, random_scene, scene_set
    from optsc.study.soak import Soak
    from optsc.study.stability import Stability
    from optsc.study.staging import FOLLOWERS, Settings, Stage, episode_key
    from optsc.study.statistics import (
        Interval,
        PairedDifference,
        averages,
        bootstrap,
        kendall_tau,
        paired_difference,
        pareto_front,
        rank_biserial,
        share_interval,
    )
    from optsc.study.sweep.plan import Cases
    from optsc.study.sweep.results import Settled, settle
    from optsc.study.sweep.runner import JobFailed, Progress, dask_executor, run_jobs
    from optsc.study.sweep.space import Dimension, rule_of
    from optsc.study.sweep.store import RowStore
    from optsc.study.sweep.tuning import Trial, tune

_WHERE = {
    "FOLLOWERS": "staging",
    "LEVELS": "scenes",
    "MANIPULABILITY_ONLY": "conditions",
    "PAPER": "conditions",
    "Arm": "arms",
    "Cases": "sweep.plan",
    "Choice": "engine",
    "Comparison": "approach",
    "Condition": "conditions",
    "Demo": "demo",
    "Difficulty": "scenes",
    "Dimension": "sweep.space",
    "Engine": "engine",
    "Executed": "engine",
    "Failure": "approach",
    "FreshSelector": "fresh",
    "Grade": "scenes",
    "Interval": "statistics",
    "Job": "outcomes",
    "JobFailed": "sweep.runner",
    "Pair": "approach",
    "PairedDifference": "statistics",
    "Person": "conditions",
    "PolicyCondition": "arbitration",
    "PolicyJob": "arbitration",
    "Progress": "sweep.runner",
    "Row": "outcomes",
    "RowStore": "sweep.store",
    "Scene": "scenes",
    "Settings": "staging",
    "Settled": "sweep.results",
    "Soak": "soak",
    "Stability": "stability",
    "Stage": "staging",
    "Trial": "sweep.tuning",
    "approach_conditions": "approach",
    "averages": "statistics",
    "bootstrap": "statistics",
    "compare": "approach",
    "dask_executor": "sweep.runner",
    "do": "outcomes",
    "do_policies": "arbitration",
    "episode_key": "staging",
    "explanation": "approach",
    "failures": "approach",
    "grade": "scenes",
    "is_lifted": "lifting",
    "kendall_tau": "statistics",
    "library_of": "libraries",
    "outcome": "arbitration",
    "pair_means": "approach",
    "paired_difference": "statistics",
    "pairs_of": "approach",
    "pareto_front": "statistics",
    "play": "arbitration",
    "policy_condition": "arbitration",
    "policy_conditions": "arbitration",
    "policy_jobs": "arbitration",
    "random_scene": "scenes",
    "rank_biserial": "statistics",
    "rule_of": "sweep.space",
    "run_demo": "demo",
    "run_jobs": "sweep.runner",
    "save_rows": "output",
    "save_summary": "output",
    "scene_means": "outcomes",
    "scene_set": "scenes",
    "settle": "sweep.results",
    "share_interval": "statistics",
    "simulated": "arbitration",
    "tune": "sweep.tuning",
}
_PARTS = ("people", "sweep")

__all__ = [
    "FOLLOWERS",
    "LEVELS",
    "MANIPULABILITY_ONLY",
    "PAPER",
    "Arm",
    "Cases",
    "Choice",
    "Comparison",
    "Condition",
    "Demo",
    "Difficulty",
    "Dimension",
    "Engine",
    "Executed",
    "Failure",
    "FreshSelector",
    "Grade",
    "Interval",
    "Job",
    "JobFailed",
    "Pair",
    "PairedDifference",
    "Person",
    "PolicyCondition",
    "PolicyJob",
    "Progress",
    "Row",
    "RowStore",
    "Scene",
    "Settings",
    "Settled",
    "Soak",
    "Stability",
    "Stage",
    "Trial",
    "approach_conditions",
    "averages",
    "bootstrap",
    "compare",
    "dask_executor",
    "do",
    "do_policies",
    "episode_key",
    "explanation",
    "failures",
    "grade",
    "is_lifted",
    "kendall_tau",
    "library_of",
    "outcome",
    "pair_means",
    "paired_difference",
    "pairs_of",
    "pareto_front",
    "people",
    "play",
    "policy_condition",
    "policy_conditions",
    "policy_jobs",
    "random_scene",
    "rank_biserial",
    "rule_of",
    "run_demo",
    "run_jobs",
    "save_rows",
    "save_summary",
    "scene_means",
    "scene_set",
    "settle",
    "share_interval",
    "simulated",
    "sweep",
    "tune",
]

__getattr__ = lazily(__name__, _WHERE, _PARTS)


def __dir__() -> list[str]:
    return list(__all__)
