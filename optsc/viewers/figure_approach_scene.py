"""3-D panel of the approach figure: objects, the gripper at one moment, the grasp selected for each object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, radians, sin
from typing import Any

import numpy as np

from optsc.geometry import Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.viewers import shapes
from optsc.viewers.drawing import Colour, halo, mixed_with_white

PlacedMeshes = Mapping[str, tuple[TriangleMesh, Pose]]
"""Surface and pose X_WO of each object, by name."""

_GRIPPER = "#7b8591"
_ELEVATION, _AZIMUTH = radians(27.0), radians(-38.0)
_TOWARDS = np.array([cos(_ELEVATION) * cos(_AZIMUTH), cos(_ELEVATION) * sin(_AZIMUTH), sin(_ELEVATION)])
"""From where the panel is seen: from the side and in front, so that the robot's hand comes from the left."""
_RIGHT = np.array([-sin(_AZIMUTH), cos(_AZIMUTH), 0.0])
_UP = np.cross(_TOWARDS, _RIGHT)
_FACET = 0.012
"""Longest side of a drawn triangle [m]: about the thickness of what lies in front of what."""


@dataclass(frozen=True, eq=False)
class SelectedGrasps:
    """Where the tool is at one moment, and which grasp is then selected for each object.

    Attributes:
        title: of its panel.
        X_WT: the tool.
        grasps: selected tool pose X_WG by object name.
    """

    title: str
    X_WT: Pose
    grasps: Mapping[str, Pose]


def scene_box(objects: PlacedMeshes, selections: Sequence[SelectedGrasps], boxes: Array) -> tuple[Array, Array]:
    """Return lower and upper corner (3,) [m] of a box on the table about everything in ``selections``."""
    points = [shapes.mesh_triangles(mesh, X_WO) for mesh, X_WO in objects.values()]
    for selection in selections:
        points.append(shapes.box_triangles(boxes, selection.X_WT))
        points += [shapes.box_triangles(shapes.fork_boxes(), X_WG) for X_WG in selection.grasps.values()]
    everything = np.concatenate(points).reshape(-1, 3)
    # In front, where names and numbers stand, the table is a little larger.
    lower = everything.min(axis=0) - np.array([0.03, 0.05, 0.0])
    upper = everything.max(axis=0) + np.array([0.10, 0.03, 0.01])
    lower[2] = 0.0
    return lower, upper


def draw_scene(
    axes: Any,
    objects: PlacedMeshes,
    colours: Mapping[str, str],
    boxes: Array,
    selection: SelectedGrasps,
    within: tuple[Array, Array],
) -> None:
    """Draw ``selection`` into 3-D ``axes``, with the box ``within`` (see `scene_box`) filling them."""
    from matplotlib.colors import to_rgb

    rgb = {name: to_rgb(colour) for name, colour in colours.items()}
    solids = [
        (shapes.mesh_triangles(*placed), mixed_with_white(colours[name], 0.5)) for name, placed in objects.items()
    ]
    fork = shapes.fork_boxes()
    solids += [(shapes.box_triangles(fork, X_WG), rgb[name]) for name, X_WG in selection.grasps.items()]
    solids.append((shapes.box_triangles(boxes, selection.X_WT), to_rgb(_GRIPPER)))
    _fit(axes, within)
    _draw_table(axes, within)
    _draw_shadows(axes, [triangles for triangles, _ in solids])
    _draw_solids(axes, solids)
    for name, X_WG in selection.grasps.items():
        line = np.stack([selection.X_WT.translation, X_WG.translation])
        axes.plot(*line.T, color=colours[name], linewidth=1.0, linestyle=(0, (1.0, 2.0)), zorder=5)
    for name, (mesh, X_WO) in objects.items():
        _name(axes, name, shapes.mesh_triangles(mesh, X_WO).reshape(-1, 3), colours[name])


