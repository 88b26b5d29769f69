"""Random candidates, reach tables and plain stand-ins for inverse kinematics and manipulability."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from optsc.selection import ReachSolver, ReachTable
from optsc.testing.costs import JOINTS, random_candidates, random_hand, shuffled

__all__ = [
    "JOINTS",
    "ROBOT",
    "SmoothMeasure",
    "no_solutions",
    "random_candidates",
    "random_hand",
    "random_table",
    "shuffled",
    "solve_all",
    "table_of",
]

ROBOT = SimpleNamespace(n=JOINTS, name="a plain stand-in", endless=np.zeros(JOINTS, dtype=bool), difference=np.subtract)


def solve_all(X_WT, seeds):
    """Reach every pose; the configuration depends on the pose alone, and slightly on the seed."""
    q = np.concatenate([X_WT.translation, X_WT.quaternion], axis=1)
    return q + 0.01 * np.asarray(seeds), np.ones(len(q), dtype=bool)


class SmoothMeasure:
    """Some number in (0, 1) that depends on the configuration in no simple way."""

    def evaluate(self, robot, q):
        return 0.5 + 0.5 * np.sin(np.sum(np.asarray(q) * np.arange(1, JOINTS + 1) * 3.7, axis=-1))


def solver(**settings):
    return ReachSolver(ROBOT, **{"solve": solve_all, "manipulability": SmoothMeasure(), **settings})


def table_of(candidates, q=None, clear=None, **settings):
    return solver(**settings).table(candidates, np.zeros(JOINTS) if q is None else q, clear=clear)


def random_table(rng, candidates, reachable=0.8) -> ReachTable:
    """A table with random manipulabilities, in which each row is reachable with the given probability."""
    table = table_of(candidates)
    unreached = rng.random(table.status.shape) >= reachable
    return replace(
        table,
        status=np.where(unreached, rng.integers(1, 4, table.status.shape), 0).astype(np.int8),
        manipulability=np.where(unreached, 0.0, rng.random(table.status.shape)),
    )


def no_solutions(X_WT, seeds):
    raise AssertionError("nothing is solved here")
