"""What an older reach table still knows: the rows of grasps that have not moved."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from optsc.selection.reach import ReachTable


def rows_at_the_same_place(known: ReachTable, table: ReachTable) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of ``table`` whose grasp ``known`` has at exactly the same pose, and its rows there.

    Both have the same number of twins. Grasps are told by the names of their objects and their numbers.
    """
    new, old = table.candidates, known.candidates
    pairs = [
        (new.object_names.index(name), old.object_names.index(name))
        for name in new.object_names
        if name in old.object_names
    ]
    found: list[np.ndarray] = [np.zeros((2, 0), dtype=np.int64)]
    for mine, its in pairs:
        here, there = np.flatnonzero(new.object_index == mine), np.flatnonzero(old.object_index == its)
        _, first, second = np.intersect1d(new.grasp_index[here], old.grasp_index[there], return_indices=True)
        found.append(np.stack([here[first], there[second]]))
    mine, its = np.concatenate(found, axis=1)
    same = np.all(new.X_WG.quaternion[mine] == old.X_WG.quaternion[its], axis=1)
    same &= np.all(new.X_WG.translation[mine] == old.X_WG.translation[its], axis=1)
    twin = np.arange(table.twins)
    rows, of_known = (candidates[same, None] * table.twins + twin for candidates in (mine, its))
    return rows.ravel(), of_known.ravel()
