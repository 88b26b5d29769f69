"""Pinhole cameras and depth images as values. C is the camera's frame: z forward, x right, y down."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry.pose import Pose
from optsc.geometry.rotation import Array

LARGEST_SIDE = 8192
"""Most pixels along one side of an image."""


@dataclass(frozen=True)
class PinholeCamera:
    """An ideal camera without distortion; whole pixel coordinates are the centres of pixels.

    Attributes:
        width, height: size of the image in pixels.
        fx, fy: focal lengths in pixels.
        cx, cy: pixel coordinates of the optical axis; (width - 1) / 2 is the middle of the image.

    Raises:
        InvalidValue: a size below 1 or above 8192, or a number that is no focal length or coordinate.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for field in ("width", "height"):
            value = getattr(self, field)
            if not isinstance(value, (int, np.integer)) or not 1 <= value <= LARGEST_SIDE:
                raise InvalidValue(field, value, f"a whole number, 1 to {LARGEST_SIDE} pixels")
            object.__setattr__(self, field, int(value))
        for field in ("fx", "fy"):
            value = float(getattr(self, field))
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidValue(field, value, "finite, more than 0 pixels")
            object.__setattr__(self, field, value)
        for field, size in (("cx", self.width), ("cy", self.height)):
            value = float(getattr(self, field))
            if not -size <= value <= 2 * size:
                raise InvalidValue(field, value, f"pixels, {-size} to {2 * size}, as a rule about {size / 2}")
            object.__setattr__(self, field, value)

    @classmethod
    def from_field_of_view(cls, width: int, height: int, vertical: float) -> PinholeCamera:
        """Return a camera with square pixels whose optical axis is in its middle.

        Args:
            width, height: size of the image in pixels.
            vertical: angle between the upper edge of the image and the lower one [rad].

        Raises:
            InvalidValue: an angle that is not between 0 and pi, or what the constructor says.
        """
        if not 0.0 < vertical < math.pi:
            raise InvalidValue("vertical field of view", vertical, "more than 0, less than pi [rad]")
        focal = 0.5 * height / math.tan(0.5 * vertical)
        return cls(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))

    def project(self, points_C: ArrayLike) -> tuple[Array, Array, Array]:
        """Return pixel coordinates u to the right and v downwards and depth z [m] of points (..., 3) in C.

        u = cx + fx x / z and v = cy + fy y / z; NaN where z <= 0, since such a point is not in front.
        """
        x, y, z = np.moveaxis(np.asarray(points_C, dtype=float), -1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = np.where(z > 0.0, 1.0 / z, np.nan)
        return self.cx + self.fx * x * inverse, self.cy + self.fy * y * inverse, z

    def backproject(self, depth: ArrayLike) -> Array:
        """Return the points in C (H, W, 3) [m] of depths along z (H, W) [m]; NaN stays NaN.

        Raises:
            InvalidValue: depths of another size than the camera's.
        """
        z = np.asarray(depth, dtype=float)
        if z.shape != (self.height, self.width):
            raise InvalidValue("depth", z.shape, f"shape ({self.height}, {self.width})")
        right = (np.arange(self.width) - self.cx) / self.fx
        down = (np.arange(self.height) - self.cy) / self.fy
        return np.stack([right * z, down[:, None] * z, z], axis=-1)

    def rays(self) -> Array:
        """Return the directions of all pixels in C with z = 1 (H, W, 3)."""
        return self.backproject(np.ones((self.height, self.width)))


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Pose:
    """Return X_WC of a camera at ``eye`` (3,) that looks at ``target`` (3,) [m], ``up`` upwards in the image.

    Raises:
        InvalidValue: eye and target coincide, or ``up`` lies along the line of sight.
    """
    e, t, u = (np.asarray(a, dtype=float) for a in (eye, target, up))
    for field, value in (("eye", e), ("target", t), ("up", u)):
        if value.shape != (3,) or not np.isfinite(value).all():
            raise InvalidValue(field, value.tolist(), "finite, shape (3,)")
    forward = t - e
    distance = float(np.linalg.norm(forward))
    if distance < 1e-9:
        raise InvalidValue("target", t.tolist(), "another place than the eye")
    z = forward / distance
    x = np.cross(z, u)
    if np.linalg.norm(x) < 1e-6 * np.linalg.norm(u) or not u.any():
        raise InvalidValue("up", u.tolist(), "not along the line of sight")
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    matrix[:3, 3] = e
    return Pose.from_matrix(matrix)


@dataclass(frozen=True, eq=False)
class DepthImage:
    """What a depth camera measured, with where it stood.

    Attributes:
        depth: distance along the optical axis (H, W) [m], NaN where nothing was measured.
        camera: its intrinsics.
        X_WC: pose of the camera in W.
        stamp: time of the exposure [s].

    Raises:
        InvalidValue: another size than the camera's, a depth that is infinite or not positive, or no single pose.
    """

    depth: Array
    camera: PinholeCamera
    X_WC: Pose
    stamp: float = 0.0

    def __post_init__(self) -> None:
        depth = np.array(self.depth, dtype=float)
        size = (self.camera.height, self.camera.width)
        if depth.shape != size:
            raise InvalidValue("depth", depth.shape, f"shape {size}, the size of the camera's image")
        wrong = ~np.isnan(depth) & ~((depth > 0.0) & (depth < np.inf))
        if wrong.any():
            raise InvalidValue("depth", float(depth[wrong][0]), "more than 0 m and finite; NaN where not measured")
        if self.X_WC.shape != ():
            raise InvalidValue("X_WC", self.X_WC.shape, "a single pose")
        if not math.isfinite(self.stamp):
            raise InvalidValue("stamp", self.stamp, "finite [s]")
        depth.flags.writeable = False
        object.__setattr__(self, "depth", depth)

    @property
    def measured(self) -> np.ndarray:
        """Whether each pixel was measured (H, W) bool."""
        return ~np.isnan(self.depth)

    def points(self) -> Array:
        """Return the points in W (H, W, 3) [m]; NaN rows where nothing was measured."""
        rotation = self.X_WC.rotation_matrix()
        return self.camera.backproject(self.depth) @ rotation.T + self.X_WC.translation
