"""Tool path panel of the approach figure: each strategy's path from above and from the side, to one scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.metrics import path_length
from optsc.viewers import shapes
from optsc.viewers.drawing import INK, QUIET, fill, halo, mixed_with_white, plain_axes
from optsc.viewers.figure_approach_scene import PlacedMeshes

PROPOSED_COLOUR, BASELINE_COLOUR = "#e8710a", "#1f6fb4"
"""The paper's colours: orange with the person's preference in it, blue without."""
_BY_HAND = (0, (3.0, 1.8))
_REACHED = 0.1
"""How near to an object a path ends that leads to it [m]."""
_LEAD = 0.12
"""How much of what was driven by hand is surely shown, about the hand-over [m]."""
_GAP = 0.12
"""Between the two views [inches]."""


@dataclass(frozen=True, eq=False)
class StrategyPath:
    """Path of the tool under one strategy.

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
            raise InvalidValue(f"path {self.label!r}", p.shape, "finite, shape (N, 3), at least two points")
        if automatic.shape != p.shape[:1]:
            raise InvalidValue(f"modes of path {self.label!r}", automatic.shape, f"shape {p.shape[:1]}")
        object.__setattr__(self, "p", p)
        object.__setattr__(self, "automatic", automatic)

    def pieces(self) -> list[tuple[bool, Array]]:
        """Return the runs of one mode (automatic, points (M, 3)); each starts where the one before ends."""
        edges = np.flatnonzero(self.automatic[1:] != self.automatic[:-1]) + 1
        starts, ends = [0, *(edges - 1)], [*edges, len(self.p)]
        pairs = zip(starts, ends, strict=True)
        return [(bool(self.automatic[end - 1]), self.p[start:end]) for start, end in pairs]

    def automatic_length(self) -> float:
        """Return how far the tool went by itself [m]."""
        return sum(path_length(p) for automatic, p in self.pieces() if automatic)

    def hand_overs(self) -> Array:
        """Return where the arm began to move by itself (K, 3) [m]."""
        return self.p[np.flatnonzero(self.automatic[1:] & ~self.automatic[:-1])]


def draw_paths(
    figure: Any,
    frame: tuple[float, float, float, float],
    objects: PlacedMeshes,
    colours: Mapping[str, str],
    paths: Sequence[StrategyPath],
) -> None:
    """Draw the views, one above the other, into ``frame`` (left, bottom, width, height) [inches]."""
    left, bottom, width, height = frame
    lower, upper, scale = _extent(objects, paths, width, height - _GAP)
    side_height = scale * (upper - lower)[2]
    top_height = scale * (upper - lower)[1]
    inches = np.array([*figure.get_size_inches()] * 2)
    side = figure.add_axes(np.array([left, bottom, width, side_height]) / inches)
    top = figure.add_axes(np.array([left, bottom + side_height + _GAP, width, top_height]) / inches)
    for axes, j, name in ((top, 1, "from above"), (side, 2, "from the side")):
        _draw_objects(axes, objects, colours, paths, j)
        for path in reversed(paths):
            _draw_path(axes, path, j)
        axes.set(xlim=(lower[0], upper[0]), ylim=(lower[j], upper[j]))
        axes.set_aspect("equal", adjustable="box")
        axes.text(0.985, 0.97, name, transform=axes.transAxes, color=QUIET, fontsize=8.5, ha="right", va="top")
        axes.set_ylabel(f"{'xyz'[j]} [m]", color=INK, fontsize=9)
        plain_axes(axes, labels=QUIET, grid="#eceef1")
        axes.locator_params(steps=[1, 2, 5, 10], nbins=6)
    top.tick_params(labelbottom=False)
    side.axhline(0.0, color=QUIET, linewidth=1.0, zorder=1)
    side.set_xlabel("x [m]", color=INK, fontsize=9)


