"""What the paper's picture shows, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.metrics import path_length

PROPOSED_COLOUR, BASELINE_COLOUR = "#e8710a", "#1f6fb4"
"""The paper's colours: orange with the person's preference in it, blue without."""


@dataclass(frozen=True, eq=False)
class SelectedGrasps:
    """Where the tool is at one moment, and which grasp is then selected for each object.

    Attributes:
        title: of its panel.
        X_WT: the tool.
        grasps: selected tool pose X_WG by object name.
    """

    title: str
    X_WT: Pose
    grasps: Mapping[str, Pose]


@dataclass(frozen=True, eq=False)
class Curve:
    """The way of the tool under one strategy.

    Attributes:
        label: for the legend.
        p: tool positions in the world (N, 3) [m].
        automatic: whether the arm moved by itself at each sample (N,); dashed where it did not.
        colour: any that matplotlib knows.
        X_WG: tool pose at the grasp where it ends, drawn as a marker; None for no marker.
    """

    label: str
    p: Array
    automatic: np.ndarray
    colour: str = PROPOSED_COLOUR
    X_WG: Pose | None = None

    def __post_init__(self) -> None:
        p, automatic = np.asarray(self.p, dtype=float), np.asarray(self.automatic, dtype=bool)
        if p.ndim != 2 or p.shape[1] != 3 or len(p) < 2 or not np.all(np.isfinite(p)):
            raise InvalidValue(f"curve {self.label!r}", p.shape, "finite, shape (N, 3), at least two points")
        if automatic.shape != p.shape[:1]:
            raise InvalidValue(f"modes of curve {self.label!r}", automatic.shape, f"shape {p.shape[:1]}")
        object.__setattr__(self, "p", p)
        object.__setattr__(self, "automatic", automatic)

    def pieces(self) -> list[tuple[bool, Array]]:
        """Return the runs of one mode (automatic, points (M, 3)); each starts where the one before ends."""
        edges = np.flatnonzero(self.automatic[1:] != self.automatic[:-1]) + 1
        starts, ends = [0, *(edges - 1)], [*edges, len(self.p)]
        return [
            (bool(self.automatic[end - 1]), self.p[start:end])
            for start, end in zip(starts, ends, strict=True)
        ]

    def automatic_length(self) -> float:
        """Return how far the tool went by itself [m]."""
        return sum(path_length(p) for automatic, p in self.pieces() if automatic)

    def hand_overs(self) -> Array:
        """Return where the arm began to move by itself (K, 3) [m]."""
        return self.p[np.flatnonzero(self.automatic[1:] & ~self.automatic[:-1])]
