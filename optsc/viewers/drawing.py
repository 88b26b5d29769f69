"""Matplotlib helpers that all pictures share: figures without global state, axes, filled outlines, files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from optsc.errors import InvalidValue

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Colour = tuple[float, float, float]
"""Red, green and blue from 0 to 1."""
INK, QUIET = "#2b2f36", "#858c96"
"""Text, and text in the background."""
_METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    ".svg": {"Date": None, "Creator": None},
}


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write ``figure`` as PNG, PDF or SVG, by the suffix of ``path``; the same figure gives the same bytes.

    Raises:
        InvalidValue: another suffix.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _METADATA:
        raise InvalidValue("suffix of the figure's file", suffix, ", ".join(_METADATA))
    from matplotlib import rc_context

    # Without a fixed salt the identifiers inside an SVG differ each time.
    with rc_context({"svg.hashsalt": "optsc"}):
        figure.savefig(path, metadata=_METADATA[suffix])
    return path


def new_figure(rows: int = 1, columns: int = 1, *, figsize: tuple[float, float], **options: Any) -> tuple[Any, Any]:
    """Return a figure of that size [inches] and its axes, like ``pyplot.subplots`` but without global state."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=figsize)
    return figure, figure.subplots(rows, columns, **options)


def plain_axes(axes: Any, *, labels: str, grid: str) -> None:
    """Give ``axes`` small tick labels, a light frame, and a grid behind what is drawn."""
    axes.tick_params(labelsize=8, colors=labels, length=2.5)
    axes.grid(color=grid, linewidth=0.7)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_color("#cfd4da")


def plain_axes_3d(axes: Any, *, labels: str) -> None:
    """Give 3-D ``axes`` an orthographic view, light panes, and names with units."""
    axes.set_proj_type("ortho")
    for axis, letter in ((axes.xaxis, "x"), (axes.yaxis, "y"), (axes.zaxis, "z")):
        axis.set_pane_color((0.97, 0.97, 0.97, 1.0))
        axis.set_label_text(f"{letter} [m]", color=labels, fontsize=8)
        axis.set_tick_params(labelsize=6)


def mixed_with_white(colour: str, share: float) -> Colour:
    """Return ``share`` of ``colour``, any that matplotlib knows, in white."""
    from matplotlib.colors import to_rgb

    r, g, b = (share * c + (1.0 - share) for c in to_rgb(colour))
    return (r, g, b)


def halo() -> list[Any]:
    """Return path effects that keep text readable on whatever lies behind it."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=2.5, foreground="white")]


def fill(axes: Any, outlines: Any, colour: Any, *, zorder: int) -> None:
    """Fill ``outlines``, each (N, 2); edges of the same colour close the hairlines between neighbours."""
    from matplotlib.collections import PolyCollection

    style: dict[str, Any] = {"facecolors": [colour], "edgecolors": [colour], "linewidths": 0.4}
    axes.add_collection(PolyCollection(list(outlines), zorder=zorder, **style))


def draw_quality_scale(figure: Any, quality: Any, place: tuple[float, float, float, float], **text: Any) -> Any:
    """Draw a colour bar for grasp qualities (N,) at ``place`` of ``figure``; return what maps them to colours."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    low, high = (quality.min(), quality.max()) if len(quality) else (0.0, 1.0)
    colours = ScalarMappable(Normalize(low, max(high, low + 1e-6)), "viridis")
    figure.colorbar(colours, cax=figure.add_axes(place)).set_label("quality of the grasp [-]", **text)
    return colours
