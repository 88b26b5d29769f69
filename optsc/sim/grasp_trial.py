"""Trying grasps physically: a floating hand comes in, closes, lifts and shakes an object on a plane.

What is found out here is how reliable grasps are as such; whether an arm reaches them is another question.
The criterion, 20 mm and 0.2 rad between hand and object, separates held from lost objects in published
trials (C. Eppner, A. Mousavian, D. Fox, "ACRONYM", 2021).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pybullet

from optsc.errors import DamagedFile, InvalidValue, Mismatch
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.grasps import GraspSet
from optsc.robot import PANDA_HAND, urdf
from optsc.sim.bullet_bodies import add_object, bullet_pose
from optsc.sim.objects import ObjectModel

_HAND, _TOOL = "panda_hand", "panda_hand_tcp"
_AWAY = Pose.from_translation([0.0, 0.0, 2.0])
_SETTLE, _PAUSE = 0.5, 0.25  # [s]
_SQUEEZE = (
    1.0  # [m/s]; PyBullet's motors reach their force only where the speed asked for is far from being met
)
_PULL = 500.0  # [N], greatest force that moves the floating hand


@dataclass(frozen=True)
class TrialSettings:
    """How a trial is done and what counts as holding.

    Attributes:
        time_step: simulation step [s].
        solver_iterations: of the contact solver; with 50 an object slips that holds with 150 and at 1 kHz.
        standoff: length of the straight approach [m].
        speed: of approach and lift [m/s].
        jaw_force: greatest force of each jaw [N].
        jaw_speed: of each jaw [m/s].
        pad_torsion: radius [m] at which a pad's friction resists turning about its normal; for an evenly
            loaded disc of radius r it is 2 r / 3, and a Panda's pad has the area of a disc of 10 mm.
        lift: [m].
        shake: way from one end to the other [m], along x, y and z in turn.
        shake_frequency: [Hz].
        max_slip: of the object in the hand [m].
        max_slip_angle: of the object in the hand [rad].
    """

    time_step: float = 1.0 / 240.0
    solver_iterations: int = 150
    standoff: float = 0.10
    speed: float = 0.25
    jaw_force: float = 40.0
    jaw_speed: float = 0.05
    pad_torsion: float = 0.005
    lift: float = 0.15
    shake: float = 0.06
    shake_frequency: float = 2.0
    max_slip: float = 0.02
    max_slip_angle: float = 0.2

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 < value < float("inf"):
                raise InvalidValue(f"TrialSettings.{field.name}", value, "finite, above 0")


class TrialOutcome(NamedTuple):
    """What happened to each of N grasps."""

    lifted: np.ndarray
    """(N,) bool: at the end in contact with both pads, up, and not slipped by more than allowed."""
    moved_before_closing: Array
    """Way of the object's origin during the approach (N,) [m]: a lot means that the hand bumped it."""
    moved_by_closing: Array
    """Way of the object's origin while the jaws closed (N,) [m]."""
    slip: Array
    """Way of the object's centre of mass in the hand between closing and the end (N,) [m]."""
    slip_angle: Array
    """Turn of the object in the hand between closing and the end (N,) [rad]."""


