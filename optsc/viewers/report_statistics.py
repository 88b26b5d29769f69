"""Statistics figures of a report: differences with intervals, Pareto fronts, sensitivities, stability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optsc.geometry.rotation import Array
from optsc.viewers.drawing import new_figure, plain_axes

INK, QUIET, FAINT = "#22272e", "#68707b", "#e4e7eb"
SERIES = ("#e8710a", "#1f6fb4", "#3a8f5c", "#8e5bb0", "#b04a4a", "#6b7a89")
"""Colours of groups; their lightness differs, too, for readers who do not tell red from green."""


@dataclass(frozen=True)
class Estimate:
    """A number with its interval."""

    value: float
    low: float
    high: float


def forest(
    panels: Mapping[str, Mapping[str, Sequence[Estimate]]],
    rows: Sequence[str],
    favourable: Mapping[str, float],
) -> Any:
    """Return a figure of intervals: one panel per measure, one line per row, one colour per group.

    Args:
        panels: by measure, by group, an estimate for each of the rows.
        rows: their names.
        favourable: by measure the sign of a difference in favour of the claim; that side is tinted.
    """
    figure, axes = new_figure(
        1, len(panels), figsize=(1.6 + 2.35 * len(panels), 1.5 + 0.42 * len(rows)), sharey=True, squeeze=False
    )
    for axis, (measure, groups) in zip(axes[0], panels.items(), strict=True):
        step = 0.56 / max(len(groups), 1)
        for k, (group, estimates) in enumerate(groups.items()):
            y = np.arange(len(rows)) + (k - 0.5 * (len(groups) - 1)) * step
            value, low, high = (np.array([getattr(e, n) for e in estimates]) for n in ("value", "low", "high"))
            colour = SERIES[k % len(SERIES)]
            axis.hlines(y, low, high, color=colour, linewidth=2.0, alpha=0.8)
            axis.plot(value, y, "o", color=colour, ms=4.5, label=group)
        left, right = axis.get_xlim()
        left, right = min(left, -0.02 * (right - left)), max(right, 0.02 * (right - left))
        inside = (left, 0.0) if favourable.get(measure, -1.0) < 0 else (0.0, right)
        axis.axvspan(*inside, color="#f1f6ee", zorder=0)
        axis.axvline(0.0, color=QUIET, linewidth=0.9)
        axis.set_xlim(left, right)
        axis.set_title(measure, fontsize=9.5, color=INK)
        plain_axes(axis, labels=QUIET, grid=FAINT)
    axes[0][0].set_yticks(np.arange(len(rows)), rows)
    axes[0][0].set_ylim(len(rows) - 0.5, -0.5)
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(labels), frameon=False, fontsize=9)
    figure.tight_layout(rect=(0.0, 0.06, 1.0, 1.0))
    return figure


@dataclass(frozen=True, eq=False)
class PairedValues:
    """Pairs of one panel: values (N,) of two conditions, and which of them to point out."""

    title: str
    x: Array
    y: Array
    marked: np.ndarray


def paired_scatter(panels: Sequence[PairedValues], x_label: str, y_label: str, marked_label: str) -> Any:
    """Return a figure of pairs about the diagonal; below it the second condition has less."""
    figure, axes = new_figure(1, len(panels), figsize=(4.3 * len(panels), 4.4), squeeze=False)
    for axis, panel in zip(axes[0], panels, strict=True):
        values = np.concatenate([panel.x, panel.y, [0.0]])
        top = 1.05 * float(np.nanmax(values)) or 1.0
        axis.fill_between([0.0, top], [0.0, 0.0], [0.0, top], color="#f1f6ee", zorder=0)
        axis.plot([0.0, top], [0.0, top], color=QUIET, linewidth=0.9)
        plain, marked = ~panel.marked, panel.marked
        axis.plot(panel.x[plain], panel.y[plain], "o", ms=4, mec="none", mfc=SERIES[1], alpha=0.65)
        style = {"ms": 4.5, "mec": "none", "mfc": SERIES[0], "alpha": 0.9}
        axis.plot(panel.x[marked], panel.y[marked], "o", label=marked_label, **style)
        axis.set(xlim=(0.0, top), ylim=(0.0, top), aspect="equal", xlabel=x_label, ylabel=y_label)
        axis.set_title(panel.title, fontsize=10, color=INK)
        if marked.any():
            axis.legend(frameon=False, fontsize=8.5, loc="upper left")
        plain_axes(axis, labels=QUIET, grid=FAINT)
    figure.tight_layout()
    return figure


def front(
    x: ArrayLike,
    y: ArrayLike,
    best: np.ndarray,
    compared: np.ndarray,
    labels: tuple[str, str],
    named: Mapping[str, tuple[float, float]],
) -> Any:
    """Return a figure of trade-offs.

    Args:
        x, y: of every setting (N,).
        best: which of them nothing beats (N,); they are joined.
        compared: which were compared at all (N,); the others are drawn as crosses.
        labels: of the two axes.
        named: places of some settings by name.
    """
    a, b = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    figure, axis = new_figure(figsize=(6.6, 4.6))
    plain = compared & ~best
    axis.plot(a[plain], b[plain], "o", ms=3.5, mec="none", mfc="#b9c2cc", alpha=0.7, label="settings")
    if not compared.all():
        label = "settings that succeed less often"
        axis.plot(a[~compared], b[~compared], "x", ms=3.5, color="#d5b3ad", label=label)
    order = np.argsort(a[best], kind="stable")
    axis.plot(a[best][order], b[best][order], "o-", ms=5, lw=1.2, color=SERIES[0], label="Pareto front")
    for k, (name, (px, py)) in enumerate(named.items()):
        axis.plot(px, py, "D", ms=7, color=SERIES[1 + k % (len(SERIES) - 1)], label=name)
    axis.set(xlabel=labels[0], ylabel=labels[1])
    axis.legend(frameon=False, fontsize=9)
    plain_axes(axis, labels=QUIET, grid=FAINT)
    figure.tight_layout()
    return figure


def sensitivity(columns: Mapping[str, ArrayLike], outcomes: Mapping[str, ArrayLike], bins: int = 8) -> Any:
    """Return a figure of how outcomes depend on each varied number: points, and medians of equal counts of them."""
    shape, size = (len(outcomes), len(columns)), (1.0 + 2.5 * len(columns), 0.6 + 2.1 * len(outcomes))
    figure, axes = new_figure(*shape, figsize=size, squeeze=False, sharex="col", sharey="row")
    for line, (outcome, values) in zip(axes, outcomes.items(), strict=True):
        y = np.asarray(values, dtype=float)
        for axis, settings in zip(line, columns.values(), strict=True):
            x = np.asarray(settings, dtype=float)
            axis.plot(x, y, ".", ms=2.5, color="#b9c2cc", alpha=0.6)
            edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, bins + 1)))
            place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
            used = np.unique(place)
            middles = [float(np.median(x[place == k])) for k in used]
            medians = [float(np.nanmedian(y[place == k])) for k in used]
            axis.plot(middles, medians, "o-", ms=4, lw=1.5, color=SERIES[0])
            plain_axes(axis, labels=QUIET, grid=FAINT)
        line[0].set_ylabel(outcome, fontsize=9)
    for axis, name in zip(axes[-1], columns, strict=True):
        axis.set_xlabel(name, fontsize=9)
    figure.tight_layout()
    return figure


def stability_lines(
    sizes: Sequence[float],
    tau: Mapping[str, Sequence[Estimate]],
    same_choice: Mapping[str, Sequence[float]],
) -> Any:
    """Return a figure of how rankings hold against perturbed weights: Kendall's tau, and the share of equal choices."""
    figure, (left, right) = new_figure(1, 2, figsize=(9.6, 3.8))
    for k, (name, estimates) in enumerate(tau.items()):
        colour = SERIES[k % len(SERIES)]
        low, high = [e.low for e in estimates], [e.high for e in estimates]
        left.fill_between(sizes, low, high, color=colour, alpha=0.13, linewidth=0)
        left.plot(sizes, [e.value for e in estimates], "o-", ms=4, color=colour, label=name)
        right.plot(sizes, same_choice[name], "o-", ms=4, color=colour, label=name)
    left.set(ylabel="Kendall's tau of the 30 best")
    right.set(ylabel="share with the same choice", ylim=(0.0, 1.03))
    for axis in (left, right):
        axis.set(xlabel="perturbation of weights [log]", xscale="log")
        axis.set_xticks(list(sizes), [f"{size:g}" for size in sizes])
        axis.minorticks_off()
        plain_axes(axis, labels=QUIET, grid=FAINT)
    right.legend(frameon=False, fontsize=9, loc="lower left")
    figure.tight_layout()
    return figure


def bars(groups: Mapping[str, Mapping[str, Estimate]], title_of: Mapping[str, str]) -> Any:
    """Return a figure with one panel per measure and one bar with its interval per condition."""
    names = list(next(iter(groups.values())))
    figure, axes = new_figure(
        1, len(groups), figsize=(2.2 + 2.3 * len(groups), 1.3 + 0.34 * len(names)), sharey=True, squeeze=False
    )
    for axis, (measure, estimates) in zip(axes[0], groups.items(), strict=True):
        y = np.arange(len(names))
        value = np.array([estimates[name].value for name in names])
        ends = np.array([[estimates[name].low, estimates[name].high] for name in names])
        axis.barh(y, np.nan_to_num(value), color="#c9d6e3", height=0.62)
        axis.hlines(y, ends[:, 0], ends[:, 1], color=SERIES[1], linewidth=2.0)
        axis.set_title(title_of.get(measure, measure), fontsize=9.5, color=INK)
        plain_axes(axis, labels=QUIET, grid=FAINT)
    axes[0][0].set_yticks(np.arange(len(names)), names)
    axes[0][0].invert_yaxis()
    figure.tight_layout()
    return figure
