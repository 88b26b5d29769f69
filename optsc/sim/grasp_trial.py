"""Trying grasps physically: a floating hand comes in, closes, lifts and shakes an object on a plane.

What is found out here is how reliable grasps are as such; whether an arm reaches them is another question.
The criterion, 20 mm and 0.2 rad between hand and object, separates held from lost objects in published
trials (C. Eppner, A. Mousavian, D. Fox, "ACRONYM", 2021).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import pybullet

from optsc.errors import InvalidValue, Mismatch
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.grasps import GraspSet
from optsc.robot import PANDA_HAND
from optsc.sim.bullet_bodies import add_object, connect
from optsc.sim.objects import ObjectModel
from optsc.sim.trial_hand import FloatingHand
from optsc.sim.trial_settings import TrialOutcome, TrialSettings

_SETTLE = 0.5  # [s]
_PAUSE = 0.1  # [s]
_SQUEEZE_TIME = 0.15  # [s]
_SQUEEZE = (
    1.0  # [m/s]; PyBullet's motors reach their force only where the speed asked for is far from being met
)
_STEADY = (0.005, 0.05)  # [m], [rad]; an object that settles further away than that does not stand like this


class _Row(NamedTuple):
    lifted: bool
    moved_before_closing: float
    moved_by_closing: float
    slip: float
    slip_angle: float


def try_grasps(
    model: ObjectModel,
    grasps: GraspSet,
    settings: TrialSettings | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    X_WO: Pose | None = None,
) -> TrialOutcome:
    """Return what happens when a floating Panda hand tries each grasp on the object, which stands on a plane.

    Every trial has a simulation that is made anew, so the outcome of a grasp depends on nothing but itself.

    Args:
        model: the object.
        grasps: in the object's frame; made on its surface, or on a camera's cloud of it.
        settings: how a trial is done.
        progress: called with the object's name, the trials done and the trials in all.
        X_WO: how the object rests on the plane z = 0; upright by default.

    Raises:
        Mismatch: the grasps were made on the surface of another object or for another gripper.
        InvalidValue: the object does not rest at ``X_WO``, or no single pose.
    """
    check_fit(model, grasps)
    settings = settings or TrialSettings()
    start = settled(model, Pose.identity() if X_WO is None else X_WO, settings)
    rows = []
    for done, X_OG in enumerate(grasps.X_OG, start=1):
        rows.append(trial(model, start, X_OG, settings))
        if progress is not None:
            progress(model.name, done, len(grasps))
    return outcome_of(rows)


def check_fit(model: ObjectModel, grasps: GraspSet) -> None:
    """Raise `Mismatch` for grasps for another hand than the Panda's or made on another object's surface."""
    if grasps.gripper != PANDA_HAND.name:
        raise Mismatch("grasp trial", PANDA_HAND.name, grasps.gripper)
    if grasps.made_on_mesh and grasps.object_hash != model.mesh.hash:
        raise Mismatch(f"grasp set of {grasps.object_name}", grasps.object_hash[:12], model.mesh.hash[:12])


def settled(model: ObjectModel, X_WO: Pose, settings: TrialSettings) -> Pose:
    """Return where the object comes to rest when put on the plane at ``X_WO``; see `try_grasps`."""
    if X_WO.shape != ():
        raise InvalidValue("X_WO", X_WO.shape, "a single pose")
    with _ground(settings) as client:
        body = add_object(client, model, X_WO)
        before = _pose_of(client, body)
        for _ in range(round(_SETTLE / settings.time_step)):
            pybullet.stepSimulation(physicsClientId=client)
        after = _pose_of(client, body)
    moved = _way(before, after), float(rotation.angle(before.quaternion, after.quaternion))
    if moved[0] > _STEADY[0] or moved[1] > _STEADY[1]:
        text = f"moved by {1e3 * moved[0]:.1f} mm and {moved[1]:.2f} rad when put down"
        raise InvalidValue(
            f"rest of {model.name}", text, f"at most {1e3 * _STEADY[0]:.0f} mm, {_STEADY[1]} rad"
        )
    return after @ before.inverse() @ X_WO


def trial(model: ObjectModel, X_WO: Pose, X_OG: Pose, settings: TrialSettings) -> _Row:
    """Carry out one grasp of the object that rests at ``X_WO``; return the fields of `TrialOutcome`."""
    with _ground(settings) as client:
        return _Trial(client, model, X_WO, X_WO @ X_OG, settings).run()


def outcome_of(rows: list[_Row]) -> TrialOutcome:
    """Return the outcome of trials, in order."""
    columns = np.array(rows, dtype=float).reshape(-1, 5).T
    return TrialOutcome(columns[0].astype(bool), *columns[1:])


class _Trial:
    """One grasp from the hand above the object to the object shaken in the hand."""

    def __init__(
        self, client: int, model: ObjectModel, X_WO: Pose, X_WG: Pose, settings: TrialSettings
    ) -> None:
        self._client, self._settings, self._X_WG = client, settings, X_WG
        self._back = X_WG @ Pose.from_translation([0.0, 0.0, -settings.standoff])
        self._object = add_object(client, model, X_WO)
        self._hand = FloatingHand(client, settings, self._back)
        self._start = _pose_of(client, self._object)

    def run(self) -> _Row:
        settings, X_WG = self._settings, self._X_WG
        self._hand.move_jaws(PANDA_HAND.max_opening, settings.jaw_speed)
        self._move(self._back, X_WG, settings.standoff / settings.speed)
        before = _pose_of(self._client, self._object)
        self._close()
        closed, held = _pose_of(self._client, self._object), self._in_hand()
        ways = _way(self._start, before), _way(before, closed)
        lost = _Row(False, *ways, float("nan"), float("nan"))
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
        return _Row(lifted, *ways, slip, slip_angle)

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
        risen = _pose_of(self._client, self._object).translation[2] - self._start.translation[2]
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
        way = 0.5 - 0.5 * np.cos(2.0 * np.pi * self._steps(1.0 / self._settings.shake_frequency))
        for axis in np.eye(3):
            offset = self._settings.shake * way[:, None] * axis
            self._hand.follow(Pose(X_WT.quaternion, X_WT.translation + offset))
        self._hand.hold(X_WT)
        self._wait(_PAUSE)

    def _in_hand(self) -> Pose:
        return self._hand.pose().inverse() @ _pose_of(self._client, self._object)


@contextmanager
def _ground(settings: TrialSettings) -> Iterator[int]:
    """A simulation of its own with a plane."""
    client = connect()
    try:
        pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=settings.time_step,
            numSolverIterations=settings.solver_iterations,
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        plane = pybullet.createMultiBody(0.0, shape, physicsClientId=client)
        # PyBullet multiplies the coefficients of two bodies: one leaves the object's own in force.
        pybullet.changeDynamics(plane, -1, lateralFriction=1.0, physicsClientId=client)
        yield client
    finally:
        pybullet.disconnect(client)


def _pose_of(client: int, body: int) -> Pose:
    position, xyzw = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
    return Pose(np.roll(xyzw, 1), np.array(position))


def _way(start: Pose, end: Pose) -> float:
    return float(np.linalg.norm(end.translation - start.translation))
