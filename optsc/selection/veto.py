"""The operator's veto: grasps that are not to be offered again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optsc.selection.filters import GraspFilter
from optsc.selection.grid import Situation


@dataclass(frozen=True)
class Vetoed(GraspFilter):
    """Leaves out single grasps.

    Attributes:
        grasps: pairs of object name and grasp index; what is not among the candidates is ignored.
    """

    grasps: frozenset[tuple[str, int]]

    @property
    def reason(self) -> str:
        """Why: a person said so."""
        return "vetoed"

    def passes(self, situation: Situation) -> np.ndarray:
        """Return which candidates (K, M) nobody vetoed."""
        layout = situation.grid.layout
        grasp = layout.spread(layout.candidates.grasp_index, -1)
        passes = np.ones(grasp.shape, dtype=bool)
        for name, index in self.grasps:
            if name in layout.names:
                passes[layout.names.index(name)] &= grasp[layout.names.index(name)] != index
        return passes
