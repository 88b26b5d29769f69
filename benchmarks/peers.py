"""Other libraries' differential inverse kinematics behind one face, on the same arm and with the same limits.

Each takes the newest target as it is: none of them carries samples on to the present or filters them.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from time import perf_counter
from typing import NamedTuple

import numpy as np

from optsc.geometry import Pose, rotation
from optsc.robot import RobotModel

POSITION_COST, ORIENTATION_COST, POSTURE_COST = 1.0, 0.3, 1e-2
"""As the weights of `optsc.ik.IkSettings`: the square of the last is its posture weight."""
GAIN = 60.0
"""Decay of a pose error [1/s], the servo's; their default, the whole error at every tick, is far rougher."""
DAMPING = 1.0
"""`lm_damping` of the frame tasks, as their examples have it."""


BARRIER_GAIN = 60.0
"""How fast Pink's barrier lets the distance to a surface be used up [1/s]: as `GAIN`."""
TOOL_RADIUS, KEPT, NOTICED = 0.02, 0.01, 0.1
"""Of a surface: size of the ball at the tool, distance that is kept, distance from which mink avoids it [m]."""


class Surface(NamedTuple):
    """A plane that the tool must not pass: the free side along ``axis`` of W, times ``sign``, goes up to ``at`` [m]."""

    axis: int
    sign: float
    at: float


class PeerTick(NamedTuple):
    """What a tick commanded and how long it took.

    Attributes:
        q, v: commanded configuration and velocity (n,) [rad, rad/s].
        solve: time of the library's `solve_ik` alone [s].
        whole: time of the tick: set the target, solve, integrate [s].
        solved: False when the library raised instead.
    """

    q: np.ndarray
    v: np.ndarray
    solve: float
    whole: float
    solved: bool


def arm_only(robot: RobotModel) -> str:
    """Return the URDF of the arm alone: gripper joints fixed, no meshes, so that all have the same n joints."""
    root = ElementTree.parse(robot.urdf).getroot()
    for link in root.iter("link"):
        for tag in ("visual", "collision"):
            for element in link.findall(tag):
                link.remove(element)
    for joint in root.findall("joint"):
        if joint.get("type") not in ("fixed", None) and joint.get("name") not in robot.joint_names:
            joint.set("type", "fixed")
            for tag in ("mimic", "limit", "dynamics", "axis"):
                for element in joint.findall(tag):
                    joint.remove(element)
    for joint in root.findall("joint"):
        if joint.get("name") in robot.joint_names:
            _set_limits(joint, robot, robot.joint_names.index(joint.get("name", "")))
    return ElementTree.tostring(root, encoding="unicode")


def _set_limits(joint: ElementTree.Element, robot: RobotModel, i: int) -> None:
    limit, limits = joint.find("limit"), robot.limits
    if limit is None:
        raise ValueError(f"joint {joint.get('name')} has no limits")
    limit.set("lower", repr(float(limits.lower[i])))
    limit.set("upper", repr(float(limits.upper[i])))
    limit.set("velocity", repr(float(limits.velocity[i])))


class PinkPeer:
    """Pink: frame and posture task, its position and velocity limits, and on request its acceleration limit."""

    def __init__(
        self, robot: RobotModel, rate: float, accelerations: bool = False, surface: Surface | None = None
    ) -> None:
        import pink
        import pinocchio
        from pink.barriers import PositionBarrier
        from pink.limits import AccelerationLimit, ConfigurationLimit, VelocityLimit

        self.name = "Pink, position + velocity + acceleration" if accelerations else "Pink, position + velocity"
        self.period = 1.0 / rate
        self._pink, self._pin = pink, pinocchio
        self.model = pinocchio.buildModelFromXML(arm_only(robot))
        self._limits = [ConfigurationLimit(self.model), VelocityLimit(self.model)]
        self._acceleration = AccelerationLimit(self.model, robot.limits.acceleration) if accelerations else None
        if self._acceleration is not None:
            self._limits.append(self._acceleration)
        self._barriers = []
        if surface is not None:
            end = np.array([surface.sign * (surface.at - KEPT - TOOL_RADIUS)])
            side = {"p_max": end} if surface.sign > 0 else {"p_min": end}
            # Gains as in its own example of this barrier, but for the speed.
            barrier = PositionBarrier(
                robot.tip,
                indices=[surface.axis],
                gain=np.array([BARRIER_GAIN]),
                safe_displacement_gain=1.0,
                **side,
            )
            self._barriers.append(barrier)
        gain = min(1.0, GAIN * self.period)
        self._frame = pink.FrameTask(robot.tip, POSITION_COST, ORIENTATION_COST, DAMPING, gain)
        self._posture = pink.PostureTask(POSTURE_COST, gain=self.period)
        self.reset(robot.home)

    def reset(self, q: np.ndarray) -> None:
        """Start from ``q`` (n,), at rest, with the target where the tool is."""
        self.configuration = self._pink.Configuration(self.model, self.model.createData(), q)
        self._frame.set_target_from_configuration(self.configuration)
        self._posture.set_target(q)
        self._rest(np.zeros(len(q)))

    def _rest(self, v: np.ndarray) -> None:
        self._v = v
        if self._acceleration is not None:
            self._acceleration.set_last_integration(v, self.period)

    def tick(self, X_WT: Pose | None) -> PeerTick:
        """Move one tick towards the newest target."""
        start = perf_counter()
        if X_WT is not None:
            w, x, y, z = X_WT.quaternion
            self._frame.set_target(self._pin.SE3(self._pin.Quaternion(w, x, y, z), X_WT.translation))
        before = perf_counter()
        solved = True
        try:
            v = self._pink.solve_ik(
                self.configuration,
                (self._frame, self._posture),
                self.period,
                solver="daqp",
                limits=self._limits,
                barriers=self._barriers,
                safety_break=False,
            )
        except self._pink.exceptions.PinkError:
            v, solved = np.zeros(self.model.nv), False
        after = perf_counter()
        self.configuration.integrate_inplace(v, self.period)
        self._rest(v)
        return PeerTick(self.configuration.q.copy(), v, after - before, perf_counter() - start, solved)