def _fit(axes: Any, within: tuple[Array, Array]) -> None:
    lower, upper = within
    axes.computed_zorder = False
    axes.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    axes.set_proj_type("ortho")
    axes.view_init(elev=np.degrees(_ELEVATION), azim=np.degrees(_AZIMUTH))
    axes.set_axis_off()
    size = upper - lower
    axes.set_box_aspect(size)
    # What a panel shows is the box's outline on paper; matplotlib leaves room for a turned box instead.
    from mpl_toolkits.mplot3d import proj3d

    corners = np.array(np.meshgrid(*np.stack([lower, upper], axis=1))).reshape(3, -1)
    axes.apply_aspect()
    x, y, _ = proj3d.proj_transform(*corners, axes.get_proj())
    outline = np.ptp(axes.transData.transform(np.column_stack([x, y])), axis=0)
    axes.set_box_aspect(size, zoom=0.97 * float(np.min(axes.bbox.size / outline)))


def _draw_solids(axes: Any, solids: Sequence[tuple[Array, Colour]]) -> None:
    """Draw everything solid as one collection: only within one are triangles sorted by depth."""
    seen = [(shapes.refined(shapes.facing(triangles, _TOWARDS), _FACET), colour) for triangles, colour in solids]
    colours = np.concatenate([shapes.shaded(triangles, colour) for triangles, colour in seen])
    # Edges in the colour of the face close the hairlines between neighbours.
    _fill_3d(axes, np.concatenate([triangles for triangles, _ in seen]), colours, colours, 0.4, 4)


def _draw_shadows(axes: Any, solids: Sequence[Array]) -> None:
    _fill_3d(axes, shapes.shadow(np.concatenate(solids)), "#d6dae0", "#d6dae0", 0.3, 3)


def _fill_3d(axes: Any, polygons: Any, faces: Any, edges: Any, width: float, zorder: int) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    style = {"facecolors": faces, "edgecolors": edges, "linewidths": width, "zorder": zorder}
    axes.add_collection3d(Poly3DCollection(polygons, **style))


def _draw_table(axes: Any, within: tuple[Array, Array]) -> None:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    (x0, y0, _), (x1, y1, _) = within
    top = [[[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]]]
    _fill_3d(axes, top, "#f3f4f6", "#cfd4da", 0.8, 1)
    along_y = [[[x, y0, 0.0], [x, y1, 0.0]] for x in _tenths(x0, x1)]
    along_x = [[[x0, y, 0.0], [x1, y, 0.0]] for y in _tenths(y0, y1)]
    axes.add_collection3d(Line3DCollection(along_y + along_x, colors="#dfe3e8", linewidths=0.7, zorder=2))
    style = {"color": "#858c96", "fontsize": 8, "ha": "center", "va": "center", "zorder": 3}
    for x in _tenths(x0 + 0.02, x1 - 0.02):
        axes.text(x, y0 - 0.025, 0.0, f"{x:.1f}", **style)
    for y in _tenths(y0 + 0.02, y1 - 0.02):
        axes.text(x1 + 0.025, y, 0.0, f"{y:.1f}", **style)
    axes.text(0.5 * (x0 + x1), y0 - 0.13, 0.0, "x [m]", **style)
    axes.text(x1 + 0.1, 0.5 * (y0 + y1), 0.0, "y [m]", **style)


def _tenths(low: float, high: float) -> Array:
    return np.arange(np.ceil(low * 10.0), np.floor(high * 10.0) + 1.0) / 10.0


def _name(axes: Any, name: str, surface: Array, colour: str) -> None:
    """Write ``name`` below the object, as seen."""
    x, y = 0.5 * (surface.min(axis=0) + surface.max(axis=0))[:2]
    lowest = (surface @ _UP).min() - 0.012
    # The point on the table's plane, in the vertical plane of sight through the object, that is seen there.
    z = (lowest - np.array([x, y, 0.0]) @ _UP) / _UP[2]
    style = {"color": colour, "fontsize": 9.5, "ha": "center", "va": "top", "path_effects": halo()}
    axes.text(x, y, z, name, zorder=6, **style)
