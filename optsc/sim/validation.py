"""Trying every grasp of a set on several cores, and keeping the outcome with each of them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np

from optsc.errors import InvalidValue, SolverFailure
from optsc.geometry import Pose
from optsc.grasps import GraspSet
from optsc.sim.grasp_trial import check_fit, outcome_of, settled, trial
from optsc.sim.objects import ObjectModel
from optsc.sim.trial_settings import TrialOutcome, TrialSettings

TrialProgress = Callable[[str, int, int], None]
"""Called with the object's name, the trials done and the trials in all."""

_CHUNK = 4  # trials handed to a process at once


def usable_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def validate(
    model: ObjectModel,
    grasps: GraspSet,
    settings: TrialSettings | None = None,
    *,
    X_WO: Pose | None = None,
    workers: int = 1,
    progress: TrialProgress | None = None,
) -> GraspSet:
    """Return the same grasps with `GraspSet.tried` and `GraspSet.held` set, and a summary in the provenance.

    The outcome is the same, bit for bit, for any number of workers: each trial has a simulation of its own.

    Args:
        model: the object.
        grasps: in the object's frame.
        settings: how a trial is done.
        X_WO: how the object rests on the plane z = 0; upright by default.
        workers: processes to share the work; with 1 it is done in this one.
        progress: called after each trial, or each few.

    Raises:
        Mismatch: the grasps were made on the surface of another object or for another gripper.
        InvalidValue: the object does not rest at ``X_WO``, or ``workers`` below 1.
        SolverFailure: a worker process died.
    """
    settings = settings or TrialSettings()
    outcome = try_in_parallel(model, grasps, settings, X_WO=X_WO, workers=workers, progress=progress)
    facts = {
        "settings": settings.facts(),
        "held": int(outcome.lifted.sum()),
        "tried": len(grasps),
        "reasons": dict(sorted(Counter(outcome.reasons(settings)).items())),
    }
    return replace(
        grasps,
        tried=np.ones(len(grasps), dtype=bool),
        held=outcome.lifted,
        provenance={**grasps.provenance, "validation": facts},
    )


def try_in_parallel(
    model: ObjectModel,
    grasps: GraspSet,
    settings: TrialSettings | None = None,
    *,
    X_WO: Pose | None = None,
    workers: int = 1,
    progress: TrialProgress | None = None,
) -> TrialOutcome:
    """Return what happens to each grasp, as `optsc.sim.grasp_trial.try_grasps` does, on several cores."""
    if workers < 1:
        raise InvalidValue("workers", workers, "1 or more")
    check_fit(model, grasps)
    settings = settings or TrialSettings()
    start = settled(model, Pose.identity() if X_WO is None else X_WO, settings)
    work = partial(trial, model, start, settings=settings)
    rows = []
    with _mapping(min(workers, max(1, len(grasps)))) as apply:
        for row in apply(work, list(grasps.X_OG)):
            rows.append(row)
            if progress is not None:
                progress(model.name, len(rows), len(grasps))
    return outcome_of(rows)


@contextmanager
def _mapping(workers: int) -> Iterator[Callable[[Callable[[Pose], Any], list[Pose]], Iterable[Any]]]:
    """Give something that maps like `map`, in order, in this process or over several."""
    if workers == 1:
        yield map
        return
    # Processes are started anew: a copy of this one could inherit a simulation or a thread half way.
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        yield partial(pool.map, chunksize=_CHUNK)
    except BrokenProcessPool as error:
        raise SolverFailure(f"a process that tried grasps died: {error}") from None
    finally:
        pool.shutdown(cancel_futures=True)
