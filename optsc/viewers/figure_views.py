"""The panel of the curves: the tool's way seen from above and from the side, to one scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from optsc.geometry.rotation import Array
from optsc.viewers import shapes
from optsc.viewers.figure_data import Curve
from optsc.viewers.figure_scene import PlacedMeshes, mixed

INK, QUIET = "#2b2f36", "#858c96"
_BY_HAND = (0, (3.0, 1.8))
_REACHED = 0.1
"""How near to an object a curve ends that leads to it [m]."""
_LEAD = 0.12
"""How much of what was driven by hand is surely shown, about the hand-over [m]."""
_GAP = 0.12
"""Between the two views [inches]."""


def draw_views(
    figure: Any,
    frame: tuple[float, float, float, float],
    objects: PlacedMeshes,
    colours: Mapping[str, str],
    curves: Sequence[Curve],
) -> None:
    """Draw the views, one above the other, into ``frame`` (left, bottom, width, height) [inches]."""
    left, bottom, width, height = frame
    lower, upper, scale = _extent(objects, curves, width, height - _GAP)
    side_height = scale * (upper - lower)[2]
    top_height = scale * (upper - lower)[1]
    inches = np.array([*figure.get_size_inches()] * 2)
    side = figure.add_axes(np.array([left, bottom, width, side_height]) / inches)
    top = figure.add_axes(np.array([left, bottom + side_height + _GAP, width, top_height]) / inches)
    for axes, j, name in ((top, 1, "from above"), (side, 2, "from the side")):
        _draw_objects(axes, objects, colours, curves, j)
        for curve in reversed(curves):
            _draw_curve(axes, curve, j)
        axes.set(xlim=(lower[0], upper[0]), ylim=(lower[j], upper[j]))
        axes.set_aspect("equal", adjustable="box")
        axes.text(
            0.985, 0.97, name, transform=axes.transAxes, color=QUIET, fontsize=8.5, ha="right", va="top"
        )
        axes.set_ylabel(f"{'xyz'[j]} [m]", color=INK, fontsize=9)
        _plain(axes)
    top.tick_params(labelbottom=False)
    side.axhline(0.0, color=QUIET, linewidth=1.0, zorder=1)
    side.set_xlabel("x [m]", color=INK, fontsize=9)


def draw_legend(figure: Any, curves: Sequence[Curve], at: tuple[float, float]) -> None:
    """Draw the legend with its lower right corner ``at`` this place of ``figure`` [shares of its size]."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=c.colour, lw=2.4, label=f"{c.label}: {c.automatic_length():.2f} m automatic")
        for c in curves
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
    objects: PlacedMeshes, curves: Sequence[Curve], width: float, height: float
) -> tuple[Array, Array, float]:
    """Return lower and upper corner (3,) [m] of what is shown, filling the panel, and inches per metre.

    Within it are the curves from shortly before the hand-over, their markers, and the objects they lead to.
    """
    points = []
    for curve in curves:
        starts = curve.hand_overs()
        near = np.linalg.norm(curve.p[:, None] - starts, axis=-1).min(axis=1, initial=np.inf) <= _LEAD
        points.append(curve.p[near | curve.automatic] if len(starts) else curve.p)
        if curve.X_WG is not None:
            points.append(shapes.box_triangles(shapes.fork_boxes(), curve.X_WG).reshape(-1, 3))
    for mesh, X_WO in objects.values():
        surface = shapes.mesh_triangles(mesh, X_WO)
        if _is_reached(surface, curves):
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
    axes: Any, objects: PlacedMeshes, colours: Mapping[str, str], curves: Sequence[Curve], j: int
) -> None:
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb
    from matplotlib.patheffects import withStroke

    for name, (mesh, X_WO) in objects.items():
        surface = shapes.mesh_triangles(mesh, X_WO)
        reached = _is_reached(surface, curves)
        colour = mixed(to_rgb(colours[name]), 0.34 if reached else 0.14)
        outline = list(surface[..., [0, j]])
        # Filled triangles of one colour make the exact outline, also of what is hollow or has a handle.
        axes.add_collection(
            PolyCollection(
                outline, facecolors=[colour], edgecolors=[colour], linewidths=0.4, zorder=3 if reached else 2
            )
        )
        low, high = surface.min(axis=(0, 1)), surface.max(axis=(0, 1))
        if j == 1:
            at = (high[0] + 0.006, 0.5 * (low[1] + high[1]))
            axes.text(
                *at,
                name,
                color=colours[name],
                fontsize=8.5,
                va="center",
                zorder=8,
                clip_on=True,
                path_effects=[withStroke(linewidth=2.5, foreground="white")],
            )


def _is_reached(surface: Array, curves: Sequence[Curve]) -> bool:
    points = surface.reshape(-1, 3)
    return bool(min(np.linalg.norm(points - curve.p[-1], axis=1).min() for curve in curves) <= _REACHED)


def _draw_curve(axes: Any, curve: Curve, j: int) -> None:
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    for automatic, p in curve.pieces():
        axes.plot(
            p[:, 0],
            p[:, j],
            color=curve.colour,
            linewidth=2.4 if automatic else 1.6,
            linestyle="-" if automatic else _BY_HAND,
            solid_capstyle="round",
            zorder=5,
        )
    starts = curve.hand_overs()
    axes.plot(starts[:, 0], starts[:, j], "o", ms=6.5, mfc="white", mec=INK, mew=1.4, zorder=7)
    axes.plot(*curve.p[-1, [0, j]], "o", ms=5.5, mfc=curve.colour, mec="white", mew=1.0, zorder=6)
    if curve.X_WG is not None:
        fork = list(shapes.box_triangles(shapes.fork_boxes(thickness=0.004), curve.X_WG)[..., [0, j]])
        colour = mixed(to_rgb(curve.colour), 0.55)
        axes.add_collection(
            PolyCollection(fork, facecolors=[colour], edgecolors=[colour], linewidths=0.4, zorder=4)
        )


def _plain(axes: Any) -> None:
    axes.tick_params(labelsize=8, colors=QUIET, length=2.5)
    axes.grid(color="#eceef1", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.locator_params(steps=[1, 2, 5, 10], nbins=6)
    for spine in axes.spines.values():
        spine.set_color("#cfd4da")
