"""Figure of a ranking: a row for each candidate, its costs as colours, grouped by what removed it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from optsc.errors import InvalidValue
from optsc.selection import CandidateRow, Ranking
from optsc.viewers.drawing import INK, QUIET

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLUMN, _WORDS, _MARGIN, _HEIGHT = 0.55, 1.75, 0.35, 5.6
"""Width of a cost's column, of the words beside an object, of the margins, height of the figure [inches]."""
_TOP, _BOTTOM = 0.62, 1.25
_FILTERED = "#e4e6ea"
_LEAST_GAP = 0.035
"""Between two labels, as a share of the height of the panel."""


def ranking_figure(ranking: Ranking, *, title: str | None = None) -> Figure:
    """Return a figure with a panel for each object: its candidates from best to worst, its costs from good to bad.

    Colours go from the least to the greatest cost of a term among all admissible candidates. Lines between
    candidates part those that different stages left behind; candidates that a filter removed are grey.

    Raises:
        InvalidValue: the ranking is empty.
    """
    rows = ranking.rows()
    if not rows:
        raise InvalidValue("ranking", f"empty: {ranking.reason}", "a ranking of at least one candidate")
    from matplotlib.figure import Figure

    terms = tuple(dict.fromkeys(rows[0].costs))
    ranges = [_range([row.costs[term] for row in rows if row.rank is not None]) for term in terms]
    objects = [tuple(group) for _, group in groupby(rows, key=lambda row: row.object_name)]
    panel = _COLUMN * len(terms)
    width = 2 * _MARGIN + len(objects) * (panel + _WORDS) + (len(objects) - 1) * _MARGIN
    figure = Figure(figsize=(width, _HEIGHT), dpi=150, facecolor="white")
    for k, group in enumerate(objects):
        left = _MARGIN + k * (panel + _WORDS + _MARGIN)
        box = (left / width, _BOTTOM / _HEIGHT, panel / width, 1.0 - (_TOP + _BOTTOM) / _HEIGHT)
        _draw_object(figure.add_axes(box), group, terms, ranges, intended=group[0].object_name == ranking.best)
    _draw_scale(figure, width)
    if title is not None:
        figure.text(0.5, 0.985, title, color=INK, fontsize=11, ha="center", va="top")
    return figure


def _range(values: Sequence[float]) -> tuple[float, float]:
    return (min(values), max(values)) if values else (0.0, 1.0)


def _draw_object(
    axes: Any,
    rows: Sequence[CandidateRow],
    terms: Sequence[str],
    ranges: Sequence[tuple[float, float]],
    intended: bool,
) -> None:
    shades = np.full((len(rows), len(terms)), np.nan)
    for i, row in enumerate(rows):
        if row.rank is not None:
            shades[i] = [
                (row.costs[term] - low) / (high - low) if high > low else 0.0
                for term, (low, high) in zip(terms, ranges, strict=True)
            ]
    axes.set_facecolor(_FILTERED)
    axes.imshow(
        np.ma.masked_invalid(shades),
        aspect="auto",
        cmap="viridis_r",
        vmin=0.0,
        vmax=1.0,
        interpolation="nearest",
    )
    axes.set_xticks(range(len(terms)), [term.removesuffix(" [-]") for term in terms], rotation=35, ha="right")
    axes.set_yticks([])
    axes.tick_params(axis="x", labelsize=7.5, colors=INK, length=2)
    for side in axes.spines.values():
        side.set_visible(False)
    for column in range(1, len(terms)):
        axes.axvline(column - 0.5, color="white", linewidth=2.0)
    _draw_groups(axes, rows)
    name = rows[0].object_name
    axes.set_title(f"{name} (pointed at)" if intended else name, color=INK, fontsize=10, loc="left")


def _draw_groups(axes: Any, rows: Sequence[CandidateRow]) -> None:
    """Part the candidates by what removed them, and say what that was and of how many."""
    count, start, free = len(rows), 0, -1.0
    for reason, group in groupby(_grouped(rows), key=lambda row: row.removed_by):
        members = tuple(group)
        if start:
            axes.axhline(start - 0.5, color="white", linewidth=1.5)
        middle = (start + 0.5 * len(members)) / count
        at = max(middle, free)
        words = f"grasp {members[0].grasp_index} chosen" if not reason else f"{len(members)}  {reason}"
        axes.annotate(
            words,
            xy=(1.0, 1.0 - middle),
            xytext=(1.08, 1.0 - at),
            xycoords="axes fraction",
            textcoords="axes fraction",
            color=INK if not reason else QUIET,
            fontsize=8,
            fontweight="bold" if not reason else "normal",
            va="center",
            arrowprops={"arrowstyle": "-", "color": QUIET, "linewidth": 0.6, "shrinkA": 1, "shrinkB": 0},
        )
        free = at + _LEAST_GAP
        start += len(members)


def _grouped(rows: Sequence[CandidateRow]) -> list[CandidateRow]:
    """Return the admissible rows as they are, then the filtered ones reason by reason."""
    admissible = [row for row in rows if row.rank is not None]
    filtered = [row for row in rows if row.rank is None]
    return [*admissible, *sorted(filtered, key=lambda row: row.removed_by)]


def _draw_scale(figure: Any, width: float) -> None:
    axes = figure.add_axes((_MARGIN / width, 0.3 / _HEIGHT, 1.3 / width, 0.09 / _HEIGHT))
    axes.imshow(np.linspace(0.0, 1.0, 64)[None], aspect="auto", cmap="viridis_r")
    axes.set_axis_off()
    figure.text(
        (_MARGIN + 1.4) / width,
        0.345 / _HEIGHT,
        "low to high cost;  grey: removed by a filter",
        color=QUIET,
        fontsize=7.5,
        va="center",
    )
