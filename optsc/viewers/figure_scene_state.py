"""Figure of the scene state after an observation: depth, known objects, completed clouds, grasps."""

from __future__ import annotations

from typing import Any

import numpy as np

from optsc.geometry import DepthImage
from optsc.geometry.rotation import Array
from optsc.perception import KnownObject, SceneState
from optsc.viewers.drawing import draw_quality_scale, plain_axes_3d
from optsc.viewers.figure_grasps import INK, fork_lines

_MEASURED, _COMPLETED, _UNCERTAIN = "#1d6f8a", "#d08a2e", "#c04a60"
_COLOURS = "tab10"


def scene_state_figure(state: SceneState, image: DepthImage) -> Any:
    """Return a figure of four views: measured depth, what is known over it, clouds and grasps in W.

    Args:
        state: what is known after an observation.
        image: that was observed.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.5, 9.4), dpi=110, facecolor="white")
    depth = figure.add_axes((0.01, 0.52, 0.45, 0.44))
    objects = figure.add_axes((0.51, 0.52, 0.45, 0.44))
    _draw_depth(figure, depth, image)
    _draw_objects(objects, state, image)
    for axes in (depth, objects):
        _crop(axes, state, image)
    clouds: Any = figure.add_axes((0.0, 0.0, 0.48, 0.50), projection="3d")
    grasps: Any = figure.add_axes((0.47, 0.0, 0.48, 0.50), projection="3d")
    low, high = _extent(state)
    _frame(clouds, image, low, high, 80.0)  # from the side both what was measured and what was not is seen
    _frame(grasps, image, low, high, 0.0)
    for known in state.objects.values():
        _draw_cloud(clouds, known)
        _draw_cloud(grasps, known, quiet=True)
    _legend(clouds)
    count = _draw_grasps(figure, grasps, state)
    clouds.set_title("points of each object, from beside the camera's view", fontsize=10, color=INK, y=1.0)
    grasps.set_title(f"{count} grasps, coloured by quality", fontsize=10, color=INK, y=1.0)
    return figure


def _draw_depth(figure: Any, axes: Any, image: DepthImage) -> None:
    low, high = _depth_range(image)
    drawn = axes.imshow(image.depth, cmap="viridis_r", vmin=low, vmax=high)
    bar = figure.colorbar(drawn, ax=axes, fraction=0.035, pad=0.015)
    bar.set_label("depth [m]", color=INK, fontsize=9)
    axes.set_title("measured depth, white where nothing was measured", fontsize=10, color=INK)


def _depth_range(image: DepthImage) -> tuple[float, float]:
    """Return the depths [m] between which colours change; single far pixels do not count."""
    shown = image.depth[image.measured]
    low, high = np.percentile(shown, [1, 90]) if len(shown) else (0.0, 1.0)
    return low, high


def _draw_objects(axes: Any, state: SceneState, image: DepthImage) -> None:
    """Draw the silhouettes over a grey depth image, with all of the template as it is placed in each."""
    from matplotlib import colormaps

    low, high = _depth_range(image)
    grey = 0.95 - 0.35 * np.clip((image.depth - low) / max(high - low, 1e-6), 0.0, 1.0)
    picture = np.repeat(np.where(np.isnan(grey), 1.0, grey)[..., None], 3, axis=2)
    placed = []
    for k, known in enumerate(state.objects.values()):
        colour = np.array(colormaps[_COLOURS](k % 10)[:3])
        picture[known.pixels] = 0.45 * picture[known.pixels] + 0.55 * colour
        placed.append((known, colour))
    axes.imshow(picture)
    for known, colour in placed:
        filled = known.cloud.points[~known.cloud.seen_mask]
        u, v, _ = image.camera.project(image.X_WC.inverse().apply(known.X_WO.apply(filled)))
        axes.plot(u, v, ".", markersize=1.2, color=0.6 * colour)
        rows, columns = np.nonzero(known.pixels)
        text = known.name
        if not known.certain and known.template is not None:
            text += f" ({len(known.explanations)} poses)"
        box = {"boxstyle": "round,pad=0.2", "facecolor": "white", "alpha": 0.85, "linewidth": 0.0}
        at = (columns.mean(), rows.max() + 0.02 * image.depth.shape[0])
        axes.text(*at, text, ha="center", va="top", fontsize=8.5, color=INK, bbox=box)
    title = "known objects; dots: what their templates fill in"
    axes.set_title(title, fontsize=10, color=INK)


def _crop(axes: Any, state: SceneState, image: DepthImage) -> None:
    """Show the objects with something around them, in the shape of the image."""
    height, width = image.depth.shape
    shown = np.zeros(image.depth.shape, dtype=bool)
    for known in state.objects.values():
        shown |= known.pixels
    rows, columns = np.nonzero(shown if shown.any() else ~shown)
    half = 0.5 * max(1.5 * np.ptp(columns), 1.7 * np.ptp(rows) * width / height, 0.3 * width)
    half = min(half, 0.5 * width)
    u = np.clip(0.5 * (columns.min() + columns.max()), half, width - half) - 0.5
    v = np.clip(0.5 * (rows.min() + rows.max()), half * height / width, height - half * height / width) - 0.5
    axes.set(xlim=(u - half, u + half), ylim=(v + half * height / width, v - half * height / width))
    axes.set(xticks=[], yticks=[])


def _draw_cloud(axes: Any, known: KnownObject, quiet: bool = False) -> None:
    cloud = known.cloud
    groups = (
        (cloud.points[cloud.seen_mask], _MEASURED),
        (cloud.points[~cloud.seen_mask], _COMPLETED),
        (known.doubtful, _UNCERTAIN),
    )
    for points, colour in groups[:2] if quiet else groups:
        few = points[:: max(1, len(points) // 1500)]
        shown = "#9aa3ad" if quiet else colour
        axes.scatter(*known.X_WO.apply(few).T, s=1.6, color=shown, alpha=0.7, linewidths=0, depthshade=False)


def _draw_grasps(figure: Any, axes: Any, state: SceneState) -> int:
    """Draw every grasp as a fork at its object, and return how many there are."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    sets = [(grasps, state.objects[name]) for name, grasps in state.library.items() if len(grasps)]
    if not sets:
        return 0
    quality = np.concatenate([grasps.quality for grasps, _ in sets])
    colours = draw_quality_scale(figure, quality, (0.935, 0.10, 0.011, 0.26), color=INK, fontsize=9)
    for grasps, known in sets:
        order = np.argsort(grasps.quality)  # the best are drawn last, on top
        lines = known.X_WO.apply(fork_lines(grasps)[order])
        shades = colours.to_rgba(grasps.quality[order])
        axes.add_collection3d(Line3DCollection(lines, colors=shades, linewidths=0.6, alpha=0.9), autolim=False)
    return len(quality)


