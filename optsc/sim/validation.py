"""Physical validation of grasp sets: every grasp is tried, on several cores, and the outcome kept with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from optsc.errors import InvalidValue, Mismatch, SolverFailure
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps import GraspSet
from optsc.processes import process_pool
from optsc.robot import PANDA_HAND
from optsc.sim.grasp_trial import TrialRow, TrialSettings, settled, trial
from optsc.sim.objects import ObjectModel

TrialProgress = Callable[[str, int, int], None]
"""Called with the object's name, the trials done and the trials in all."""

_CHUNK = 4  # trials handed to a process at once


class TrialOutcome(NamedTuple):
    """What happened to each of N grasps."""

    lifted: np.ndarray
    """(N,) bool: at the end in contact with both pads, up, and not slipped by more than allowed."""
    moved_before_closing: Array
    """Displacement of the object's origin during the approach (N,) [m]: a lot means that the hand bumped it."""
    moved_by_closing: Array
    """Displacement of the object's origin while the jaws closed (N,) [m]."""
    slip: Array
    """Displacement of the object's centre of mass in the hand between closing and the end (N,) [m]; NaN where lost."""
    slip_angle: Array
    """Turn of the object in the hand between closing and the end (N,) [rad]; NaN where lost."""

    def reasons(self, settings: TrialSettings) -> tuple[str, ...]:
        """Return for each grasp ``held``, ``bumped`` (and lost), ``lost``, or ``slipped``."""
        lost, bumped = np.isnan(self.slip), self.moved_before_closing > settings.bump
        words = np.where(lost, "lost", "slipped")
        words = np.where(bumped, "bumped", words)
        return tuple(np.where(self.lifted, "held", words).tolist())


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

    Args:
        model: the object.
        grasps: in the object's frame; made on its surface, or on a camera's cloud of it.
        settings: how a trial is done.
        X_WO: how the object rests on the plane z = 0; upright by default.
        workers: processes to share the work; with 1 it is done in this one.
        progress: called after each trial, or each few.

    Raises:
        Mismatch: the grasps were made on the surface of another object or for another gripper.
        InvalidValue: the object does not rest at ``X_WO``, which is no single pose, or ``workers`` below 1.
        SolverFailure: a worker process died.
    """
    settings = settings or TrialSettings()
    outcome = try_grasps(model, grasps, settings, X_WO=X_WO, workers=workers, progress=progress)
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


def try_grasps(
    model: ObjectModel,
    grasps: GraspSet,
    settings: TrialSettings | None = None,
    *,
    X_WO: Pose | None = None,
    workers: int = 1,
    progress: TrialProgress | None = None,
) -> TrialOutcome:
    """Return what happens when a floating Panda hand tries each grasp on the object, which stands on a plane.

    Each trial has a separate simulation, so the outcome of a grasp depends on nothing but itself: it is the
    same, bit for bit, for any number of workers. Arguments and errors are those of `validate`.
    """
    if workers < 1:
        raise InvalidValue("workers", workers, "1 or more")
    if grasps.gripper != PANDA_HAND.name:
        raise Mismatch("grasp trial", PANDA_HAND.name, grasps.gripper)
    if grasps.made_on_mesh and grasps.object_hash != model.mesh.hash:
        raise Mismatch(f"grasp set of {grasps.object_name}", grasps.object_hash[:12], model.mesh.hash[:12])
    settings = settings or TrialSettings()
    start = settled(model, Pose.identity() if X_WO is None else X_WO, settings)
    rows: list[TrialRow] = []
    with _mapping(min(workers, max(1, len(grasps)))) as apply:
        for row in apply(partial(trial, model, start, settings=settings), list(grasps.X_OG)):
            rows.append(row)
            if progress is not None:
                progress(model.name, len(rows), len(grasps))
    columns = np.array(rows, dtype=float).reshape(-1, len(TrialRow._fields)).T
    return TrialOutcome(columns[0].astype(bool), *columns[1:])


@contextmanager
def _mapping(workers: int) -> Iterator[Callable[[Callable[[Pose], Any], list[Pose]], Iterable[Any]]]:
    """Give something that maps like `map`, in order, in this process or over several."""
    if workers == 1:
        yield map
        return
    try:
        with process_pool(workers) as pool:
            yield partial(pool.map, chunksize=_CHUNK)
    except BrokenProcessPool as error:
        raise SolverFailure(f"a process that tried grasps died: {error}") from None
