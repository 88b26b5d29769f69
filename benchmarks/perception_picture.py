"""Pictures of what is registered: the templates over the cloud, compensated clouds, and a handle that is hidden.

python -m benchmarks.perception_picture --seed 3 --output docs/images/registration.png
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.perception import SceneView, seen
from optsc.geometry import DepthImage, Pose
from optsc.perception import (
    RegisteredSegment,
    catalogue_template,
    catalogue_templates,
    complete_cloud,
    register_scene,
    robot_depth,
    robot_mask,
    segment_image,
)
from optsc.robot import load_robot

COLOURS = ("#d95f02", "#1b9e77", "#e7298a", "#66a61e", "#e6ab02", "#7570b3")
SEEN, FILLED = "#2b5c8a", "#e8a33d"


def recognised(seed: int, robot_name: str) -> tuple[SceneView, tuple[RegisteredSegment, ...], np.ndarray]:
    """Return a scene, what was recognised in it, and the depth of the arm."""
    robot = load_robot(robot_name)
    view = seen(robot, seed)
    image = view.view.image
    arm = robot_depth(robot, view.scene.q, image.camera, image.X_WC)
    pieces = segment_image(image, robot_mask=robot_mask(robot, view.scene.q, image)).segments
    found = register_scene(pieces, catalogue_templates(), image, robot_depth=arm, seed=seed)
    return view, found, arm


def shaded(image: DepthImage) -> np.ndarray:
    """Return the image as grey levels (H, W): how much each pixel's surface faces the camera."""
    from scipy.ndimage import uniform_filter

    known = np.where(image.measured, image.depth, 0.0)
    # The mean of those that were measured: single pixels are too noisy to shade.
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = uniform_filter(known, 7) / uniform_filter(image.measured.astype(float), 7)
    points = image.camera.backproject(np.where(image.measured, smooth, np.nan))
    across = np.gradient(points, axis=1)
    down = np.gradient(points, axis=0)
    normal = np.cross(down, across)
    with np.errstate(invalid="ignore", divide="ignore"):
        facing = np.abs(normal[..., 2]) / np.linalg.norm(normal, axis=-1)
    return np.where(np.isnan(facing), 1.0, 0.35 + 0.6 * facing)


def outlines(axes: Any, image: DepthImage, template_name: str, X_WO: Pose, colour: str, **style: Any) -> None:
    """Draw the sharp edges of a template as the camera would see them."""
    template = catalogue_template(template_name)
    mesh, X_CW = template.mesh, image.X_WC.inverse()
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    eye = (X_CW @ X_WO).inverse().translation
    facing = ((eye - corners[:, 0]) * normals).sum(axis=1) > 0.0
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(mesh.faces)), 3)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    pairs = np.flatnonzero(np.all(edges[1:] == edges[:-1], axis=1))
    a, b = owner[pairs], owner[pairs + 1]
    silhouette = facing[a] != facing[b]
    sharp = (normals[a] * normals[b]).sum(axis=1) < np.cos(np.radians(35.0))
    drawn = edges[pairs][silhouette | (sharp & (facing[a] | facing[b]))]
    u, v, _ = image.camera.project((X_CW @ X_WO).apply(mesh.vertices))
    for i, k in drawn:
        axes.plot(u[[i, k]], v[[i, k]], color=colour, solid_capstyle="round", **style)


def overview(axes: Any, view: SceneView, found: tuple[RegisteredSegment, ...]) -> None:
    """Draw all registered templates over the depth image."""
    image = view.view.image
    axes.imshow(shaded(image), cmap="gray", vmin=0.0, vmax=1.0)
    for number, one in enumerate(found):
        result, colour = one.registration, COLOURS[number % len(COLOURS)]
        rows, columns = np.nonzero(one.segment.pixels)
        axes.plot(columns, rows, ",", color=colour, alpha=0.35)
        if result.X_WO is None or result.template is None or result.refusal:
            axes.text(columns.mean(), rows.mean(), "refused", ha="center", fontsize=8)
            continue
        outlines(axes, image, result.template, result.X_WO, colour, linewidth=1.2)
        for other in result.alternatives:
            outlines(axes, image, other.template, other.X_WO, "black", linewidth=0.7, linestyle=(0, (2, 2)))
        doubt = f", {1 + len(result.alternatives)} poses" if result.ambiguous else ""
        note = f"{result.template}{doubt}\n{100 * result.visible_fraction:.0f} % seen"
        box = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.0}
        axes.text(columns.mean(), rows.max() + 6, note, ha="center", va="top", fontsize=8, color=colour, bbox=box)
    rows, columns = np.nonzero(np.any([one.segment.pixels for one in found], axis=0))
    axes.set_xlim(columns.min() - 50, columns.max() + 50)
    axes.set_ylim(rows.max() + 50, rows.min() - 40)
    axes.set_axis_off()


def compensated(axes: Any, view: SceneView, one: RegisteredSegment, arm: np.ndarray) -> None:
    """Draw the compensated cloud of one object in its own frame, seen from behind the camera's back."""
    result = one.registration
    template = catalogue_template(str(result.template))
    X_WO, image = result.X_WO, view.view.image
    if X_WO is None:
        return
    others = [other.X_WO for other in result.alternatives if other.template == template.name]
    cloud = complete_cloud(one.segment.cloud, template, X_WO, image=image, robot_depth=arm, alternatives=others)
    points = 1e3 * X_WO.apply(cloud.points)
    mask = cloud.seen_mask
    axes.scatter(*points[mask][::3].T, s=1.0, color=SEEN, depthshade=False)
    axes.scatter(*points[~mask].T, s=2.5, color=FILLED, depthshade=False)
    sight = X_WO.translation - image.X_WC.translation
    axes.view_init(elev=22, azim=float(np.degrees(np.arctan2(-sight[1], -sight[0]))) + 75)
    axes.set_box_aspect(np.ptp(points, axis=0))
    axes.set_axis_off()
    axes.set_title(f"{template.name}: {mask.sum()} seen, {(~mask).sum()} filled in", fontsize=9, y=0.98)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--output", type=Path, required=True)
    given = parser.parse_args(arguments)
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    view, found, arm = recognised(given.seed, given.robot)
    good = [one for one in found if one.registration.X_WO is not None and not one.registration.refusal]
    figure = plt.figure(figsize=(12.5, 5.6))
    grid = figure.add_gridspec(2, 3, width_ratios=[2.2, 1.0, 1.0], wspace=0.02, hspace=0.05)
    overview(figure.add_subplot(grid[:, 0]), view, found)
    for place, one in enumerate(good[:4]):
        compensated(figure.add_subplot(grid[place // 2, 1 + place % 2], projection="3d"), view, one, arm)
    figure.text(0.66, 0.06, "seen", color=SEEN, fontsize=10, weight="bold")
    figure.text(0.71, 0.06, "filled in from the template", color=FILLED, fontsize=10, weight="bold")
    figure.savefig(given.output, dpi=110, bbox_inches="tight", facecolor="white")
    return 0


if __name__ == "__main__":
    sys.exit(main())
