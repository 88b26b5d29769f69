"""Motion figures of a report: control modes over time, and tool paths among the objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from optsc.geometry import Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.viewers import shapes
from optsc.viewers.drawing import fill, new_figure, plain_axes
from optsc.viewers.report_statistics import FAINT, INK, QUIET

MODE_COLOURS: Mapping[str, str] = {
    "hold": "#b9bfc6",
    "manual": "#7a6bb0",
    "approach": "#e8710a",
    "adjust": "#f2b134",
    "advance": "#b5410a",
    "close": "#22272e",
    "lift": "#2f8f83",
    "carry": "#7cc4a4",
}
"""One colour per control mode, the same in timelines and trajectories."""
_BESIDE = 2.0
"""Width that axes and legend take beside the panels [in]."""
_OTHER = "#c2185b"
"""Modes without a colour in `MODE_COLOURS`."""
PlacedParts: TypeAlias = Mapping[str, tuple[Sequence[TriangleMesh], Pose]]
"""Convex parts of each object, and its pose X_WO, by name."""


@dataclass(frozen=True, eq=False)
class ToolPath:
    """Path of the tool, with the control mode at each sample.

    Attributes:
        label: of its line or panel.
        p: positions in the world (N, 3) [m].
        modes: control mode at each of them (N,).
        rate: of the samples [Hz].
        X_WG: tool pose at the grasp that it leads to, drawn as a fork; None for none.
    """

    label: str
    p: Array
    modes: Sequence[str]
    rate: float
    X_WG: Pose | None = None

    def stretches(self) -> list[tuple[str, int, int]]:
        """Return mode, first and behind-last sample of every stretch of one mode."""
        edges = [i for i in range(1, len(self.modes)) if self.modes[i] != self.modes[i - 1]]
        return [(self.modes[start], start, end) for start, end in pairwise([0, *edges, len(self.modes)])]


def timelines(paths: Sequence[ToolPath]) -> Any:
    """Return a figure with one bar per path, coloured by mode along time."""
    figure, axis = new_figure(figsize=(9.6, 0.9 + 0.36 * len(paths)))
    for line, path in enumerate(paths):
        for mode, start, end in path.stretches():
            width, colour = (end - start) / path.rate, MODE_COLOURS.get(mode, _OTHER)
            axis.barh(line, width, left=start / path.rate, height=0.62, color=colour)
    axis.set_yticks(range(len(paths)), [path.label for path in paths])
    axis.invert_yaxis()
    axis.set_xlabel("time [s]")
    _legend(axis, paths)
    plain_axes(axis, labels=QUIET, grid=FAINT)
    figure.tight_layout()
    return figure


def trajectories(objects: PlacedParts, paths: Sequence[ToolPath], title: str = "", goal: str = "") -> Any:
    """Return a figure of one scene from above and from the side, a column for each path, coloured by mode."""
    everything = [path.p for path in paths]
    everything += [X.apply(part.vertices) for parts, X in objects.values() for part in parts]
    points = np.concatenate(everything)
    low, high = points.min(axis=0) - 0.03, points.max(axis=0) + 0.03
    low[2] = min(low[2], -0.01)
    size = high - low
    width = 4.0
    heights = [width * size[1] / size[0], width * size[2] / size[0]]
    figsize = (width * len(paths) + _BESIDE, min(sum(heights) + 1.5, 12.0))
    shared = {"sharex": True, "sharey": "row", "height_ratios": heights}
    figure, axes = new_figure(2, len(paths), figsize=figsize, squeeze=False, **shared)
    for column, path in enumerate(paths):
        for row, other in enumerate((1, 2)):
            axis = axes[row][column]
            _draw_objects(axis, objects, goal, other)
            _draw_path(axis, path, other)
            axis.set(xlim=(low[0], high[0]), ylim=(low[other], high[other]), aspect="equal")
            if column == 0:
                axis.set_ylabel("y [m], from above" if other == 1 else "z [m], from the side", fontsize=9)
            plain_axes(axis, labels=QUIET, grid=FAINT)
        axes[0][column].set_title(path.label, fontsize=9.5, color=INK)
        axes[1][column].set_xlabel("x [m]", fontsize=9)
    _legend(axes[0][-1], paths)
    if title:
        figure.suptitle(title, fontsize=10.5, color=INK)
    figure.tight_layout()
    return figure


def _draw_path(axis: Any, path: ToolPath, other: int) -> None:
    for mode, start, end in path.stretches():
        part = path.p[max(start - 1, 0) : end]
        colour = MODE_COLOURS.get(mode, _OTHER)
        axis.plot(part[:, 0], part[:, other], color=colour, linewidth=2.2, solid_capstyle="round", zorder=5)
        if mode == "approach":
            axis.plot(*part[0, [0, other]], "o", ms=6, mfc="white", mec=INK, mew=1.3, zorder=7)
    axis.plot(*path.p[-1, [0, other]], "s", ms=5, color=INK, zorder=7)
    if path.X_WG is not None:
        fork = shapes.box_triangles(shapes.fork_boxes(thickness=0.004), path.X_WG)[..., [0, other]]
        fill(axis, fork, "#9aa4af", zorder=4)


def _draw_objects(axis: Any, objects: PlacedParts, goal: str, other: int) -> None:
    from scipy.spatial import ConvexHull

    for name, (parts, X_WO) in objects.items():
        colour = "#f3d9c2" if name == goal else "#e2e6ea"
        flat = [X_WO.apply(part.vertices)[:, [0, other]] for part in parts]
        # The shadow of a convex part is the hull of its points: a handful of corners in place of all triangles.
        fill(axis, [points[ConvexHull(points).vertices] for points in flat], colour, zorder=2)
        if other == 1:
            at = X_WO.translation
            axis.text(at[0], at[1], name, color=QUIET, fontsize=8, ha="center", va="center", zorder=3)


def _legend(axis: Any, paths: Sequence[ToolPath]) -> None:
    from matplotlib.patches import Patch

    used = dict.fromkeys(mode for path in paths for mode, *_ in path.stretches())
    handles = [Patch(color=MODE_COLOURS.get(mode, _OTHER), label=mode) for mode in used]
    axis.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8.5)