class MinkPeer:
    """mink: frame and posture task, its position and velocity limits; it has no others."""

    name = "mink, position + velocity"

    def __init__(self, robot: RobotModel, rate: float, surface: Surface | None = None) -> None:
        import mink
        import mujoco

        self._mink, self.period = mink, 1.0 / rate
        root = ElementTree.fromstring(arm_only(robot))
        extension = ElementTree.SubElement(root, "mujoco")
        ElementTree.SubElement(
            extension,
            "compiler",
            fusestatic="false",
            balanceinertia="true",
            boundmass="1e-3",
            boundinertia="1e-6",
        )
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
        if surface is not None:
            ball, plane = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_PLANE
            spec.body(robot.tip).add_geom(name="tool", type=ball, size=[TOOL_RADIUS, 0.0, 0.0])
            normal = -surface.sign * np.eye(3)[surface.axis]
            half_turn = np.array([*np.cross([0.0, 0.0, 1.0], normal), 1.0 + normal[2]])[[3, 0, 1, 2]]
            spec.worldbody.add_geom(
                name="surface",
                type=plane,
                size=[2.0, 2.0, 0.1],
                pos=-surface.at * normal,
                quat=half_turn / np.linalg.norm(half_turn),
            )
        self.model = spec.compile()
        names = [self.model.joint(i).name for i in range(self.model.njnt)]
        if tuple(names) != robot.joint_names:
            raise ValueError(f"MuJoCo orders the joints {names}, the arm {robot.joint_names}")
        velocity = dict(zip(names, robot.limits.velocity.tolist(), strict=True))
        self._limits = [mink.ConfigurationLimit(self.model), mink.VelocityLimit(self.model, velocity)]
        if surface is not None:
            avoid = mink.CollisionAvoidanceLimit(
                self.model,
                [(["tool"], ["surface"])],
                minimum_distance_from_collisions=KEPT,
                collision_detection_distance=NOTICED,
            )
            self._limits.append(avoid)
        gain = min(1.0, GAIN * self.period)
        self._frame = mink.FrameTask(robot.tip, "body", POSITION_COST, ORIENTATION_COST, gain, DAMPING)
        self._posture = mink.PostureTask(self.model, POSTURE_COST, gain=self.period)
        self.reset(robot.home)

    def reset(self, q: np.ndarray) -> None:
        """Start from ``q`` (n,), at rest, with the target where the tool is."""
        self.configuration = self._mink.Configuration(self.model, q=q)
        self._frame.set_target_from_configuration(self.configuration)
        self._posture.set_target(q)

    def tick(self, X_WT: Pose | None) -> PeerTick:
        """Move one tick towards the newest target."""
        start = perf_counter()
        if X_WT is not None:
            self._frame.set_target(self._mink.SE3(np.concatenate([X_WT.quaternion, X_WT.translation])))
        before = perf_counter()
        solved = True
        try:
            v = self._mink.solve_ik(
                self.configuration, (self._frame, self._posture), self.period, "daqp", limits=self._limits
            )
        except self._mink.exceptions.MinkError:
            v, solved = np.zeros(self.model.nv), False
        after = perf_counter()
        self.configuration.integrate_inplace(v, self.period)
        return PeerTick(self.configuration.q.copy(), v, after - before, perf_counter() - start, solved)


def target_path(X: Pose, t: np.ndarray, size: float = 1.0) -> Pose:
    """Return poses (N,) at times ``t`` (N,): a smooth path through the workspace around ``X`` that never repeats."""
    p = size * np.column_stack([0.08 * np.sin(2.0 * t), 0.10 * np.sin(1.3 * t), 0.08 * np.sin(1.7 * t)])
    turn = size * np.column_stack([0.2 * np.sin(t), 0.3 * np.sin(0.7 * t), 0.2 * np.sin(1.1 * t)])
    return Pose(rotation.multiply(rotation.exp(turn), X.quaternion), X.translation + p)
