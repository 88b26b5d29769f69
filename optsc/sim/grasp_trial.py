"""One physical grasp trial: a floating hand comes in, closes, lifts and shakes an object on a plane.

What is found out here is how reliable grasps are as such; whether an arm reaches them is another question.
The criterion, 20 mm and 0.2 rad between hand and object, separates held from lost objects in published
trials (C. Eppner, A. Mousavian, D. Fox, "ACRONYM", 2021).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pybullet

from optsc.checks import AtLeast, Checked, Positive
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.robot import PANDA_HAND, urdf
from optsc.robot.description import read_description
from optsc.sim.bullet_arm import couple, drive_jaws, prepare_pads
from optsc.sim.bullet_bodies import add_object
from optsc.sim.bullet_client import BulletClient, body_pose, bullet_pose
from optsc.sim.objects import ObjectModel

_SETTLE = 0.5  # [s]
_PAUSE = 0.1  # [s]
_SQUEEZE_TIME = 0.15  # [s]
# PyBullet's motors reach their force only where the speed asked for is far from being met.
_SQUEEZE = 1.0  # [m/s]
_STEADY = (0.005, 0.05)  # [m], [rad]; an object that settles further away than that does not stand like this

_HAND, _TOOL = "panda_hand", "panda_hand_tcp"
_PULL = 500.0  # [N], greatest force that moves the floating hand


@dataclass(frozen=True)
class TrialSettings(Checked):
    """How a trial is done and what counts as holding; all numbers are above 0.

    Attributes:
        time_step: simulation step [s].
        solver_iterations: of the contact solver; with 50 an object slips that holds with 150 and at 1 kHz.
        standoff: length of the straight approach [m].
        speed: of approach and lift [m/s].
        jaw_force: greatest force of each jaw [N].
        jaw_speed: of each jaw while it closes [m/s].
        pad_friction: Coulomb coefficient of the pads [-]; one leaves the object's own in force.
        pad_torsion: radius [m] at which a pad's friction resists turning about its normal; for an evenly
            loaded disc of radius r it is 2 r / 3, and a Panda's pad has the area of a disc of 10 mm.
        lift: [m].
        shake: distance from one end to the other [m], along x, y and z in turn.
        shake_frequency: [Hz].
        max_slip: of the object in the hand [m].
        max_slip_angle: of the object in the hand [rad].
        bump: motion of the object before the jaws close that is called a bump [m].
    """

    time_step: Annotated[float, Positive] = 1.0 / 240.0
    solver_iterations: Annotated[int, AtLeast(1)] = 150
    standoff: Annotated[float, Positive] = 0.10
    speed: Annotated[float, Positive] = 0.25
    jaw_force: Annotated[float, Positive] = 40.0
    jaw_speed: Annotated[float, Positive] = 0.05
    pad_friction: Annotated[float, Positive] = 1.0
    pad_torsion: Annotated[float, Positive] = 0.005
    lift: Annotated[float, Positive] = 0.12
    shake: Annotated[float, Positive] = 0.06
    shake_frequency: Annotated[float, Positive] = 2.0
    max_slip: Annotated[float, Positive] = 0.02
    max_slip_angle: Annotated[float, Positive] = 0.2
    bump: Annotated[float, Positive] = 0.005

    def facts(self) -> dict[str, float]:
        """Return the numbers by name."""
        return asdict(self)


class TrialRow(NamedTuple):
    """What happened to one grasp: a row of `optsc.sim.validation.TrialOutcome`."""

    lifted: bool
    moved_before_closing: float
    moved_by_closing: float
    slip: float
    slip_angle: float


def settled(model: ObjectModel, X_WO: Pose, settings: TrialSettings) -> Pose:
    """Return where the object comes to rest when put on the plane at ``X_WO``.

    Raises:
        InvalidValue: no single pose, or the object does not stay there.
    """
    if X_WO.shape != ():
        raise InvalidValue("X_WO", X_WO.shape, "a single pose")
    with _ground(settings) as client:
        body = add_object(client, model, X_WO)
        before = body_pose(client, body)
        for _ in range(round(_SETTLE / settings.time_step)):
            pybullet.stepSimulation(physicsClientId=client)
        after = body_pose(client, body)
    moved = _distance(before, after), float(rotation.angle(before.quaternion, after.quaternion))
    if moved[0] > _STEADY[0] or moved[1] > _STEADY[1]:
        text = f"moved by {1e3 * moved[0]:.1f} mm and {moved[1]:.2f} rad when put down"
        raise InvalidValue(f"rest of {model.name}", text, f"at most {1e3 * _STEADY[0]:.0f} mm, {_STEADY[1]} rad")
    return after @ before.inverse() @ X_WO


def trial(model: ObjectModel, X_WO: Pose, X_OG: Pose, settings: TrialSettings) -> TrialRow:
    """Execute one grasp of the object that rests at ``X_WO`` and return what happened."""
    with _ground(settings) as client:
        return _GraspTrial(client, model, X_WO, X_WO @ X_OG, settings).run()


class _GraspTrial:
    """One grasp from the hand above the object to the object shaken in the hand."""

    def __init__(self, client: int, model: ObjectModel, X_WO: Pose, X_WG: Pose, settings: TrialSettings) -> None:
        self._client, self._settings, self._X_WG = client, settings, X_WG
        self._back = X_WG @ Pose.from_translation([0.0, 0.0, -settings.standoff])
        self._object = add_object(client, model, X_WO)
        self._hand = FloatingHand(client, settings, self._back)
        self._start = body_pose(client, self._object)

    def run(self) -> TrialRow:
        settings, X_WG = self._settings, self._X_WG
        self._hand.move_jaws(PANDA_HAND.max_opening, settings.jaw_speed)
        self._move(self._back, X_WG, settings.standoff / settings.speed)
        before = body_pose(self._client, self._object)
        self._close()
        closed, held = body_pose(self._client, self._object), self._in_hand()
        moved = _distance(self._start, before), _distance(before, closed)
        lost = TrialRow(False, *moved, float("nan"), float("nan"))
        if not self._hand.touches(self._object):
            return lost
        up = Pose(X_WG.quaternion, X_WG.translation + np.array([0.0, 0.0, settings.lift]))
        self._move(X_WG, up, settings.lift / settings.speed)
        if not self._held_up():
            return lost
        self._shake(up)
        if not self._held_up():
            return lost
        end = self._in_hand()
        slip = float(np.linalg.norm(end.translation - held.translation))
        slip_angle = float(rotation.angle(end.quaternion, held.quaternion))
        lifted = slip <= settings.max_slip and slip_angle <= settings.max_slip_angle
        return TrialRow(lifted, *moved, slip, slip_angle)

    def _close(self) -> None:
        """Close until both pads touch the object or nothing is left to close, then squeeze."""
        settings = self._settings
        self._hand.hold(self._X_WG)
        self._hand.move_jaws(0.0, settings.jaw_speed)
        for _ in range(round(0.5 * PANDA_HAND.max_opening / settings.jaw_speed / settings.time_step)):
            pybullet.stepSimulation(physicsClientId=self._client)
            if self._hand.touches(self._object):
                break
        self._hand.move_jaws(0.0, _SQUEEZE)
        self._wait(_SQUEEZE_TIME)

    def _held_up(self) -> bool:
        risen = body_pose(self._client, self._object).translation[2] - self._start.translation[2]
        return self._hand.touches(self._object) and bool(risen > 0.66 * self._settings.lift)

    def _steps(self, duration: float) -> Array:
        count = max(1, round(duration / self._settings.time_step))
        return np.arange(1, count + 1) / count

    def _move(self, start: Pose, end: Pose, duration: float) -> None:
        """Go straight with a bell-shaped speed of this mean, and let the hand come to rest."""
        self._hand.follow(start.interpolate(end, 0.5 - 0.5 * np.cos(np.pi * self._steps(duration))))
        self._hand.hold(end)
        self._wait(_PAUSE)

    def _wait(self, duration: float) -> None:
        for _ in self._steps(duration):
            pybullet.stepSimulation(physicsClientId=self._client)

    def _shake(self, X_WT: Pose) -> None:
        swing = 0.5 - 0.5 * np.cos(2.0 * np.pi * self._steps(1.0 / self._settings.shake_frequency))
        for axis in np.eye(3):
            offset = self._settings.shake * swing[:, None] * axis
            self._hand.follow(Pose(X_WT.quaternion, X_WT.translation + offset))
        self._hand.hold(X_WT)
        self._wait(_PAUSE)

    def _in_hand(self) -> Pose:
        return self._hand.pose().inverse() @ body_pose(self._client, self._object)


@cache
def hand_description() -> tuple[Path, Pose]:
    """Return a URDF of the Panda's hand alone, and X_HT of its tool frame T in the hand's link H."""
    path = urdf.example_robot_data("example-robot-data", "robots", "panda_description", "urdf", "panda.urdf")
    root = read_description(path).root
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
            pybullet.resetJointState(self.body, finger, 0.5 * PANDA_HAND.max_opening, 0.0, physicsClientId=client)
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
        pybullet.changeConstraint(self._grip, position, orientation, maxForce=_PULL, physicsClientId=self._client)

    def follow(self, poses: Pose) -> None:
        """Step the simulation once for each of ``poses`` (S,), the hand pulled to it."""
        X_WH = poses @ self._X_HT.inverse()
        positions, orientations = X_WH.translation.tolist(), np.roll(X_WH.quaternion, -1, axis=-1).tolist()
        for position, orientation in zip(positions, orientations, strict=True):
            pybullet.changeConstraint(self._grip, position, orientation, maxForce=_PULL, physicsClientId=self._client)
            pybullet.stepSimulation(physicsClientId=self._client)

    def move_jaws(self, opening: float, speed: float) -> None:
        """Let the jaws move towards ``opening`` [m], each at ``speed`` [m/s] at most, from now on."""
        drive_jaws(self._client, self.body, self.fingers, opening, self._settings.jaw_force, speed)

    def touches(self, body: int) -> bool:
        """Tell whether both jaws touch ``body``."""
        return all(
            pybullet.getContactPoints(self.body, body, finger, -1, physicsClientId=self._client)
            for finger in self.fingers
        )

    def pose(self) -> Pose:
        """Return X_WH of the hand's link."""
        return body_pose(self._client, self.body)


@contextmanager
def _ground(settings: TrialSettings) -> Iterator[int]:
    """A separate simulation with a plane."""
    with BulletClient() as simulation:
        client = simulation.client
        simulation.set_physics(settings.time_step, settings.solver_iterations)
        shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        plane = pybullet.createMultiBody(0.0, shape, physicsClientId=client)
        # PyBullet multiplies the coefficients of two bodies: one leaves the object's own in force.
        pybullet.changeDynamics(plane, -1, lateralFriction=1.0, physicsClientId=client)
        yield client


def _distance(start: Pose, end: Pose) -> float:
    return float(np.linalg.norm(end.translation - start.translation))