def _extent(state: SceneState) -> tuple[Array, Array]:
    """Return the corners (3,) [m] of a cube around the objects."""
    points = [known.X_WO.apply(known.cloud.points) for known in state.objects.values()]
    every = np.concatenate([np.zeros((0, 3)), *points]) if points else np.array([[0.5, 0.0, 0.0]])
    low, high = every.min(axis=0), every.max(axis=0)
    middle = 0.5 * (low + high)
    half = max(0.5 * float((high - low)[:2].max()) + 0.04, 0.12)
    return np.array([*(middle[:2] - half), 0.0]), np.array([*(middle[:2] + half), 1.1 * half])


def _frame(axes: Any, image: DepthImage, low: Array, high: Array, turn: float) -> None:
    """Show the box from about the camera's height, turned by ``turn`` [degrees] about the vertical."""
    towards = image.X_WC.translation - 0.5 * (low + high)
    azimuth = np.degrees(np.arctan2(towards[1], towards[0]))
    axes.view_init(elev=32.0, azim=azimuth + turn)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.08)
    plain_axes_3d(axes, labels=INK)
    axes.locator_params(nbins=5)


def _legend(axes: Any) -> None:
    from matplotlib.lines import Line2D

    entries = (
        (_MEASURED, "measured"),
        (_COMPLETED, "filled in by the template"),
        (_UNCERTAIN, "uncertain: kept clear of"),
    )
    handles = [Line2D([], [], color="none", marker="o", ms=5, mfc=c, mec="none", label=t) for c, t in entries]
    style = {"frameon": False, "fontsize": 8, "labelcolor": INK}
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.0, 0.93), **style)
