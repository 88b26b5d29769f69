"""Figure of an object's grasp set: forks around its point cloud, coloured by quality, from the side and from above."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from optsc.errors import InvalidValue
from optsc.geometry import PointCloud
from optsc.geometry.rotation import Array
from optsc.grasps import GraspSet
from optsc.viewers.drawing import draw_quality_scale, plain_axes_3d

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "#24292f"
_MEASURED, _COMPLETED, _FAILED = "#4b5563", "#b9c0c8", "#c04a60"
_FINGER, _STEM = 0.035, 0.035  # [m], of a drawn fork
_VIEWS = (("from the side", 12.0, -60.0, 1.0), ("from above", 89.9, -90.0, 1.25))


def fork_lines(grasps: GraspSet) -> Array:
    """Return the lines of a fork for each grasp in O (N, 6, 3) [m]: jaw, palm, stem and back, one stroke."""
    half = 0.5 * grasps.opening
    zero, one = np.zeros(len(grasps)), np.ones(len(grasps))
    stroke = [
        (half, 0.005 * one),
        (half, -_FINGER * one),
        (zero, -_FINGER * one),
        (zero, -(_FINGER + _STEM) * one),
        (zero, -_FINGER * one),
        (-half, -_FINGER * one),
        (-half, 0.005 * one),
    ]
    points_T = np.stack([np.stack([zero, y, z], axis=-1) for y, z in stroke], axis=1)
    return grasps.X_OG[:, None].apply(points_T)


def grasps_figure(grasps: GraspSet, cloud: PointCloud | None = None, *, title: str | None = None) -> Figure:
    """Return a figure of all grasps of a set in the object's frame, in two views.

    Grasps are coloured by quality; those that were tried and did not hold are dashed in red. Points that were
    measured are dark, those that a template filled in light.

    Raises:
        InvalidValue: neither grasps nor points to draw.
    """
    if len(grasps) == 0 and not cloud:
        raise InvalidValue("grasps and points to draw", 0, "at least one")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 5.6), dpi=150, facecolor="white")
    colours = draw_quality_scale(figure, grasps.quality, (0.925, 0.16, 0.016, 0.58), color=INK)
    lines = fork_lines(grasps)
    corners = np.concatenate([lines.reshape(-1, 3), np.zeros((0, 3)) if cloud is None else cloud.points])
    for column, (caption, elevation, azimuth, zoom) in enumerate(_VIEWS):
        axes: Any = figure.add_axes((0.01 + 0.46 * column, 0.02, 0.43, 0.84), projection="3d")
        axes.view_init(elev=elevation, azim=azimuth)
        _draw_cloud(axes, cloud)
        _draw_forks(axes, grasps, lines, colours.to_rgba(grasps.quality))
        _frame(axes, corners, caption, zoom)
    figure.text(0.02, 0.95, title or _title(grasps), color=INK, fontsize=12)
    return figure


def _title(grasps: GraspSet) -> str:
    text = f"{grasps.object_name}: {len(grasps)} grasps for {grasps.gripper}"
    if grasps.tried is not None:
        text += f", {int(grasps.reliable.sum())} of {int(grasps.tried.sum())} tried held"
    return text


def _draw_cloud(axes: Any, cloud: PointCloud | None) -> None:
    if cloud is None:
        return
    for mask, colour in ((cloud.seen_mask, _MEASURED), (~cloud.seen_mask, _COMPLETED)):
        points = cloud.points[mask]
        axes.scatter(*points.T, s=1.2, color=colour, alpha=0.5, linewidths=0, depthshade=False)


def _draw_forks(axes: Any, grasps: GraspSet, lines: Array, colours: Array) -> None:
    failed = np.zeros(len(grasps), dtype=bool) if grasps.tried is None else grasps.tried & ~grasps.reliable
    for line, colour, bad in zip(lines, colours, failed, strict=True):
        style = {"color": _FAILED, "linestyle": ":"} if bad else {"color": colour}
        axes.plot(*line.T, linewidth=0.7, alpha=0.85, **style)


def _frame(axes: Any, corners: Array, caption: str, zoom: float) -> None:
    from matplotlib.ticker import MaxNLocator

    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    half = 0.5 * float(np.ptp(corners, axis=0).max())
    for set_limits, centre in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, strict=True):
        set_limits(centre - half, centre + half)
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=zoom)
    plain_axes_3d(axes, labels=INK)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(5))
    if zoom > 1.0:  # seen along z
        axes.set_zticks([])
        axes.set_zlabel("")
    axes.set_title(caption, color=INK, fontsize=10, y=1.0)
