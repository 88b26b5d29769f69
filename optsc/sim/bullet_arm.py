"""An arm with two jaws in PyBullet: joints by name, drives that track, pads that hold, jaws that move alike."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pybullet

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.robot import RobotModel
from optsc.robot.urdf import read_urdf
from optsc.sim.link_inertia import LinkInertia, estimated_inertias, with_inertias
from optsc.sim.settings import PhysicsSettings

WITHOUT_LIMIT = 1000.0
"""Torque [N m] of a joint whose effort limit the description does not state."""


def add_robot(client: int, robot: RobotModel, inertias: Mapping[str, LinkInertia], *, visible: bool = False) -> int:
    """Put an arm with its base frame at W into the simulation ``client`` and return its body.

    Its surfaces are read only if ``visible``: that takes a hundred times as long as all the rest.
    Masses and inertias are the description's own, and where it has none ``inertias``. The order of links is left to
    PyBullet: to keep the file's corrupts memory where the root comes last.
    """
    root = with_inertias(read_urdf(robot.urdf), inertias)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "robot.urdf")
        ElementTree.ElementTree(root).write(path)
        return pybullet.loadURDF(
            str(path),
            basePosition=[0.0, 0.0, 0.0],
            useFixedBase=True,
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE | (0 if visible else pybullet.URDF_IGNORE_VISUAL_SHAPES),
            physicsClientId=client,
        )


class BulletArm:
    """The body of ``robot`` in the simulation ``client``.

    Attributes:
        body: PyBullet's number of it.
        link_names: by link index; the root has -1.
        bolted: indices of the links that no joint moves.
        fingers: indices of the two jaws' links; empty for an arm without a gripper.
        estimated: masses that the description lacks, by link.

    Raises:
        InvalidValue: the description lacks a joint of the arm or of its jaws.
    """

    def __init__(self, client: int, robot: RobotModel, settings: PhysicsSettings, *, visible: bool = False) -> None:
        self._client, self._robot, self._settings = client, robot, settings
        self.estimated = estimated_inertias(robot)
        self.body = add_robot(client, robot, self.estimated, visible=visible)
        self._find_joints()
        self._set_limits()
        if self.fingers:
            prepare_pads(client, self.body, self.fingers, settings.finger_friction, settings.pad_torsion)
            couple(client, self.body, self.fingers)
        self._opening_target = float("nan")

    def _find_joints(self) -> None:
        indices, efforts = {}, {}
        self.link_names, self.bolted = {-1: "base"}, {-1}
        for index in range(pybullet.getNumJoints(self.body, physicsClientId=self._client)):
            info = pybullet.getJointInfo(self.body, index, physicsClientId=self._client)
            indices[info[1].decode()], self.link_names[index] = index, info[12].decode()
            efforts[index] = info[10] if info[10] > 0.0 else WITHOUT_LIMIT
            if info[2] == pybullet.JOINT_FIXED and info[16] in self.bolted:
                self.bolted.add(index)
        fingers = self._robot.gripper.finger_joints if self._robot.gripper else ()
        missing = [name for name in (*self._robot.joint_names, *fingers) if name not in indices]
        if missing:
            raise InvalidValue("joints of arm and jaws", missing, f"in the description: {sorted(indices)}")
        self._joints = [indices[name] for name in self._robot.joint_names]
        self.fingers = [indices[name] for name in fingers]
        self._efforts = [efforts[index] for index in self._joints]
        self._position_gains = [self._settings.position_gain] * len(self._joints)
        self._velocity_gains = [1.0] * len(self._joints)

    def _set_limits(self) -> None:
        arm, limits = {"physicsClientId": self._client}, self._robot.limits
        for i, index in enumerate(self._joints):
            if limits.bounded[i]:  # the model may have other limits than the description
                lower, upper = float(limits.lower[i]), float(limits.upper[i])
                pybullet.changeDynamics(self.body, index, jointLowerLimit=lower, jointUpperLimit=upper, **arm)

    def place(self, q: Sequence[float], v: Sequence[float], opening: float) -> None:
        """Put the joints at ``q`` (n,) [rad] with velocities ``v`` (n,) [rad/s], and the pads ``opening`` [m] apart."""
        for index, value, speed in zip(self._joints, q, v, strict=True):
            pybullet.resetJointState(self.body, index, value, speed, physicsClientId=self._client)
        for index in self.fingers:
            pybullet.resetJointState(self.body, index, 0.5 * opening, 0.0, physicsClientId=self._client)

    def drive(self, q: Sequence[float], v: Sequence[float]) -> None:
        """Set the drives for the next step: ``q`` (n,) [rad] at its start, mean velocity ``v`` (n,) [rad/s].

        Has to be called before every step: a drive that keeps its target trails it by 1 / gain steps.
        """
        pybullet.setJointMotorControlArray(
            self.body,
            self._joints,
            pybullet.POSITION_CONTROL,
            targetPositions=q,
            targetVelocities=v,
            forces=self._efforts,
            positionGains=self._position_gains,
            velocityGains=self._velocity_gains,
            physicsClientId=self._client,
        )

    def move_jaws(self, opening: float) -> None:
        """Let the jaws move towards ``opening`` [m] with the settings' speed and force from now on."""
        if opening == self._opening_target:
            return
        self._opening_target = opening
        settings = self._settings
        drive_jaws(self._client, self.body, self.fingers, opening, settings.jaw_force, 0.5 * settings.jaw_speed)

    def state(self) -> tuple[Array, Array]:
        """Return positions (n,) [rad] and velocities (n,) [rad/s] of the joints."""
        states = pybullet.getJointStates(self.body, self._joints, physicsClientId=self._client)
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    def opening(self) -> float:
        """Return the distance between the pads [m]; 0 for an arm without a gripper."""
        if not self.fingers:
            return 0.0
        states = pybullet.getJointStates(self.body, self.fingers, physicsClientId=self._client)
        return float(sum(s[0] for s in states))


