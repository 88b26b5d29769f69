"""Simulated depth camera: exact depths from PyBullet's software renderer, then a sensor's errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from optsc.checks import Positive, require
from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import DepthImage, PinholeCamera, Pose, look_at
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel
from optsc.sim import bullet_bodies
from optsc.sim.bullet_arm import BulletArm
from optsc.sim.bullet_client import BulletClient, place_body
from optsc.sim.depth_noise import DepthNoise, measured_depth
from optsc.sim.objects import ObjectModel
from optsc.sim.physics import Physics
from optsc.sim.settings import PhysicsSettings
from optsc.sim.tabletop import Tabletop
from optsc.sim.workspace import comfortable_band

NEAR, FAR = 0.05, 10.0
"""The renderer sees surfaces between these depths [m]."""
NOTHING = -1
"""Label of a pixel without any surface."""

DEFAULT_CAMERA = PinholeCamera.from_field_of_view(640, 480, 0.75)
"""640 x 480 pixels, 43 degrees high: as common depth cameras for tables have it."""


def view_of_table(robot: RobotModel, *, azimuth: float = 0.55, elevation: float = 0.75, distance: float = 0.85) -> Pose:
    """Return X_WC of a camera across the table from the arm that looks at where objects stand.

    Args:
        robot: the arm; the camera looks at the middle of its `comfortable_band`, 6 cm above the table.
        azimuth: of the camera around that point, 0 where it faces the arm [rad].
        elevation: above the horizon [rad].
        distance: from that point [m].

    Raises:
        InvalidValue: a distance that is not above 0, or a camera straight above or below.
    """
    require("distance", distance, Positive)
    band = comfortable_band(robot)
    target = np.array([0.5 * (band.inner + band.outer), 0.0, 0.06])
    level = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    return look_at(target + distance * np.array([*level, np.sin(elevation)]), target)


@dataclass(frozen=True, eq=False)
class CameraView:
    """A depth image of the simulated world with the truth about it, which only serves to judge.

    Attributes:
        image: what the camera measured.
        labels: (H, W) int, index into `names` of what each pixel shows, -1 where there is nothing.
        names: ``table``, ``floor``, ``arm`` and the objects, in the order of the labels.
        true_depth: depth without the sensor's errors (H, W) [m], NaN where there is nothing.
    """

    image: DepthImage
    labels: np.ndarray
    names: tuple[str, ...]
    true_depth: Array

    def pixels_of(self, name: str) -> np.ndarray:
        """Return where the image shows ``name`` (H, W) bool; raise `UnknownName`."""
        if name not in self.names:
            raise UnknownName("label", name, self.names)
        return self.labels == self.names.index(name)


class DepthCamera(BulletClient):
    """A depth camera that stands in a simulated world; a context manager.

    It renders from configurations and poses alone, in a separate simulation, so that it serves any follower
    and changes nothing. Keep one for many images: loading the arm's surfaces takes up to half a second.

    Args:
        world: the arm and the objects.
        X_WC: where the camera stands, see `view_of_table` and `optsc.geometry.look_at`.
        camera: its intrinsics.
        noise: the sensor's errors; `DepthNoise.none()` for exact depths.

    Raises:
        InvalidValue: no single pose.
    """

    _kind = "camera"

    def __init__(
        self,
        world: Tabletop,
        X_WC: Pose | None = None,
        camera: PinholeCamera = DEFAULT_CAMERA,
        noise: DepthNoise | None = None,
    ) -> None:
        self.world, self.camera = world, camera
        self.X_WC = view_of_table(world.robot) if X_WC is None else X_WC
        if self.X_WC.shape != ():
            raise InvalidValue("X_WC", self.X_WC.shape, "a single pose")
        self.noise = DepthNoise() if noise is None else noise
        super().__init__()
        try:
            table = bullet_bodies.add_table(self.client)
            self._arm = BulletArm(self.client, world.robot, PhysicsSettings(), visible=True)
            self._objects = {
                name: (
                    bullet_bodies.add_object(self.client, model, world.X_WO[name], visible=True),
                    bullet_bodies.inertia(model.mesh, model.mass).X_OM,
                )
                for name, model in world.objects.items()
            }
        except BaseException:
            self.close()
            raise
        self.names = ("table", "floor", "arm", *world.objects)
        bodies = [*table, self._arm.body, *(body for body, _ in self._objects.values())]
        self._label_of = np.full(max(bodies) + 2, NOTHING)
        self._label_of[bodies] = np.arange(len(bodies))  # its last entry is what the renderer's -1 finds

    def capture(
        self,
        q: ArrayLike,
        opening: float | None = None,
        X_WO: Mapping[str, Pose] | None = None,
        *,
        rng: np.random.Generator | None = None,
        X_WC: Pose | None = None,
        stamp: float = 0.0,
    ) -> CameraView:
        """Return what the camera sees.

        Args:
            q: the arm's configuration (n,) [rad].
            opening: of the jaws [m]; wide open by default.
            X_WO: poses of objects by name; the others stand where they stood at the start.
            rng: what the sensor's errors are drawn from; without it the depths are exact.
            X_WC: another place of the camera, for this image only.
            stamp: time of the exposure [s].

        Raises:
            InvalidValue: no single configuration.
            UnknownName: a pose for an object that the world does not have.
            Closed: after `close`.
        """
        self._arrange(self.client, q, opening, {**self.world.X_WO, **(X_WO or {})})
        X_WC = self.X_WC if X_WC is None else X_WC
        depth, bodies = rendered(self.client, self.camera, X_WC)
        labels = self._label_of[bodies]
        depth[labels == NOTHING] = np.nan
        seen = depth if rng is None else measured_depth(depth, self.camera, self.noise, rng)
        return CameraView(DepthImage(seen, self.camera, X_WC, stamp), labels, self.names, depth)

    def capture_running(
        self, physics: Physics, *, rng: np.random.Generator | None = None, X_WC: Pose | None = None
    ) -> CameraView:
        """Return what the camera sees of a running simulation, such as a `PyBulletFollower`'s ``physics``.

        Raises:
            UnknownName: it has objects that the camera's world lacks.
            Closed: after `close`.
        """
        q, _ = physics.joints()
        return self.capture(q, physics.opening(), physics.poses(), rng=rng, X_WC=X_WC, stamp=physics.time)

    def unhidden_shares(self, view: CameraView, X_WO: Mapping[str, Pose] | None = None) -> dict[str, float]:
        """Return for each object the share of its silhouette that nothing hides in a view, 0 to 1; to judge with.

        The silhouette is that of the object alone, within the image; 0 for an object outside of it. ``X_WO`` as
        it was given to `capture`. Takes a rendering for each object.
        """
        shares, image = {}, view.image
        for name, X in {**self.world.X_WO, **(X_WO or {})}.items():
            alone = silhouette(self.world.objects[name], X, image.camera, image.X_WC)
            whole = int(alone.sum())
            shares[name] = float((view.pixels_of(name) & alone).sum()) / whole if whole else 0.0
        return shares

    def _arrange(self, client: int, q: ArrayLike, opening: float | None, X_WO: Mapping[str, Pose]) -> None:
        robot = self.world.robot
        if opening is None:
            opening = robot.gripper.max_opening if robot.gripper else 0.0
        configuration = robot.checked(q)
        if configuration.ndim != 1:
            raise InvalidValue("q", configuration.shape, f"a single configuration, shape ({robot.n},)")
        for name in X_WO:
            if name not in self._objects:
                raise UnknownName("object", name, self._objects)
        self._arm.place(configuration.tolist(), [0.0] * len(configuration), opening)
        for name, pose in X_WO.items():
            body, X_OM = self._objects[name]
            place_body(client, body, pose @ X_OM)


def silhouette(model: ObjectModel, X_WO: Pose, camera: PinholeCamera, X_WC: Pose) -> np.ndarray:
    """Return where an object alone would be seen in an image (H, W) bool."""
    with BulletClient() as alone:
        body = bullet_bodies.add_object(alone.client, model, X_WO, visible=True)
        return rendered(alone.client, camera, X_WC)[1] == body


def rendered(client: int, camera: PinholeCamera, X_WC: Pose) -> tuple[Array, np.ndarray]:
    """Return depths along the optical axis (H, W) [m] and PyBullet's numbers of the bodies seen, -1 for none."""
    view = np.diag([1.0, -1.0, -1.0, 1.0]) @ X_WC.inverse().matrix()  # OpenGL looks along -z with y up
    _, _, _, buffer, bodies = pybullet.getCameraImage(
        camera.width,
        camera.height,
        viewMatrix=view.T.ravel().tolist(),
        projectionMatrix=_projection(camera).T.ravel().tolist(),
        shadow=0,
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=client,
    )
    size = (camera.height, camera.width)
    d = np.reshape(buffer, size).astype(float)
    depth = 2.0 * NEAR * FAR / (FAR + NEAR - (2.0 * d - 1.0) * (FAR - NEAR))
    return depth, np.reshape(bodies, size)


def _projection(camera: PinholeCamera) -> Array:
    """Return OpenGL's projection (4, 4) with which the renderer's pixels are exactly those of ``camera``.

    TinyRenderer samples a pixel (u, v) not at its centre, (u + 1/2, v + 1/2) from the image's corner, but at
    (u, v + 1): without this shift depths on slanted surfaces are wrong by about a millimetre.
    """
    width, height = camera.width, camera.height
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2.0 * camera.fx / width
    matrix[0, 2] = 1.0 - 2.0 * camera.cx / width
    matrix[1, 1] = 2.0 * camera.fy / height
    matrix[1, 2] = 2.0 * (camera.cy + 1.0) / height - 1.0
    matrix[2, 2] = -(FAR + NEAR) / (FAR - NEAR)
    matrix[2, 3] = -2.0 * FAR * NEAR / (FAR - NEAR)
    matrix[3, 2] = -1.0
    return matrix
