"""Scene change: how a selector goes over from the reach table of one scene to that of the next, piece by piece."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from optsc.selection.filters import Gone, GraspFilter, Vetoed
from optsc.selection.grid import Grid
from optsc.selection.reach import ClearRows, ReachSolver, ReachTable
from optsc.selection.selector_state import SelectorState
from optsc.selection.table_build import NO_ROWS, advanced, begin, no_longer_there


def with_table(state: SelectorState, table: ReachTable, clear: ClearRows | None) -> SelectorState:
    """Return the state with another table in use, and nothing of a newer scene."""
    return state._replace(
        grid=Grid(table),
        clear=clear,
        outdated=NO_ROWS,
        found=None,
        judged=(),
        build=None,
        waiting=None,
        filters_known=True,
    )


def filters_in_force(state: SelectorState, own: Sequence[GraspFilter]) -> tuple[GraspFilter, ...]:
    """Return the filters in force: a selector's ``own``, the vetoes, and what a newer scene no longer has."""
    newer = state.waiting or state.build
    found = (*own, Vetoed(state.vetoed)) if state.vetoed else tuple(own)
    if newer is None or state.grid is None:
        return found
    gone = no_longer_there(state.grid.table.candidates, newer.candidates)
    return (*found, Gone(gone)) if gone.any() else found


def gone_on(
    state: SelectorState, solver: ReachSolver, own: Sequence[GraspFilter], q: ArrayLike
) -> tuple[SelectorState, bool]:
    """Return the state after another piece of a new table, and whether that is in use from now on.

    ``q`` (n,) [rad] is the configuration that it is solved from, where it is the first piece.
    """
    if not state.filters_known:
        return state._replace(filters=filters_in_force(state, own), filters_known=True), False
    build, waiting = state.build, state.waiting
    if build is None:
        if waiting is None:
            return state, False
        known = None if state.grid is None else state.grid.table
        return state._replace(build=begin(solver, waiting, q, known), waiting=None), False
    if build.whole is None:
        return state._replace(build=advanced(build, solver)), False
    after = with_table(state, build.whole, build.clear)._replace(waiting=waiting, viewpoint=None, ranking=None)
    vetoes = (Vetoed(state.vetoed),) if state.vetoed else ()
    return after._replace(filters=(*own, *vetoes), filters_known=waiting is None), True


def given_up(state: SelectorState) -> SelectorState:
    """Return the state without the scene that was being worked on; what is no longer there stays left out."""
    return state._replace(build=None, waiting=None if state.build is None else state.waiting)