def prepare_pads(client: int, body: int, fingers: Sequence[int], friction: float, torsion: float) -> None:
    """Give the links ``fingers`` of ``body`` the contact properties of rubber pads.

    Args:
        client: PyBullet's number of the simulation.
        body: of the hand or of the arm with its hand.
        fingers: indices of the two jaws' links.
        friction: Coulomb coefficient of the pads [-]; PyBullet multiplies it by the object's.
        torsion: radius [m] at which a pad's friction resists turning about its normal.
    """
    for finger in fingers:
        pybullet.changeDynamics(
            body,
            finger,
            lateralFriction=friction,
            spinningFriction=torsion,
            # Friction of velocities alone lets what is held creep out of the hand, up to 0.1 mm a second.
            frictionAnchor=1,
            physicsClientId=client,
        )


def couple(client: int, body: int, fingers: Sequence[int]) -> None:
    """Make both jaws of ``body`` move alike: otherwise they slide to one side together with what they hold."""
    nowhere = [0.0, 0.0, 0.0]
    gear = pybullet.createConstraint(
        body,
        fingers[0],
        body,
        fingers[1],
        jointType=pybullet.JOINT_GEAR,
        jointAxis=[0.0, 1.0, 0.0],
        parentFramePosition=nowhere,
        childFramePosition=nowhere,
        physicsClientId=client,
    )
    # A soft gear (erp 0.1, 50 N) lets the jaws drift sideways together by 5 mm at 240 Hz.
    pybullet.changeConstraint(gear, gearRatio=-1, erp=1.0, maxForce=1000, physicsClientId=client)


def drive_jaws(client: int, body: int, fingers: Sequence[int], opening: float, force: float, speed: float) -> None:
    """Let the jaws move towards ``opening`` [m] from now on.

    Args:
        client: PyBullet's number of the simulation.
        body: of the hand or of the arm with its hand.
        fingers: indices of the two jaws' links.
        opening: distance between the pads to reach [m].
        force: greatest force of each jaw [N], which it only reaches where ``speed`` is far from being met.
        speed: greatest speed of each jaw [m/s].
    """
    for finger in fingers:
        pybullet.setJointMotorControl2(
            body,
            finger,
            pybullet.POSITION_CONTROL,
            targetPosition=0.5 * opening,
            force=force,
            maxVelocity=speed,
            physicsClientId=client,
        )
