"""The paper's picture: which grasps are chosen from where the hand is, and how the arm gets there.

Drawn with matplotlib's figure objects alone, so that it needs no display and leaves no global state behind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optsc.errors import InvalidValue
from optsc.geometry import Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.viewers.figure_data import BASELINE_COLOUR, PROPOSED_COLOUR, Curve, SelectedGrasps
from optsc.viewers.figure_scene import draw_situation, region
from optsc.viewers.figure_views import INK, draw_legend, draw_views

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["BASELINE_COLOUR", "PROPOSED_COLOUR", "Curve", "SelectedGrasps", "approach_figure", "save_figure"]

OBJECT_COLOURS = ("#3a9d6e", "#8a63b0", "#c04a60", "#8c6d31", "#4aa3a2", "#7a8794")
"""One for each object, apart from those of the two strategies."""

_SCENE, _VIEWS, _HEIGHT, _FOOT = 5.2, 4.7, 5.2, 1.15
"""Width of a scene and of the views, height of the figure and of what stands below the views [inches]."""
_METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    ".svg": {"Date": None, "Creator": None},
}


def approach_figure(
    objects: Mapping[str, tuple[TriangleMesh, Pose]],
    boxes: Array,
    situations: Sequence[SelectedGrasps],
    curves: Sequence[Curve],
    *,
    title: str | None = None,
) -> Figure:
    """Return a figure like the paper's Fig. 1: a 3-D panel for each situation, then the curves in two views.

    Args:
        objects: surface and pose X_WO by name.
        boxes: of the gripper in the tool frame (K, 2, 3): lower and upper corners [m], see `Gripper.boxes`.
        situations: where the tool is and what is selected from there; one or two.
        curves: the ways of the tool, one for each strategy; the first is drawn on top.
        title: above all panels.

    Raises `InvalidValue` when there is nothing to draw in a panel, or a grasp is for an object that is not
    there.
    """
    _check(objects, situations, curves)
    from matplotlib.figure import Figure

    colours = {name: OBJECT_COLOURS[i % len(OBJECT_COLOURS)] for i, name in enumerate(sorted(objects))}
    head = 0.45 if title is None else 0.85
    width = _SCENE * len(situations) + _VIEWS
    figure = Figure(figsize=(width, _HEIGHT + head - 0.45), dpi=150, facecolor="white")
    within = region(objects, situations, boxes)
    panel_height = _HEIGHT - _FOOT - 0.45
    for i, situation in enumerate(situations):
        cell = (_SCENE * i + 0.1, 0.3, _SCENE - 0.25, panel_height + _FOOT - 0.3)
        axes = figure.add_axes(_shares(figure, cell), projection="3d")
        draw_situation(axes, objects, colours, boxes, situation, within)
        _caption(figure, (cell[0] + 0.1, _FOOT + panel_height), i, situation.title)
    left = _SCENE * len(situations) + 0.75
    draw_views(figure, (left, _FOOT, width - left - 0.2, panel_height), objects, colours, curves)
    _caption(figure, (left - 0.5, _FOOT + panel_height), len(situations), "the tool's way to the grasp")
    draw_legend(figure, curves, at=(1.0, 0.0))
    if title is not None:
        figure.text(
            0.5, 1.0 - 0.15 / figure.get_figheight(), title, color=INK, fontsize=13, ha="center", va="top"
        )
    return figure


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write ``figure`` as PNG, PDF or SVG, by the suffix of ``path``; the same figure gives the same bytes.

    Raises `InvalidValue` for another suffix.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _METADATA:
        raise InvalidValue("suffix of the figure's file", suffix, ", ".join(_METADATA))
    from matplotlib import rc_context

    # Without a fixed salt the identifiers inside an SVG are drawn anew each time.
    with rc_context({"svg.hashsalt": "optsc"}):
        figure.savefig(path, metadata=_METADATA[suffix])
    return path


def _check(objects: Mapping[str, Any], situations: Sequence[SelectedGrasps], curves: Sequence[Curve]) -> None:
    counts = (len(objects), len(situations), len(curves))
    if not all(counts):
        raise InvalidValue("objects, situations, curves", counts, "at least one of each")
    for situation in situations:
        if unknown := sorted(set(situation.grasps) - set(objects)):
            raise InvalidValue("object of a selected grasp", unknown, f"one of {', '.join(sorted(objects))}")


def _shares(figure: Figure, inches: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    width, height = figure.get_size_inches()
    return (inches[0] / width, inches[1] / height, inches[2] / width, inches[3] / height)


def _caption(figure: Figure, at: tuple[float, float], index: int, text: str) -> None:
    x, y, _, _ = _shares(figure, (*at, 0.0, 0.0))
    letter = chr(ord("a") + index)
    up = 0.09 / figure.get_figheight()
    figure.text(x, y + up, rf"$\mathbf{{({letter})}}$  {text}", color=INK, fontsize=11, va="bottom")
