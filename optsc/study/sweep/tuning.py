"""Multi-objective tuning: Optuna proposes points generation by generation, the engine tries each on all cases.

A generation is tried as a whole, so that it shares geometry and executions; and everything tried is kept in the store,
so that a search with the same seed that is started again repeats itself without computing anything twice. There is
no other record of the search on purpose: what Optuna stores lacks the state of the random numbers, so that a search
that went on from there would not end where one that was never interrupted does.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from optsc.errors import InvalidValue, OptscError
from optsc.study.cases import Cases
from optsc.study.outcomes import Row
from optsc.study.statistics import mean_of
from optsc.study.sweep.results import best_of, trade_off_of
from optsc.study.sweep.runner import Progress, run_jobs
from optsc.study.sweep.space import Dimension, Point, check_distinct, condition_name, conditions
from optsc.study.sweep.store import RowStore

OBJECTIVES: Mapping[str, str] = {"path_length_m": "minimize", "target_yoshikawa": "maximize"}
"""What is tuned for by default: short paths, and configurations that can move on."""


@dataclass(frozen=True)
class TuningTrial:
    """One point and what it came to.

    Attributes:
        number: in the order of the search.
        point: what was tried.
        values: mean over all cases of each objective.
        success: share of the cases that succeeded.
        best: whether it is on the Pareto front, among those that succeed as often as any.
    """

    number: int
    point: Point
    values: Mapping[str, float]
    success: float
    best: bool = False


def tune(
    cases: Cases,
    dimensions: Sequence[Dimension],
    store: RowStore,
    *,
    trials: int = 200,
    generation: int = 20,
    seed: int = 0,
    objectives: Mapping[str, str] = OBJECTIVES,
    executor: Executor | None = None,
    workers: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> list[TuningTrial]:
    """Return all trials of a search by NSGA-II (Deb et al. 2002), those on the Pareto front marked as best.

    Means leave out the cases that failed, so a point that fails where another did not counts as infeasible: or else
    a point that fails in hard scenes would seem better.

    Args:
        cases: what each point is tried on, for one arm.
        dimensions: what may be varied, and how far.
        store: where outcomes are kept.
        trials: how many points are tried.
        generation: how many of them at once.
        seed: of the search.
        objectives: ``minimize`` or ``maximize`` by the name of one of `optsc.study.sweep.results.MEANS`.
        executor, workers, on_progress: see `run_jobs`.

    Raises:
        UnknownName: no such measure.
        InvalidValue: a direction or number that there is not, or cases of several arms, which would be averaged.
        OptscError: Optuna is not installed.
    """
    trade_off = trade_off_of(objectives)
    _check(cases, dimensions, trials, generation)
    try:
        import optuna
    except ImportError:
        raise OptscError("tuning needs the package optuna: pip install 'optsc[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(directions=list(objectives.values()), sampler=_sampler(generation, seed))
    done: list[TuningTrial] = []
    while len(done) < trials:
        asked = [study.ask() for _ in range(min(generation, trials - len(done)))]
        points = [{d.name: _suggest(trial, d) for d in dimensions} for trial in asked]
        jobs = cases.jobs(conditions(points))
        rows = run_jobs(jobs, store, executor=executor, workers=workers, on_progress=on_progress)
        means = _means(rows, len(points), list(objectives))
        new = [
            TuningTrial(one.number, point, values, success)
            for one, point, (success, values) in zip(asked, points, means, strict=True)
        ]
        done += new
        _tell(study, asked, new, max(trial.success for trial in done))
    return _marked(done, trade_off)


def _sampler(generation: int, seed: int) -> Any:
    import optuna

    with warnings.catch_warnings():
        # What takes the place of the constraints' function exists from version 5 on only.
        warnings.simplefilter("ignore")
        return optuna.samplers.NSGAIISampler(
            population_size=generation, seed=seed, constraints_func=lambda trial: (trial.user_attrs[BEHIND],)
        )


BEHIND = "behind"
"""Attribute of a trial for Optuna: how much less often it succeeded than the best so far; above 0 is infeasible."""


def _tell(study: Any, asked: Sequence[Any], trials: Sequence[TuningTrial], most: float) -> None:
    from optuna.trial import TrialState

    for one, trial in zip(asked, trials, strict=True):
        one.set_user_attr(BEHIND, most - trial.success)
        values = list(trial.values.values())
        if all(np.isfinite(values)):
            study.tell(one, values)
        else:
            study.tell(one, state=TrialState.FAIL)


def _means(rows: Sequence[Row], points: int, objectives: list[str]) -> list[tuple[float, dict[str, float]]]:
    """Return for each of so many ``points`` the share of successes and the means; 0 and NaN for one without rows."""
    from pandas import DataFrame

    table = DataFrame(rows, columns=["condition", "success", *objectives])
    names = [condition_name(k) for k in range(points)]
    means = table.groupby("condition")[["success", *objectives]].agg(mean_of).reindex(names)
    success = means.pop("success").astype(float).fillna(0.0)
    return list(zip(success.tolist(), means.astype(float).to_dict("records"), strict=True))


def _marked(trials: Sequence[TuningTrial], trade_off: Mapping[str, float]) -> list[TuningTrial]:
    """Return the trials, marked which of those that succeed as often as any are on the front."""
    costs = np.array([[sign * trial.values[name] for name, sign in trade_off.items()] for trial in trials])
    best = best_of(costs, np.array([trial.success for trial in trials]))
    return [replace(trial, best=bool(on_front)) for trial, on_front in zip(trials, best, strict=True)]


def _check(cases: Cases, dimensions: Sequence[Dimension], trials: int, generation: int) -> None:
    check_distinct(dimensions)
    if trials < 1 or generation < 2:
        raise InvalidValue("trials and generation", (trials, generation), "1 or more, 2 or more")
    robots = cases.robots if isinstance(cases.scenes, int) else {scene.robot for scene in cases.scenes}
    if len(robots) > 1:
        arms = ", ".join(robot if isinstance(robot, str) else robot.name for robot in robots)
        raise InvalidValue("robots to tune for", arms, "one: what suits one arm says little about another")


def _suggest(trial: Any, dimension: Dimension) -> Any:
    if dimension.values:
        return trial.suggest_categorical(dimension.name, list(dimension.values))
    # A share of the range, so that the search sees what the designs see, and numbers are rounded alike.
    return dimension.at(trial.suggest_float(dimension.name, 0.0, 1.0))
