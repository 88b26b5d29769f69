"""Multi-objective tuning: Optuna proposes points generation by generation, the engine tries each on all cases.

A generation is tried as a whole, so that it shares geometry and executions; and everything tried is kept in the store,
so that a search with the same seed that is started again finds its way back without computing anything twice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from optsc.errors import InvalidValue, OptscError, UnknownName
from optsc.study.outcomes import CHOSEN, MEASURED, Row
from optsc.study.statistics import mean_of, pareto_front
from optsc.study.sweep.plan import Cases
from optsc.study.sweep.runner import Progress, run_jobs
from optsc.study.sweep.space import Dimension, Point, conditions
from optsc.study.sweep.store import RowStore

OBJECTIVES: Mapping[str, str] = {"path_length_m": "minimize", "target_yoshikawa": "maximize"}
"""What is tuned for by default: short ways, and postures that can move on."""


@dataclass(frozen=True)
class Trial:
    """One point and what it came to: means over all cases of each objective, and the share that arrived."""

    number: int
    point: Point
    values: Mapping[str, float]
    arrived: float
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
) -> list[Trial]:
    """Return all trials of a search by NSGA-II (Deb et al. 2002), those on the Pareto front marked as best.

    Args:
        cases: what each point is tried on.
        dimensions: what may be varied, and how far.
        store: where outcomes are kept.
        trials: how many points are tried.
        generation: how many of them at once.
        seed: of the search.
        objectives: ``minimize`` or ``maximize`` by the name of a measure.
        executor, workers, on_progress: see `run_jobs`.

    Raises:
        UnknownName: no such measure. InvalidValue: a direction or number that there is not.
        OptscError: Optuna is not installed.
    """
    _check(objectives, trials, generation)
    try:
        import optuna
    except ImportError:
        raise OptscError("tuning needs the package optuna: pip install 'optsc[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.NSGAIISampler(population_size=generation, seed=seed)
    study = optuna.create_study(directions=list(objectives.values()), sampler=sampler)
    done: list[Trial] = []
    while len(done) < trials:
        asked = [study.ask() for _ in range(min(generation, trials - len(done)))]
        points = [{d.name: _suggest(trial, d) for d in dimensions} for trial in asked]
        rows = _tried(cases, points, store, executor, workers, on_progress)
        for trial, point, of_point in zip(asked, points, rows, strict=True):
            values = {name: mean_of([row[name] for row in of_point]) for name in objectives}
            arrived = float(np.mean([row["arrived"] for row in of_point])) if of_point else 0.0
            if all(np.isfinite(list(values.values()))):
                study.tell(trial, list(values.values()))
            else:
                study.tell(trial, state=optuna.trial.TrialState.FAIL)
            done.append(Trial(trial.number, point, values, arrived))
    signs = [1.0 if direction == "minimize" else -1.0 for direction in objectives.values()]
    costs = np.array(
        [[s * trial.values[n] for s, n in zip(signs, objectives, strict=True)] for trial in done]
    )
    return [
        Trial(t.number, t.point, t.values, t.arrived, bool(best))
        for t, best in zip(done, pareto_front(costs), strict=True)
    ]


def _check(objectives: Mapping[str, str], trials: int, generation: int) -> None:
    for name, direction in objectives.items():
        if name not in (*MEASURED, *CHOSEN):
            raise UnknownName("measure", name, (*MEASURED, *CHOSEN))
        if direction not in ("minimize", "maximize"):
            raise InvalidValue(f"direction of {name}", direction, "minimize or maximize")
    if len(objectives) < 1 or trials < 1 or generation < 2:
        raise InvalidValue(
            "objectives, trials, generation", (len(objectives), trials, generation), "1, 1, 2 or more"
        )


def _suggest(trial: Any, dimension: Dimension) -> Any:
    if dimension.values:
        return trial.suggest_categorical(dimension.name, list(dimension.values))
    # A share of the range, so that the search sees what the designs see, and numbers are rounded alike.
    return dimension.at(trial.suggest_float(dimension.name, 0.0, 1.0))


def _tried(
    cases: Cases,
    points: Sequence[Point],
    store: RowStore,
    executor: Executor | None,
    workers: int | None,
    on_progress: Callable[[Progress], None] | None,
) -> list[list[Row]]:
    """Return the rows of each point over all cases; none for a point that ranks nothing."""
    wanted = conditions(points)
    rows = run_jobs(cases.jobs(wanted), store, executor=executor, workers=workers, on_progress=on_progress)
    numbers = [int(row["condition"]) for row in rows]
    return [[row for row, n in zip(rows, numbers, strict=True) if n == k] for k in range(len(points))]
