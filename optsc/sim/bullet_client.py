"""A PyBullet simulation as a context manager, and poses of its bodies.

Numbers go into PyBullet as floats and lists: several of its functions crash on numpy arrays.
"""

from __future__ import annotations

import os
import sys
from types import TracebackType
from typing import Self

import numpy as np
import pybullet

from optsc.errors import Closed, InvalidValue
from optsc.geometry import Pose
from optsc.sim.settings import GRAVITY


class BulletClient:
    """A simulation that is separate from all others, with a window if ``gui``; a context manager.

    Raises:
        InvalidValue: a window where there is no display, or more simulations than PyBullet can have at once.
    """

    _kind = "simulation"

    def __init__(self, gui: bool = False) -> None:
        if gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
            # PyBullet would end the process.
            raise InvalidValue("gui", gui, "False where there is no display (DISPLAY is not set)")
        client = pybullet.connect(pybullet.GUI if gui else pybullet.DIRECT)
        if client < 0:
            valid = "at least 0: close simulations that are no longer used"
            raise InvalidValue("PyBullet client", client, valid)
        self._client: int | None = client

    @property
    def client(self) -> int:
        """PyBullet's number of this simulation, for its own functions; raise `Closed` after `close`."""
        if self._client is None:
            raise Closed(self._kind)
        return self._client

    def set_physics(self, time_step: float, solver_iterations: int) -> None:
        """Set gravity, the simulation step [s] and the contact solver's iterations."""
        pybullet.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=self.client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=time_step,
            numSolverIterations=solver_iterations,
            deterministicOverlappingPairs=1,
            physicsClientId=self.client,
        )

    def close(self) -> None:
        """End the simulation; closing again does nothing."""
        if self._client is not None:
            client, self._client = self._client, None
            if pybullet.isConnected(physicsClientId=client):  # the window may have been closed
                pybullet.disconnect(physicsClientId=client)

    def __enter__(self) -> Self:
        _ = self.client
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def bullet_pose(X: Pose) -> tuple[list[float], list[float]]:
    """Return the position and the quaternion (x, y, z, w) that PyBullet takes."""
    return X.translation.tolist(), np.roll(X.quaternion, -1).tolist()


def body_pose(client: int, body: int) -> Pose:
    """Return the pose X_WM of a body's principal frame of mass."""
    position, xyzw = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
    return Pose(np.roll(xyzw, 1), np.array(position))


def place_body(client: int, body: int, X_WM: Pose) -> None:
    """Put a body's principal frame of mass at ``X_WM``.

    PyBullet makes a body at the pose of its frame O but moves it by the pose of its mass.
    """
    position, orientation = bullet_pose(X_WM)
    pybullet.resetBasePositionAndOrientation(body, position, orientation, physicsClientId=client)
