"""A robot arm as the rest of the library sees it: kinematics up to one tool frame, limits, gripper."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio
from numpy.typing import ArrayLike, NDArray

from optsc.errors import DamagedFile, InvalidValue, UnknownName
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.kernels.chain import Chain
from optsc.robot.description import (
    MissingMesh,
    Packages,
    chain_to,
    check_chain,
    read_description,
    with_base,
    with_locked,
    with_tool,
)
from optsc.robot.gripper import Gripper
from optsc.robot.limits import JointLimits
from optsc.robot.urdf import read_urdf, store

ACCELERATION_TIME = 0.2
"""Where nobody states an acceleration limit: the time [s] from rest to the velocity limit (tuned here)."""
JERK_TIME = 0.05
"""Where nobody states a jerk limit: the time [s] from no acceleration to its limit (tuned here)."""


@dataclass(frozen=True, eq=False)
class RobotModel:
    """An arm of n moving joints between the world W and the tool frame T.

    Attributes:
        name: what it is called in the catalogue, or the description's own name.
        urdf: path of the description, gripper included.
        tip: name of the tool frame T: between the pads, z the approach axis, y the closing axis.
        model: pinocchio model of the n arm joints; all others are locked. Treat as read-only.
        limits: joint limits, each (n,).
        home: a configuration (n,) [rad] inside the limits.
        gripper: the parallel jaws at the tip, if any.
        sources: where each limit comes from, in words.
        missing_meshes: those of the description that were not found.
    """

    name: str
    urdf: Path
    tip: str
    model: Any
    limits: JointLimits
    home: Array
    gripper: Gripper | None = None
    sources: dict[str, str] = field(default_factory=dict)
    missing_meshes: tuple[MissingMesh, ...] = ()

    @property
    def n(self) -> int:
        """Number of moving joints."""
        return self.model.nv

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints in the order of q."""
        return tuple(self.model.names)[1:]

    @cached_property
    def tip_id(self) -> int:
        """Index of the tool frame in `model`."""
        return _frame_id(self.model, self.tip)

    @cached_property
    def chain(self) -> Chain:
        """The arm as the kernels take it; raise `InvalidValue` unless it is a chain of turning and sliding joints."""
        return _chain_of(self.model, self.tip_id)

    @cached_property
    def _data(self) -> Any:
        return self.model.createData()

    @cached_property
    def endless(self) -> NDArray[np.bool_]:
        """Which joints (n,) turn without position limits: whole turns of them are no difference."""
        free = np.isinf(self.limits.lower) & np.isinf(self.limits.upper) & ~np.array(self.chain.slides)
        free.flags.writeable = False
        return free

    @cached_property
    def _any_endless(self) -> bool:
        return bool(self.endless.any())

    def difference(self, q_to: ArrayLike, q_from: ArrayLike) -> Array:
        """Return how far each joint moves (..., n) [rad] from ``q_from`` to ``q_to``; endless ones the shorter way."""
        gap = np.subtract(q_to, q_from)
        return np.where(self.endless, rotation.wrapped(gap), gap) if self._any_endless else gap

    def checked(self, q: ArrayLike, field: str = "q") -> Array:
        """Return a configuration (..., n) from outside as floats; raise `InvalidValue` on a wrong shape or NaN."""
        q = np.asarray(q, dtype=float)
        if q.shape[-1:] != (self.n,) or not np.all(np.isfinite(q)):
            raise InvalidValue(field, q.tolist(), f"finite, shape (..., {self.n}) [rad]")
        return q

    def forward(self, q: ArrayLike) -> Pose:
        """Return X_WT for configurations ``q`` (..., n)."""
        q = self.checked(q)
        xyzquat = np.array([self._placement(row) for row in q.reshape(-1, self.n)]).reshape(*q.shape[:-1], 7)
        return Pose(xyzquat[..., [6, 3, 4, 5]], xyzquat[..., :3])

    def _placement(self, q: Array) -> Array:
        """Position and quaternion (x, y, z, w) of T: the order of pinocchio."""
        pinocchio.framesForwardKinematics(self.model, self._data, q)
        return pinocchio.SE3ToXYZQUAT(self._data.oMf[self.tip_id])

    def jacobian(self, q: ArrayLike) -> Array:
        """Return the Jacobian (6, n) of T at ``q`` (n,): linear [m], then angular [rad], in W's axes."""
        return pinocchio.computeFrameJacobian(
            self.model, self._data, self.checked(q), self.tip_id, pinocchio.LOCAL_WORLD_ALIGNED
        )

    def random_configuration(self, rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Array:
        """Return configurations (*shape, n), uniform within the position limits."""
        lower, upper = self.limits.sampling
        return rng.uniform(lower, upper, size=(*shape, self.n))


def _chain_of(model: Any, tip_id: int) -> Chain:
    if list(model.parents)[1:] != list(range(model.nv)):
        raise InvalidValue("parents of the joints", list(model.parents)[1:], "one serial chain")
    axes, slides = zip(*(_axis_of(model, i) for i in range(1, model.njoints)), strict=True)
    placements, tip = list(model.jointPlacements)[1:], model.frames[tip_id].placement
    return Chain(
        rotation=np.array([placement.rotation for placement in placements]),
        translation=np.array([placement.translation for placement in placements]),
        axis=np.array(axes),
        slides=slides,
        tip_rotation=np.array(tip.rotation),
        tip_translation=np.array(tip.translation),
    )


def _axis_of(model: Any, index: int) -> tuple[Array, bool]:
    """Return the unit axis (3,) of a joint in its own frame, and whether it slides; raise `InvalidValue`."""
    joint = model.joints[index]
    data = joint.createData()
    joint.calc(data, np.zeros(1))
    # The motion subspace tells the axis of every joint type alike: linear part, then angular part.
    linear, angular = np.ravel(data.S)[:3], np.ravel(data.S)[3:]
    if np.any(linear) == np.any(angular):
        raise InvalidValue(f"type of joint {model.names[index]}", joint.shortname(), "revolute or prismatic")
    return (linear, True) if np.any(linear) else (angular, False)


LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk")
"""Kinds of joint limits."""
LARGEST_ANGLE = 1e2
"""Largest position limit of a turning joint [rad]: beyond it a number is meant in degrees."""


def _with_revolute_joints(root: Element) -> tuple[Element, set[str]]:
    """Replace continuous joints by revolute ones: one number per joint, so that q and its rate have one shape."""
    root, names = copy.deepcopy(root), set()
    for joint in root.findall("joint"):
        if joint.get("type") == "continuous":
            names.add(joint.get("name", ""))
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit", effort="0", velocity="0")
            limit.set("lower", "-1e6")
            limit.set("upper", "1e6")
    return root, names


def _reduced(model: Any, tip: str, gripper: Gripper | None) -> Any:
    """Lock every joint that does not move the tip; the gripper's own stand open."""
    frame = model.frames[_frame_id(model, tip)]
    arm = set(model.supports[frame.parentJoint])
    locked = [i for i in range(1, model.njoints) if i not in arm]
    q = np.clip(pinocchio.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)
    for i in locked:
        if gripper is not None and model.names[i] in gripper.finger_joints:
            q[model.joints[i].idx_q] = 0.5 * gripper.max_opening
    return pinocchio.buildReducedModel(model, locked, q) if locked else model


def _check_overrides(overrides: Mapping[str, ArrayLike], model: Any) -> None:
    """Raise for limits of an unknown kind or another number, and for angles that must have been meant in degrees."""
    for name, value in overrides.items():
        if name not in LIMITS:
            raise UnknownName("kind of limit", name, LIMITS)
        values = np.asarray(value, dtype=float)
        if values.shape != (model.nv,):
            joints = ", ".join(list(model.names)[1:])
            raise InvalidValue(f"limits[{name!r}]", values.tolist(), f"shape ({model.nv},), for {joints}")
        if name not in ("lower", "upper", "velocity"):
            continue
        turning = np.array([_axis_of(model, i)[1] is False for i in range(1, model.njoints)])
        too_large = turning & np.isfinite(values) & (np.abs(values) > LARGEST_ANGLE)
        if too_large.any():
            joint = list(model.names)[1 + int(np.argmax(too_large))]
            valid = "in radians; this looks like degrees"
            raise InvalidValue(f"limits[{name!r}] of {joint}", float(values[np.argmax(too_large)]), valid)


def _frame_id(model: Any, name: str) -> int:
    """Return the index of a frame; where a link and a joint have one name, that of the link."""
    links = [i for i, f in enumerate(model.frames) if f.name == name and f.type == pinocchio.FrameType.BODY]
    return links[0] if links else next(i for i, f in enumerate(model.frames) if f.name == name)


def _limits_of(model: Any, continuous: set[str], overrides: dict[str, ArrayLike]) -> JointLimits:
    endless = np.array([name in continuous for name in list(model.names)[1:]])
    velocity = np.asarray(overrides.get("velocity", model.upperVelocityLimit), dtype=float)
    acceleration = np.asarray(overrides.get("acceleration", velocity / ACCELERATION_TIME), dtype=float)
    return JointLimits(
        lower=overrides.get("lower", np.where(endless, -np.inf, model.lowerPositionLimit)),  # type: ignore[arg-type]
        upper=overrides.get("upper", np.where(endless, np.inf, model.upperPositionLimit)),  # type: ignore[arg-type]
        velocity=velocity,
        acceleration=acceleration,
        jerk=overrides.get("jerk", acceleration / JERK_TIME),  # type: ignore[arg-type]
    )


def model_from_urdf(
    path: str | Path,
    tip: str,
    *,
    name: str | None = None,
    gripper: Gripper | None = None,
    home: ArrayLike | None = None,
    limits: dict[str, ArrayLike] | None = None,
    sources: dict[str, str] | None = None,
    packages: Packages = (),
    locked: Mapping[str, float] | None = None,
    base: Pose | None = None,
    tool: Pose | None = None,
) -> RobotModel:
    """Return the arm that moves the frame ``tip`` of a URDF file.

    Args:
        path: the description. Its root link is the world frame W, where ``base`` is not given.
        tip: the tool frame T, or the one that ``tool`` starts from.
        name: what to call it; by default the description's own name.
        gripper: the jaws at the tip, if any.
        home: a configuration (n,) [rad]; by default the middle of the limits.
        limits: ``lower``, ``upper``, ``velocity``, ``acceleration``, ``jerk`` (n,) that replace the file's. Where
            nobody states them, acceleration and jerk follow from `ACCELERATION_TIME` and `JERK_TIME`.
        sources: where the limits come from, in words.
        packages: where the packages are that ``package://`` names of meshes mean, see `optsc.robot.description`.
        locked: joints that stand still, and where [rad or m].
        base: where the base stands, X_WB.
        tool: X_FT, the tool in the frame ``tip``.

    Raises:
        DamagedFile: the file is missing or no robot description.
        UnknownName: it has no frame ``tip``, no joint to lock of that name, or there is no such kind of limit.
        InvalidValue: a limit is missing or impossible, ``home`` lies outside them, or the arm has a joint that none
            can have, such as one that mimics another.
    """
    path = Path(path)
    description = read_description(path, packages)
    original, root = description.root, description.root
    if locked:
        root = with_locked(root, locked)
    if tool is not None:
        root, tip = with_tool(root, tip, tool)
    if base is not None:
        root = with_base(root, base)
    check_chain(chain_to(root, tip), tuple(limits or ()))
    if root is not original or not _same_text(root, path):
        urdf = store(root, name or root.get("name") or path.stem)
    else:
        urdf = path
    root, continuous = _with_revolute_joints(root)
    try:
        full = pinocchio.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    except ValueError as error:
        raise DamagedFile(path, f"is no robot description that pinocchio understands ({error})") from None
    frames = [f.name for f in full.frames]
    if tip not in frames:
        raise UnknownName("frame", tip, frames)
    model = _reduced(full, tip, gripper)
    if model.nv == 0 or model.nq != model.nv:
        raise InvalidValue(
            "joints between the root and " + tip, model.nv, "at least one, each of one degree of freedom"
        )
    _check_overrides(limits or {}, model)
    joint_limits = _limits_of(model, continuous, dict(limits or {}))
    configuration = np.array(np.mean(joint_limits.sampling, axis=0) if home is None else home, dtype=float)
    if configuration.shape != (model.nv,) or not np.all(joint_limits.clip(configuration) == configuration):
        raise InvalidValue("home", configuration.tolist(), f"shape ({model.nv},), inside the position limits")
    configuration.flags.writeable = False
    return RobotModel(
        name=name or root.get("name") or path.stem,
        urdf=urdf,
        tip=tip,
        model=model,
        limits=joint_limits,
        home=configuration,
        gripper=gripper,
        sources=dict(sources or {}),
        missing_meshes=description.missing,
    )


def _same_text(root: Element, path: Path) -> bool:
    """Tell whether a description says just what the file does."""
    return ElementTree.tostring(root) == ElementTree.tostring(read_urdf(path))
