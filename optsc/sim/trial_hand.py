"""The Panda's hand alone, floating: held by a constraint that moves it along given poses."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pybullet

from optsc.errors import DamagedFile
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.robot import PANDA_HAND, urdf
from optsc.sim.bullet_bodies import bullet_pose
from optsc.sim.jaws import couple, drive_jaws, prepare_pads
from optsc.sim.trial_settings import TrialSettings

_HAND, _TOOL = "panda_hand", "panda_hand_tcp"
_PULL = 500.0  # [N], greatest force that moves the floating hand


@cache
def hand_description() -> tuple[Path, Pose]:
    """Return a URDF of the Panda's hand alone, and X_HT of its tool frame T in the hand's link H."""
    path = urdf.example_robot_data("example-robot-data", "robots", "panda_description", "urdf", "panda.urdf")
    root = urdf.with_absolute_meshes(urdf.read_urdf(path), path.parent, urdf.example_robot_data())
    tool = root.find(f"joint[@name='{_TOOL}_joint']/origin")
    if tool is None:
        raise DamagedFile(path, f"has no joint {_TOOL}_joint with an origin")
    X_HT = Pose.from_translation([float(v) for v in tool.get("xyz", "").split()])
    hand = urdf.Element("robot", name=_HAND)
    for element in urdf.subtree(urdf.without(root, "visual"), _HAND):
        if element.get("name") in (_TOOL, f"{_TOOL}_joint"):  # has no mass and nothing to touch
            continue
        # A constraint moves the hand by its centre of mass: put that at the link's origin.
        centre = element.find("inertial/origin") if element.get("name") == _HAND else None
        if centre is not None:
            centre.set("xyz", "0 0 0")
        hand.append(element)
    return urdf.store(hand, "panda-hand"), X_HT


class FloatingHand:
    """The hand in the simulation ``client``, its tool frame at ``X_WT``, its jaws fully open."""

    def __init__(self, client: int, settings: TrialSettings, X_WT: Pose) -> None:
        self._client, self._settings = client, settings
        path, self._X_HT = hand_description()
        position, orientation = bullet_pose(X_WT @ self._X_HT.inverse())
        self.body = pybullet.loadURDF(
            str(path),
            position,
            orientation,
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=client,
        )
        joints = {
            pybullet.getJointInfo(self.body, i, physicsClientId=client)[1].decode(): i
            for i in range(pybullet.getNumJoints(self.body, physicsClientId=client))
        }
        self.fingers = [joints[name] for name in PANDA_HAND.finger_joints]
        for finger in self.fingers:
            pybullet.resetJointState(
                self.body, finger, 0.5 * PANDA_HAND.max_opening, 0.0, physicsClientId=client
            )
        prepare_pads(client, self.body, self.fingers, settings.pad_friction, settings.pad_torsion)
        couple(client, self.body, self.fingers)
        nowhere = [0.0, 0.0, 0.0]
        self._grip = pybullet.createConstraint(
            self.body, -1, -1, -1, pybullet.JOINT_FIXED, nowhere, nowhere, position, physicsClientId=client
        )
        self.hold(X_WT)

    def hold(self, X_WT: Pose) -> None:
        """Pull the hand to a pose from now on."""
        position, orientation = bullet_pose(X_WT @ self._X_HT.inverse())
        pybullet.changeConstraint(
            self._grip, position, orientation, maxForce=_PULL, physicsClientId=self._client
        )

    def follow(self, poses: Pose) -> None:
        """Step the simulation once for each of ``poses`` (S,), the hand pulled to it."""
        X_WH = poses @ self._X_HT.inverse()
        positions, orientations = X_WH.translation.tolist(), np.roll(X_WH.quaternion, -1, axis=-1).tolist()
        for position, orientation in zip(positions, orientations, strict=True):
            pybullet.changeConstraint(
                self._grip, position, orientation, maxForce=_PULL, physicsClientId=self._client
            )
            pybullet.stepSimulation(physicsClientId=self._client)

    def move_jaws(self, opening: float, speed: float) -> None:
        """Let the jaws move towards ``opening`` [m], each at ``speed`` [m/s] at most, from now on."""
        drive_jaws(self._client, self.body, self.fingers, opening, self._settings.jaw_force, speed)

    def jaw_travel(self) -> Array:
        """Return the positions of the two jaws (2,) [m]."""
        states = pybullet.getJointStates(self.body, self.fingers, physicsClientId=self._client)
        return np.array([state[0] for state in states])

    def touches(self, body: int) -> bool:
        """Tell whether both jaws touch ``body``."""
        return all(
            pybullet.getContactPoints(self.body, body, finger, -1, physicsClientId=self._client)
            for finger in self.fingers
        )

    def pose(self) -> Pose:
        """Return X_WH of the hand's link."""
        position, xyzw = pybullet.getBasePositionAndOrientation(self.body, physicsClientId=self._client)
        return Pose(np.roll(xyzw, 1), np.array(position))
