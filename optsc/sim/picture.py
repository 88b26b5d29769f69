"""Pictures of a tabletop world from postures and poses alone, so that any follower can be looked at."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np
import pybullet
from numpy.typing import ArrayLike, NDArray

from optsc.errors import Closed, InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel
from optsc.sim import bullet_bodies
from optsc.sim.bullet_arm import Arm
from optsc.sim.settings import PhysicsSettings
from optsc.sim.tabletop import Tabletop

Image = NDArray[np.uint8]

_NEAR, _FAR = 0.05, 10.0  # [m]
_ARM_COLOUR, _HAND_COLOUR = (0.93, 0.93, 0.94), (0.42, 0.44, 0.48)
_BACKDROP = np.array([[196.0, 208.0, 220.0], [240.0, 243.0, 246.0]])  # top and bottom, RGB


@dataclass(frozen=True)
class Viewpoint:
    """Where a picture is taken from.

    Attributes:
        eye, target: positions in W [m]; the line between them is the optical axis, z is up in the picture.
        field_of_view: vertical opening angle [rad].
    """

    eye: tuple[float, float, float] = (1.60, -1.00, 0.95)
    target: tuple[float, float, float] = (0.28, 0.02, 0.29)
    field_of_view: float = 0.66


class Renderer:
    """Draws a world in software, without a window; a context manager.

    Args:
        world: the arm and the objects.

    Loading the arm's surfaces takes up to half a second, so keep one for many pictures.
    """

    def __init__(self, world: Tabletop) -> None:
        self.world = world
        self._client: int | None = bullet_bodies.connect()
        try:
            bullet_bodies.add_table(self._client, floor=False)
            self._arm = Arm(self._client, world.robot, PhysicsSettings(), visible=True)
            self._arm.paint(_ARM_COLOUR, _HAND_COLOUR)
            self._objects = {
                name: (
                    bullet_bodies.add_object(self._client, model, world.X_WO[name], visible=True),
                    bullet_bodies.inertia(model.mesh, model.mass).X_OM,
                )
                for name, model in world.objects.items()
            }
        except BaseException:
            self.close()
            raise

    def picture(
        self,
        q: ArrayLike,
        opening: float | None = None,
        X_WO: Mapping[str, Pose] | None = None,
        *,
        viewpoint: Viewpoint | None = None,
        width: int = 1280,
        height: int = 960,
        samples: int = 2,
    ) -> Image:
        """Return a picture (height, width, 3), RGB.

        Args:
            q: the arm's posture (n,) [rad].
            opening: of the jaws [m]; wide open by default.
            X_WO: poses of the objects by name; the others stand where they stood at the start.
            viewpoint: where the picture is taken from.
            width, height: size of the picture.
            samples: along each side of a pixel; more than one smoothes edges and takes longer, by its square.

        Raises:
            InvalidValue: a posture, size or number of samples that is none.
            UnknownName: a pose for an object that the world does not have.
            Closed: after `close`.
        """
        if self._client is None:
            raise Closed("renderer")
        for field, value in (("width", width), ("height", height), ("samples", samples)):
            if value < 1 or value * samples > 8192:
                raise InvalidValue(field, value, "at least 1, and at most 8192 with all samples")
        self._arrange(self.world.robot, q, opening, {**self.world.X_WO, **(X_WO or {})})
        rows, columns = height * samples, width * samples
        pixels = self._render(self._client, viewpoint or Viewpoint(), columns, rows)
        blocks = pixels.reshape(height, samples, width, samples, 3)
        return np.round(blocks.mean(axis=(1, 3))).astype(np.uint8)

    def _arrange(
        self, robot: RobotModel, q: ArrayLike, opening: float | None, X_WO: Mapping[str, Pose]
    ) -> None:
        if opening is None:
            opening = robot.gripper.max_opening if robot.gripper else 0.0
        self._arm.place(robot.checked(q).tolist(), opening)
        for name, pose in X_WO.items():
            if name not in self._objects:
                raise UnknownName("object", name, self._objects)
            body, X_OM = self._objects[name]
            # PyBullet makes a body at the pose of its frame but moves it by the pose of its mass.
            position, orientation = bullet_bodies.bullet_pose(pose @ X_OM)
            pybullet.resetBasePositionAndOrientation(
                body, position, orientation, physicsClientId=self._client
            )

    @staticmethod
    def _render(client: int, viewpoint: Viewpoint, width: int, height: int) -> Array:
        view = pybullet.computeViewMatrix(list(viewpoint.eye), list(viewpoint.target), [0.0, 0.0, 1.0])
        degrees = float(np.degrees(viewpoint.field_of_view))
        projection = pybullet.computeProjectionMatrixFOV(degrees, width / height, _NEAR, _FAR)
        image = pybullet.getCameraImage(
            width,
            height,
            viewMatrix=view,
            projectionMatrix=projection,
            lightDirection=[0.8, -0.9, 2.2],
            lightDistance=3.0,
            lightColor=[1.0, 1.0, 1.0],
            lightAmbientCoeff=0.62,
            lightDiffuseCoeff=0.42,
            lightSpecularCoeff=0.12,
            shadow=1,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=client,
        )
        colours = np.reshape(image[2], (height, width, 4))[..., :3].astype(float)
        nothing = np.reshape(image[3], (height, width)) > 0.9999
        down = np.linspace(0.0, 1.0, height)[:, None]
        backdrop = (1.0 - down) * _BACKDROP[0] + down * _BACKDROP[1]
        return np.where(nothing[..., None], backdrop[:, None], colours)

    def close(self) -> None:
        """Free what was loaded; closing again does nothing."""
        if self._client is not None:
            client, self._client = self._client, None
            pybullet.disconnect(physicsClientId=client)

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def save_png(path: str | Path, image: Image) -> None:
    """Write an RGB picture (height, width, 3) as a PNG file; raise `InvalidValue` if it is none."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
        raise InvalidValue("image", f"{image.dtype}{image.shape}", "uint8, shape (height, width, 3)")
    height, width, _ = image.shape
    rows = np.insert(image.reshape(height, -1), 0, 0, axis=1)  # every row begins with its filter: none

    def chunk(kind: bytes, content: bytes) -> bytes:
        check = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)  # 8 bits, RGB
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)) + chunk(b"IEND", b"")
    Path(path).write_bytes(b"\x89PNG\r\n\x1a\n" + body)
