"""Picture of a segmentation: measured depth, true labels, and the segments, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from optsc.perception.segments import Segment
from optsc.sim.bullet_bodies import colour
from optsc.sim.camera import CameraView

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TABLE, _FLOOR, _ARM, _NOTHING = (0.93, 0.92, 0.90), (0.80, 0.81, 0.83), (0.55, 0.57, 0.62), (1.0, 1.0, 1.0)
_PREDICTED = "#d1495b"
_SEGMENT_COLOURS = "tab10"


def segmentation_figure(view: CameraView, segments: Sequence[Segment], arm: np.ndarray, predicted: np.ndarray) -> Any:
    """Return a figure of three images: measured depth, the truth, and the segments.

    Args:
        view: what the camera saw, with the truth.
        segments: what was taken for objects.
        arm: pixels that were taken for the arm (H, W) bool.
        predicted: depth of the arm's capsules (H, W) [m], infinite where they are not: their outline is drawn.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 3.7), layout="constrained")
    axes = figure.subplots(1, 3)
    shown = view.image.depth[view.image.measured]
    limits = np.percentile(shown, [1, 90]) if len(shown) else (0.0, 1.0)
    drawn = axes[0].imshow(view.image.depth, cmap="viridis_r", vmin=limits[0], vmax=limits[1])
    figure.colorbar(drawn, ax=axes[0], label="depth [m]", fraction=0.04)
    axes[0].set_title("measured depth, white where nothing was measured", fontsize=9)
    axes[1].imshow(_truth(view))
    axes[1].set_title("truth: table, floor, arm and objects", fontsize=9)
    axes[2].imshow(_found(view, segments, arm))
    axes[2].contour(np.isfinite(predicted), levels=[0.5], colors=_PREDICTED, linewidths=0.8)
    axes[2].set_title(f"{len(segments)} segments; where the arm may be (outline)", fontsize=9)
    for k, segment in enumerate(segments):
        _write(axes[2], segment.pixels, f"{k + 1}")
    for name in view.names[3:]:
        pixels = view.pixels_of(name)
        if pixels.any():
            _write(axes[1], pixels, name)
    for axis in axes:
        axis.set_xticks([])
        axis.set_yticks([])
    return figure


def save_segmentation_figure(
    path: str | Path, view: CameraView, segments: Sequence[Segment], arm: np.ndarray, predicted: np.ndarray
) -> None:
    """Write `segmentation_figure` to a file; its ending says in which format."""
    segmentation_figure(view, segments, arm, predicted).savefig(path, dpi=110)


def _truth(view: CameraView) -> np.ndarray:
    colours = [_TABLE, _FLOOR, _ARM, *(colour(name) for name in view.names[3:]), _NOTHING]
    return np.array(colours)[view.labels]  # -1 is the last


def _found(view: CameraView, segments: Sequence[Segment], arm: np.ndarray) -> np.ndarray:
    from matplotlib import colormaps

    palette = colormaps[_SEGMENT_COLOURS]
    image = np.where(view.image.measured[..., None], _TABLE, _NOTHING)
    image[arm] = _ARM
    for k, segment in enumerate(segments):
        image[segment.pixels] = palette(k % 10)[:3]
    return image


def _write(axis: Axes, pixels: np.ndarray, text: str) -> None:
    """Write into the middle of the pixels, black on white, so that it can be read on every colour."""
    rows, columns = np.nonzero(pixels)
    box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.8, "linewidth": 0.0}
    at = (float(np.median(columns)), float(np.median(rows)))
    axis.text(*at, text, ha="center", va="center", fontsize=7, bbox=box)