def draw_legend(figure: Any, paths: Sequence[StrategyPath], at: tuple[float, float]) -> None:
    """Draw the legend with its lower right corner ``at`` this place of ``figure`` [shares of its size]."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=c.colour, lw=2.4, label=f"{c.label}: {c.automatic_length():.2f} m automatic")
        for c in paths
    ]
    handles += [
        Line2D([], [], color=QUIET, lw=1.6, ls=_BY_HAND, label="by hand"),
        Line2D([], [], color="none", marker="o", ms=6.5, mfc="white", mec=INK, mew=1.4, label="hand-over"),
    ]
    figure.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=at,
        ncols=2,
        frameon=False,
        fontsize=9,
        labelcolor=INK,
        handlelength=2.4,
        columnspacing=1.6,
    )


def _extent(
    objects: PlacedMeshes, paths: Sequence[StrategyPath], width: float, height: float
) -> tuple[Array, Array, float]:
    """Return lower and upper corner (3,) [m] of what is shown, filling the panel, and inches per metre.

    Within it are the paths from shortly before the hand-over, their markers, and the objects they lead to.
    """
    points = []
    for path in paths:
        starts = path.hand_overs()
        near = np.linalg.norm(path.p[:, None] - starts, axis=-1).min(axis=1, initial=np.inf) <= _LEAD
        points.append(path.p[near | path.automatic] if len(starts) else path.p)
        if path.X_WG is not None:
            points.append(shapes.box_triangles(shapes.fork_boxes(), path.X_WG).reshape(-1, 3))
    for mesh, X_WO in objects.values():
        surface = shapes.mesh_triangles(mesh, X_WO)
        if _is_reached(surface, paths):
            points.append(surface.reshape(-1, 3))
    everything = np.concatenate(points)
    lower, upper = everything.min(axis=0) - 0.025, everything.max(axis=0) + 0.025
    lower[2] = min(lower[2], -0.015)
    size = upper - lower
    scale = min(width / size[0], height / (size[1] + size[2]))
    # The longer side of the panel shows more of the surroundings instead of staying empty.
    spare = np.array([width / scale - size[0], *[height / scale - size[1] - size[2]] * 2]) / [2.0, 4.0, 4.0]
    return lower - spare * [1.0, 1.0, 0.0], upper + spare * [1.0, 1.0, 2.0], scale


def _draw_objects(
    axes: Any, objects: PlacedMeshes, colours: Mapping[str, str], paths: Sequence[StrategyPath], j: int
) -> None:
    for name, (mesh, X_WO) in objects.items():
        surface = shapes.mesh_triangles(mesh, X_WO)
        reached = _is_reached(surface, paths)
        colour = mixed_with_white(colours[name], 0.34 if reached else 0.14)
        # Filled triangles of one colour make the exact outline, also of what is hollow or has a handle.
        fill(axes, surface[..., [0, j]], colour, zorder=3 if reached else 2)
        if j == 1:
            low, high = surface.min(axis=(0, 1)), surface.max(axis=(0, 1))
            at = (high[0] + 0.006, 0.5 * (low[1] + high[1]))
            style = {"color": colours[name], "fontsize": 8.5, "va": "center", "path_effects": halo()}
            axes.text(*at, name, zorder=8, clip_on=True, **style)


def _is_reached(surface: Array, paths: Sequence[StrategyPath]) -> bool:
    points = surface.reshape(-1, 3)
    return bool(min(np.linalg.norm(points - path.p[-1], axis=1).min() for path in paths) <= _REACHED)


def _draw_path(axes: Any, path: StrategyPath, j: int) -> None:
    for automatic, p in path.pieces():
        width, style = (2.4, "-") if automatic else (1.6, _BY_HAND)
        line = {"color": path.colour, "linewidth": width, "linestyle": style, "solid_capstyle": "round"}
        axes.plot(p[:, 0], p[:, j], zorder=5, **line)
    starts = path.hand_overs()
    axes.plot(starts[:, 0], starts[:, j], "o", ms=6.5, mfc="white", mec=INK, mew=1.4, zorder=7)
    axes.plot(*path.p[-1, [0, j]], "o", ms=5.5, mfc=path.colour, mec="white", mew=1.0, zorder=6)
    if path.X_WG is not None:
        fork = shapes.box_triangles(shapes.fork_boxes(thickness=0.004), path.X_WG)[..., [0, j]]
        fill(axes, fork, mixed_with_white(path.colour, 0.55), zorder=4)
