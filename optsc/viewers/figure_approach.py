"""The paper's Fig. 1: selected grasps at poses of the hand, and the tool's path under each strategy.

Drawn with matplotlib's figure objects alone, so that it needs no display and leaves no global state behind.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.viewers.drawing import INK
from optsc.viewers.figure_approach_paths import (
    BASELINE_COLOUR,
    PROPOSED_COLOUR,
    StrategyPath,
    draw_legend,
    draw_paths,
)
from optsc.viewers.figure_approach_scene import PlacedMeshes, SelectedGrasps, draw_scene, scene_box

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["BASELINE_COLOUR", "PROPOSED_COLOUR", "SelectedGrasps", "StrategyPath", "approach_figure"]

OBJECT_COLOURS = ("#3a9d6e", "#8a63b0", "#c04a60", "#8c6d31", "#4aa3a2", "#7a8794")
"""One for each object, apart from those of the two strategies."""

_SCENE, _VIEWS, _HEIGHT, _FOOT = 5.2, 4.7, 5.2, 1.15
"""Width of a scene and of the views, height of the figure and of what stands below the views [inches]."""


def approach_figure(
    objects: PlacedMeshes,
    boxes: Array,
    selections: Sequence[SelectedGrasps],
    paths: Sequence[StrategyPath],
    *,
    title: str | None = None,
) -> Figure:
    """Return a figure like the paper's Fig. 1: a 3-D panel for each selection, then the paths in two views.

    Args:
        objects: surface and pose X_WO by name.
        boxes: of the gripper in the tool frame (K, 2, 3): lower and upper corners [m], see `Gripper.boxes`.
        selections: where the tool is and what is selected from there; one or two.
        paths: of the tool, one for each strategy; the first is drawn on top.
        title: above all panels.

    Raises:
        InvalidValue: nothing to draw in a panel, or a grasp of an object that is not there.
    """
    _check(objects, selections, paths)
    from matplotlib.figure import Figure

    colours = {name: OBJECT_COLOURS[i % len(OBJECT_COLOURS)] for i, name in enumerate(sorted(objects))}
    head = 0.45 if title is None else 0.85
    left = _SCENE * len(selections)
    figure = Figure(figsize=(left + _VIEWS, _HEIGHT + head - 0.45), dpi=150, facecolor="white")
    within = scene_box(objects, selections, boxes)
    panel_height = _HEIGHT - _FOOT - 0.45
    for i, selection in enumerate(selections):
        cell = (_SCENE * i + 0.1, 0.3, _SCENE - 0.25, panel_height + _FOOT - 0.3)
        axes = figure.add_axes(_shares(figure, cell), projection="3d")
        draw_scene(axes, objects, colours, boxes, selection, within)
        _caption(figure, (cell[0] + 0.1, _FOOT + panel_height), i, selection.title)
    frame = (left + 0.75, _FOOT, _VIEWS - 0.95, panel_height)
    draw_paths(figure, frame, objects, colours, paths)
    _caption(figure, (left + 0.25, _FOOT + panel_height), len(selections), "the tool's path to the grasp")
    draw_legend(figure, paths, at=(1.0, 0.0))
    if title is not None:
        top = 1.0 - 0.15 / figure.get_figheight()
        figure.text(0.5, top, title, color=INK, fontsize=13, ha="center", va="top")
    return figure


def _check(objects: PlacedMeshes, selections: Sequence[SelectedGrasps], paths: Sequence[StrategyPath]) -> None:
    counts = (len(objects), len(selections), len(paths))
    if not all(counts):
        raise InvalidValue("objects, selections, paths", counts, "at least one of each")
    for selection in selections:
        if unknown := sorted(set(selection.grasps) - set(objects)):
            raise InvalidValue("object of a selected grasp", unknown, f"one of {', '.join(sorted(objects))}")


def _shares(figure: Figure, inches: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    width, height = figure.get_size_inches()
    return (inches[0] / width, inches[1] / height, inches[2] / width, inches[3] / height)


def _caption(figure: Figure, at: tuple[float, float], index: int, text: str) -> None:
    x, y, _, _ = _shares(figure, (*at, 0.0, 0.0))
    letter = chr(ord("a") + index)
    up = 0.09 / figure.get_figheight()
    figure.text(x, y + up, rf"$\mathbf{{({letter})}}$  {text}", color=INK, fontsize=11, va="bottom")
