"""Table build: a reach table in the making, worked out a few rows at a time while an older one is in use.

Solving a table takes as long as hundreds of control ticks may. So the rows are solved in pieces, bounded by counts, and
the table is put together when the last one is done: it is the same, to the last bit, as one that is solved at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.selection.reach import ClearRows, FoundRows, JudgedRows, ReachSolver, ReachTable, joined, with_rows

if TYPE_CHECKING:
    from optsc.grasps import Candidates

ROWS_SOLVED = 8
"""Rows that one piece solves."""
ROWS_JUDGED = 4
"""Rows whose configurations are known, which one piece checks for what they touch."""
NO_ROWS = np.zeros(0, dtype=np.int64)
NO_ROWS.flags.writeable = False
PARTS = 16
"""So many parts are put together to one as soon as they are there, so that the end does not have to do it all."""
MOVED = 0.01
"""A grasp that has moved by more than this [m] is no longer there: half a pad's width."""


class NewScene(NamedTuple):
    """The grasps of a scene, their collision check, and their reach table, where it was solved elsewhere."""

    candidates: Candidates
    clear: ClearRows | None
    table: ReachTable | None = None


class TableBuild(NamedTuple):
    """A reach table in the making.

    Attributes:
        table: of all rows, none of them solved.
        clear: the collision check of its scene.
        known: a table in which some rows may be known; None once they are found there.
        source, kept, of_known: the table that knows some rows, which (R,), and where there (R,).
        unsolved: the other rows.
        found: configurations of some of them that were not checked for collision.
        parts: what was found out so far.
        whole: the table with all of that, once it is.
    """

    table: ReachTable
    clear: ClearRows | None
    known: ReachTable | None
    unsolved: np.ndarray
    source: ReachTable | None = None
    kept: np.ndarray = NO_ROWS
    of_known: np.ndarray = NO_ROWS
    found: FoundRows | None = None
    parts: tuple[JudgedRows, ...] = ()
    whole: ReachTable | None = None

    @property
    def candidates(self) -> Candidates:
        """The grasps of the table."""
        return self.table.candidates


def begin(solver: ReachSolver, scene: NewScene, q: ArrayLike, known: ReachTable | None = None) -> TableBuild:
    """Return the build of `ReachSolver.table` for the same arguments; raise what it raises for them."""
    if scene.table is not None:
        return TableBuild(scene.table, scene.clear, None, NO_ROWS, whole=scene.table)
    table = solver.empty_table(scene.candidates, q, clear=scene.clear)
    return TableBuild(table, scene.clear, known, np.arange(table.rows))


def advanced(build: TableBuild, solver: ReachSolver) -> TableBuild:
    """Return the build after another piece; the same where it is whole. Raises what the collision check raises."""
    if build.known is not None:
        kept, of_known = solver.rows_known(build.table, build.known)
        unsolved = np.setdiff1d(build.unsolved, kept)
        return build._replace(known=None, source=build.known, kept=kept, of_known=of_known, unsolved=unsolved)
    if len(build.kept) and build.source is not None:
        rows, of_known = build.kept[:ROWS_JUDGED], build.of_known[:ROWS_JUDGED]
        part = solver.judged_again(build.table, rows, build.source, of_known, build.clear)
        build = build._replace(kept=build.kept[ROWS_JUDGED:], of_known=build.of_known[ROWS_JUDGED:])
        return _with_part(build, part)
    if build.found is not None:
        some = FoundRows(*(values[:ROWS_JUDGED] for values in build.found))
        rest = FoundRows(*(values[ROWS_JUDGED:] for values in build.found))
        part = solver.judged(build.table, some, build.clear)
        return _with_part(build._replace(found=rest if len(rest.rows) else None), part)
    if len(build.unsolved):
        q = build.table.seed[0, 0]
        found = solver.found(build.table, build.unsolved[:ROWS_SOLVED], q)
        return build._replace(found=found, unsolved=build.unsolved[ROWS_SOLVED:])
    return build if build.whole is not None else build._replace(whole=with_rows(build.table, build.parts))


def _with_part(build: TableBuild, part: JudgedRows) -> TableBuild:
    """Return the build with another part; the last ones are put together where there are enough."""
    parts = (*build.parts, part)
    recent = [one for one in parts if len(one.rows) <= ROWS_SOLVED]
    if len(recent) < PARTS:
        return build._replace(parts=parts)
    return build._replace(parts=(*parts[: -len(recent)], joined(recent)))


def no_longer_there(before: Candidates, now: Candidates) -> np.ndarray:
    """Return which grasps (N,) of an earlier scene have none of the same object within `MOVED` of them now."""
    gone = np.zeros(len(before), dtype=bool)
    for index, name in enumerate(before.object_names):
        rows = np.flatnonzero(before.object_index == index)
        if name not in now.object_names:
            gone[rows] = True
            continue
        there = np.flatnonzero(now.object_index == now.object_names.index(name))
        p, others = before.X_WG.translation[rows], now.X_WG.translation[there]
        if p.shape == others.shape and np.array_equal(p, others):
            continue
        squares = np.square(p).sum(axis=1)[:, None] + np.square(others).sum(axis=1) - 2.0 * p @ others.T
        gone[rows] = squares.min(axis=1, initial=np.inf) > MOVED**2
    return gone
