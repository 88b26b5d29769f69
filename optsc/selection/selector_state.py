"""State of a grasp selector: all that observing, ranking and vetoing change, as one value."""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.geometry import Pose
from optsc.selection.filters import GraspFilter
from optsc.selection.grid import Grid
from optsc.selection.hysteresis import Viewpoint
from optsc.selection.ranking import Ranking
from optsc.selection.reach import ClearRows, FoundRows, JudgedRows
from optsc.selection.table_build import NO_ROWS, NewScene, TableBuild


class SelectorState(NamedTuple):
    """What a selector remembers; a value, so that keeping it is all that it takes to come back to it.

    Attributes:
        grid: the reach table in use, laid out for ranking; None before a scene was observed.
        clear: the collision check of that scene.
        vetoed: grasps that are not offered, as pairs of object name and grasp index.
        filters: those in force: the selector's own, the vetoes, and what a newer scene no longer has.
        filters_known: whether the latter was found out.
        viewpoint: what the newest ranking is made for.
        ranking: the newest ranking of a usable hand pose, None before.
        outdated: rows (R,) of finalists of that ranking that were solved from a configuration too far away, those
            nearest to the hand first.
        found: some of them, or other rows, solved again but not checked for collision.
        judged: rows that were solved again, and are not in the table yet.
        build: the reach table of a newer scene in the making, see `GraspSelector.announce`.
        waiting: a scene newer still.
    """

    grid: Grid | None = None
    clear: ClearRows | None = None
    vetoed: frozenset[tuple[str, int]] = frozenset()
    filters: tuple[GraspFilter, ...] = ()
    filters_known: bool = True
    viewpoint: Viewpoint | None = None
    ranking: Ranking | None = None
    outdated: np.ndarray = NO_ROWS
    found: FoundRows | None = None
    judged: tuple[JudgedRows, ...] = ()
    build: TableBuild | None = None
    waiting: NewScene | None = None


def unusable(X_WT: Pose, q: ArrayLike, n: int) -> str:
    """Return why a hand pose or configuration cannot be ranked for; "" when it can."""
    if X_WT.shape != ():
        return f"the hand pose is a batch of shape {X_WT.shape}"
    w, x, y, z = X_WT.quaternion.tolist()
    if not isfinite(w * w + x * x + y * y + z * z + sum(X_WT.translation.tolist())):
        return "the hand pose is not finite"
    if w * w + x * x + y * y + z * z < 1e-12:
        return "the hand's quaternion is zero"
    if np.shape(q) != (n,):
        return f"the arm's configuration has the shape {np.shape(q)}, not ({n},)"
    if not isfinite(sum(np.asarray(q, dtype=float).tolist())):
        return "the arm's configuration is not finite"
    return ""
