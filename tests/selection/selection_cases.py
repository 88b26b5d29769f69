"""Random candidates, reach tables and plain stand-ins for inverse kinematics and manipulability."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.grasps import Candidates
from optsc.selection import ReachTable, solve_reach

JOINTS = 7
CENTRE = np.array([0.5, 0.0, 0.2])
ROBOT = SimpleNamespace(n=JOINTS, name="a plain stand-in")


def random_candidates(rng, counts=(150, 150, 150), jaw_symmetric=True, spread=0.3):
    names = ("mug", "can", "box", "drill", "bottle")[: len(counts)]
    total = sum(counts)
    return Candidates(
        object_names=names,
        object_index=np.repeat(np.arange(len(counts)), counts),
        grasp_index=np.concatenate([np.arange(c) for c in counts]) if counts else np.zeros(0, dtype=int),
        X_WG=Pose(rotation.random(rng, (total,)), CENTRE + rng.uniform(-spread, spread, (total, 3))),
        opening=rng.uniform(0.01, 0.07, total),
        quality=rng.uniform(0.0, 1.0, total),
        jaw_symmetric=jaw_symmetric,
    )


def random_hand(rng):
    return Pose(rotation.random(rng), CENTRE + rng.uniform(-0.3, 0.3, 3))


def solve_all(X_WT, seeds):
    """Reach every pose; the posture depends on the pose alone, and slightly on the seed."""
    postures = np.concatenate([X_WT.translation, X_WT.quaternion], axis=1)
    return postures + 0.01 * np.asarray(seeds), np.ones(len(postures), dtype=bool)


class SmoothMeasure:
    """Some number in (0, 1) that depends on the posture in no simple way."""

    def evaluate(self, robot, q):
        return 0.5 + 0.5 * np.sin(np.sum(np.asarray(q) * np.arange(1, JOINTS + 1) * 3.7, axis=-1))


def table_of(candidates, q=None, **settings):
    q = np.zeros(JOINTS) if q is None else q
    return solve_reach(
        ROBOT, candidates, q, **{"solve": solve_all, "manipulability": SmoothMeasure(), **settings}
    )


def random_table(rng, candidates, reachable=0.8) -> ReachTable:
    """A table with random manipulabilities, in which each row is reachable with the given probability."""
    table = table_of(candidates)
    unreached = rng.random(table.status.shape) >= reachable
    return replace(
        table,
        status=np.where(unreached, rng.integers(1, 4, table.status.shape), 0).astype(np.int8),
        manipulability=np.where(unreached, 0.0, rng.random(table.status.shape)),
    )


def shuffled(candidates, table, order):
    """The same candidates and rows in another order; ``order[j]`` is the old index of the new j-th."""
    moved = replace(
        candidates,
        object_index=candidates.object_index[order],
        grasp_index=candidates.grasp_index[order],
        X_WG=candidates.X_WG[order],
        opening=candidates.opening[order],
        quality=candidates.quality[order],
    )
    rows = {
        name: getattr(table, name)[order]
        for name in ("X_WG", "X_WP", "q_grasp", "q_pregrasp", "status", "manipulability", "seed")
    }
    return replace(table, candidates=moved, **rows)


def no_solutions(X_WT, seeds):
    raise AssertionError("nothing is solved here")
