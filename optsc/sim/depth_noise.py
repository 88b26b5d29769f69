"""Depth sensor noise: errors that grow with depth, lost edges, whole millimetres.

C. V. Nguyen, S. Izadi, D. Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking",
3DIMPVT 2012, measured the standard deviation along the optical axis on a turning plane: quadratic in depth, as
triangulation has it, since z = f b / d makes an error of the disparity d one of z^2 / (f b) times it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from optsc.checks import Above, AtMost, Checked, NonNegative, Share
from optsc.errors import InvalidValue
from optsc.geometry import PinholeCamera
from optsc.geometry.rotation import Array


@dataclass(frozen=True)
class DepthNoise(Checked):
    """Errors of a depth sensor; the defaults are those of a structured-light camera (Nguyen et al. 2012).

    Attributes:
        floor: standard deviation at the depth `best` [m].
        growth: its growth with the square of the distance from `best` [1/m].
        best: depth of least noise [m].
        slant: growth of the standard deviation on slanted surfaces [m^1.5], see `sigma`.
        steepest: no depth is measured where a surface is more slanted to the line of sight than this [rad],
            nor beside a step that is as steep from one pixel to the next: there objects end.
        edge_loss: share of the pixels at such steps that are lost [-]; the rest keep their depth.
        speckle: share of all pixels that are lost anyway [-].
        quantum: depths are whole multiples of this [m]; 0 for no rounding.
        nearest, farthest: no depth is measured outside [m].
    """

    floor: Annotated[float, NonNegative] = 1.2e-3
    growth: Annotated[float, NonNegative] = 1.9e-3
    best: Annotated[float, NonNegative] = 0.4
    slant: Annotated[float, NonNegative] = 1e-4
    steepest: Annotated[float, Above(0.0), AtMost(0.5 * np.pi)] = 1.40
    edge_loss: Annotated[float, Share] = 0.8
    speckle: Annotated[float, Share] = 0.002
    quantum: Annotated[float, NonNegative] = 1e-3
    nearest: Annotated[float, NonNegative] = 0.25
    farthest: Annotated[float, Above(0.0)] = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.farthest > self.nearest:
            raise InvalidValue("DepthNoise.farthest", self.farthest, f"more than nearest, {self.nearest} m")

    @classmethod
    def none(cls) -> DepthNoise:
        """Return the settings of a sensor without errors."""
        return cls(0.0, 0.0, 0.0, 0.0, 0.5 * np.pi, 0.0, 0.0, 0.0, 0.0, float("inf"))

    def sigma(self, depth: Array, angle: Array | float = 0.0) -> Array:
        """Return the standard deviation along the optical axis [m], of the shape of ``depth`` [m].

        floor + growth (z - best)^2 + slant / sqrt(z) * angle^2 / (pi/2 - angle)^2 with the angle [rad] between
        surface and image plane, 0 facing the camera: the model and, by default, the numbers of Nguyen et al.
        """
        angle = np.minimum(angle, 1.5)
        slanted = self.slant / np.sqrt(depth) * (angle / (0.5 * np.pi - angle)) ** 2
        return self.floor + self.growth * (depth - self.best) ** 2 + slanted


def measured_depth(depth: Array, camera: PinholeCamera, noise: DepthNoise, rng: np.random.Generator) -> Array:
    """Return what a sensor measures of exact depths (H, W) [m], NaN where it measures nothing.

    Args:
        depth: along the optical axis [m], NaN where there is no surface.
        camera: of the size of ``depth``.
        noise: the sensor's errors.
        rng: every pixel takes the same share of its numbers whatever the scene.
    """
    normal, uniform = rng.standard_normal(depth.shape), rng.random(depth.shape)
    gentle, steep = _slopes(depth, camera)
    with np.errstate(invalid="ignore"):
        result = depth + noise.sigma(depth, np.arctan(gentle)) * normal
        if noise.quantum > 0.0:
            result = noise.quantum * np.round(result / noise.quantum)
        limit = np.tan(noise.steepest) if noise.steepest < 0.5 * np.pi else np.inf
        lost = (gentle > limit) | ((steep > limit) & (uniform < noise.edge_loss))
        lost |= uniform > 1.0 - noise.speckle
        lost |= ~((result >= noise.nearest) & (result <= noise.farthest) & (result > 0.0))
    return np.where(lost, np.nan, result)


def _slopes(depth: Array, camera: PinholeCamera) -> tuple[Array, Array]:
    """Return tangents of the slant against the image plane: of the surface, and to the farthest neighbour.

    The surface's takes the flatter side in each direction, so that the step at an object's edge is not taken
    for a slanted surface; without neighbours it is 0. A neighbour without a surface is infinitely far.
    """
    filled = np.where(np.isnan(depth), np.inf, depth)
    flat, steep = [], []
    for axis, focal in ((0, camera.fy), (1, camera.fx)):
        rows = np.moveaxis(filled, axis, 0)
        with np.errstate(invalid="ignore"):
            step = np.abs(np.diff(rows, axis=0)) * focal / np.minimum(rows[1:], rows[:-1])
        step = np.where(np.isnan(step), 0.0, step)  # nothing beside nothing
        none = np.zeros((0 if len(step) else 1, step.shape[1]))
        before = np.concatenate([step[:1], step, none])
        after = np.concatenate([step, step[-1:], none])
        flat.append(np.moveaxis(np.minimum(before, after), 0, axis))
        steep.append(np.moveaxis(np.maximum(before, after), 0, axis))
    gentle = np.hypot(*flat)
    return np.where(np.isfinite(gentle), gentle, 0.0), np.maximum(*steep)