def try_grasps(
    model: ObjectModel,
    grasps: GraspSet,
    settings: TrialSettings | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> TrialOutcome:
    """Return what happens when a floating Panda hand tries each grasp on the object, upright on a plane.

    Every trial starts from the same state, so the outcome of a grasp does not depend on the others.
    Raises `Mismatch` if the grasps were made for another object or another gripper.
    """
    if grasps.gripper != PANDA_HAND.name:
        raise Mismatch("grasp trial", PANDA_HAND.name, grasps.gripper)
    if grasps.object_hash != model.mesh.hash:
        raise Mismatch(f"grasp set of {grasps.object_name}", grasps.object_hash[:12], model.mesh.hash[:12])
    rows = []
    with _Bench(model, settings or TrialSettings()) as bench:
        for done, X_OG in enumerate(grasps.X_OG, start=1):
            rows.append(bench.trial(X_OG))
            if progress is not None:
                progress(model.name, done, len(grasps))
    columns = np.array(rows, dtype=float).reshape(-1, 5).T
    return TrialOutcome(columns[0].astype(bool), *columns[1:])


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


class _Bench:
    """A simulation of its own with a plane, the object and the hand; closed by leaving the ``with`` block."""

    def __init__(self, model: ObjectModel, settings: TrialSettings) -> None:
        self._model, self._settings, self._cleanup = model, settings, ExitStack()

    def __enter__(self) -> _Bench:
        self._client = pybullet.connect(pybullet.DIRECT)
        self._cleanup.callback(pybullet.disconnect, self._client)
        settings, client = self._settings, {"physicsClientId": self._client}
        pybullet.setGravity(0.0, 0.0, -9.81, **client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=settings.time_step,
            numSolverIterations=settings.solver_iterations,
            deterministicOverlappingPairs=1,
            **client,
        )
        plane = pybullet.createMultiBody(
            0.0, pybullet.createCollisionShape(pybullet.GEOM_PLANE, **client), **client
        )
        # PyBullet multiplies the coefficients of two bodies: one leaves the object's own in force.
        pybullet.changeDynamics(plane, -1, lateralFriction=1.0, **client)
        self._object = add_object(self._client, self._model, Pose.identity())
        self._add_hand(client)
        self._hold(_AWAY)
        for _ in range(round(_SETTLE / settings.time_step)):
            pybullet.stepSimulation(**client)
        self._start = pybullet.saveState(**client)
        self._X_WB_start = self._body_pose()
        return self

    def __exit__(self, *_: object) -> None:
        self._cleanup.close()

    def trial(self, X_OG: Pose) -> tuple[bool, float, float, float, float]:
        """Carry out one grasp from the settled state; return the fields of `TrialOutcome`."""
        settings = self._settings
        X_WG = X_OG  # the object's frame stands on the plane's origin
        back = X_WG @ Pose.from_translation([0.0, 0.0, -settings.standoff])
        pybullet.restoreState(self._start, physicsClientId=self._client)
        self._teleport(back)
        self._jaws(PANDA_HAND.max_opening)
        self._move(back, X_WG, settings.standoff / settings.speed)
        before = self._body_pose()
        self._jaws(0.0)
        self._wait(X_WG, 0.5 * PANDA_HAND.max_opening / settings.jaw_speed)
        self._jaws(0.0, _SQUEEZE)
        self._wait(X_WG, _PAUSE)
        closed, held = self._body_pose(), self._in_hand()
        up = Pose(X_WG.quaternion, X_WG.translation + np.array([0.0, 0.0, settings.lift]))
        self._move(X_WG, up, settings.lift / settings.speed)
        self._shake(up)
        end = self._in_hand()
        slip = float(np.linalg.norm(end.translation - held.translation))
        slip_angle = float(rotation.angle(end.quaternion, held.quaternion))
        risen = self._body_pose().translation[2] - self._X_WB_start.translation[2]
        lifted = self._touching() and risen > 0.66 * settings.lift
        lifted &= slip <= settings.max_slip and slip_angle <= settings.max_slip_angle
        return lifted, _way(self._X_WB_start, before), _way(before, closed), slip, slip_angle

    def _add_hand(self, client: dict[str, int]) -> None:
        path, self._X_HT = hand_description()
        self._hand = pybullet.loadURDF(
            str(path), *bullet_pose(_AWAY), flags=pybullet.URDF_USE_INERTIA_FROM_FILE, **client
        )
        joints = {
            pybullet.getJointInfo(self._hand, i, **client)[1].decode(): i
            for i in range(pybullet.getNumJoints(self._hand, **client))
        }
        self._fingers = [joints[name] for name in PANDA_HAND.finger_joints]
        for finger in self._fingers:
            pybullet.changeDynamics(
                self._hand, finger, lateralFriction=1.0, spinningFriction=self._settings.pad_torsion, **client
            )
        nowhere = [0.0, 0.0, 0.0]
        # The hand's jaws are coupled. A soft gear (erp 0.1) lets them drift sideways together by 5 mm.
        gear = pybullet.createConstraint(
            self._hand, self._fingers[0], self._hand, self._fingers[1],
            pybullet.JOINT_GEAR, [0.0, 1.0, 0.0], nowhere, nowhere, **client,
        )  # fmt: skip
        pybullet.changeConstraint(gear, gearRatio=-1, erp=1.0, maxForce=1000, **client)
        self._grip = pybullet.createConstraint(
            self._hand, -1, -1, -1, pybullet.JOINT_FIXED, nowhere, nowhere, bullet_pose(_AWAY)[0], **client
        )

    def _hold(self, X_WT: Pose) -> None:
        position, orientation = bullet_pose(X_WT @ self._X_HT.inverse())
        pybullet.changeConstraint(
            self._grip, position, orientation, maxForce=_PULL, physicsClientId=self._client
        )

    def _teleport(self, X_WT: Pose) -> None:
        pose = bullet_pose(X_WT @ self._X_HT.inverse())
        pybullet.resetBasePositionAndOrientation(self._hand, *pose, physicsClientId=self._client)
        for finger in self._fingers:
            pybullet.resetJointState(
                self._hand, finger, 0.5 * PANDA_HAND.max_opening, 0.0, physicsClientId=self._client
            )
        self._hold(X_WT)

    def _jaws(self, opening: float, speed: float | None = None) -> None:
        for finger in self._fingers:
            pybullet.setJointMotorControl2(
                self._hand,
                finger,
                pybullet.POSITION_CONTROL,
                targetPosition=0.5 * opening,
                force=self._settings.jaw_force,
                maxVelocity=speed or self._settings.jaw_speed,
                physicsClientId=self._client,
            )

    def _follow(self, poses: Pose) -> None:
        X_WH = poses @ self._X_HT.inverse()
        positions, orientations = X_WH.translation.tolist(), np.roll(X_WH.quaternion, -1, axis=-1).tolist()
        for position, orientation in zip(positions, orientations, strict=True):
            pybullet.changeConstraint(
                self._grip, position, orientation, maxForce=_PULL, physicsClientId=self._client
            )
            pybullet.stepSimulation(physicsClientId=self._client)

    def _steps(self, duration: float) -> Array:
        count = max(1, round(duration / self._settings.time_step))
        return np.arange(1, count + 1) / count

    def _move(self, start: Pose, end: Pose, duration: float) -> None:
        """Go straight with a bell-shaped speed, and let the hand come to rest."""
        self._follow(start.interpolate(end, 0.5 - 0.5 * np.cos(np.pi * self._steps(2.0 * duration))))
        self._wait(end, _PAUSE)

    def _wait(self, X_WT: Pose, duration: float) -> None:
        self._hold(X_WT)
        for _ in self._steps(duration):
            pybullet.stepSimulation(physicsClientId=self._client)

    def _shake(self, X_WT: Pose) -> None:
        way = 0.5 - 0.5 * np.cos(2.0 * np.pi * self._steps(1.0 / self._settings.shake_frequency))
        for axis in np.eye(3):
            offset = self._settings.shake * way[:, None] * axis
            self._follow(Pose(X_WT.quaternion, X_WT.translation + offset))
        self._wait(X_WT, _PAUSE)

    def _body_pose(self) -> Pose:
        position, xyzw = pybullet.getBasePositionAndOrientation(self._object, physicsClientId=self._client)
        return Pose(np.roll(xyzw, 1), np.array(position))

    def _in_hand(self) -> Pose:
        position, xyzw = pybullet.getBasePositionAndOrientation(self._hand, physicsClientId=self._client)
        return Pose(np.roll(xyzw, 1), np.array(position)).inverse() @ self._body_pose()

    def _touching(self) -> bool:
        return all(
            pybullet.getContactPoints(self._hand, self._object, finger, -1, physicsClientId=self._client)
            for finger in self._fingers
        )


def _way(start: Pose, end: Pose) -> float:
    return float(np.linalg.norm(end.translation - start.translation))
