"""The shapes of an arm's links and its hand, as its description has them: those to touch, or those to see."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio
from numpy.typing import ArrayLike

from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry.rotation import Array
from optsc.robot.model import RobotModel


class LinkShapes:
    """The shapes of a whole description, jaws included.

    Args:
        robot: the arm.
        visual: whether those that are to be seen are meant, instead of the collision geometry.

    Attributes:
        robot: the arm.
        model, geometry: of pinocchio. Treat as read-only.
        links: name of the link of each shape.
        moving: shapes that a joint moves.
        jaws: shapes of the two fingers.
        hand: shapes of the hand: the fingers and the link that carries them.

    Raises:
        DamagedFile: the description or one of its meshes cannot be read.
    """

    def __init__(self, robot: RobotModel, visual: bool = False) -> None:
        self.robot, path = robot, str(robot.urdf)
        kind, words = pinocchio.GeometryType.COLLISION, "collision geometry"
        if visual:
            kind, words = pinocchio.GeometryType.VISUAL, "visual geometry"
        lost = [mesh for mesh in robot.missing_meshes if mesh.kind == "collision"]
        if lost and not visual:
            more = f", and {len(lost) - 1} more" if len(lost) > 1 else ""
            raise DamagedFile(robot.urdf, f"{lost[0]}{more}; say where its package is by packages=")
        try:
            model = self.model = pinocchio.buildModelFromUrdf(path)
            self.geometry = pinocchio.buildGeomFromUrdf(model, path, kind)
        except (ValueError, RuntimeError) as error:
            raise DamagedFile(robot.urdf, f"{words} cannot be loaded ({error})") from None
        shapes = self.shapes
        self.links = [model.frames[shape.parentFrame].name for shape in shapes]
        self.moving = [i for i, shape in enumerate(shapes) if shape.parentJoint != 0]
        names = () if robot.gripper is None else robot.gripper.finger_joints
        fingers = [name for name in names if model.existJointName(name)]
        ids = {model.getJointId(name) for name in fingers}
        carriers = {model.frames[model.getFrameId(name)].parentFrame for name in fingers}
        self.jaws = frozenset(i for i, shape in enumerate(shapes) if shape.parentJoint in ids)
        carrying = frozenset(i for i, shape in enumerate(shapes) if shape.parentFrame in carriers)
        self.hand = self.jaws | carrying
        joints = [model.joints[model.getJointId(name)] for name in robot.joint_names]
        self._columns = np.array([joint.idx_q for joint in joints])
        self._turning = np.flatnonzero([joint.nq == 2 for joint in joints])
        self._jaw_columns = [model.joints[model.getJointId(name)].idx_q for name in fingers]
        self._neutral = np.clip(pinocchio.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)

    @property
    def shapes(self) -> Sequence[Any]:
        """The shapes of `geometry`."""
        return self.geometry.geometryObjects

    def neutral(self, opening: float) -> Array:
        """Return the neutral configuration (nq,) at a distance ``opening`` [m] between the pads."""
        q = self._neutral.copy()
        q[self._jaw_columns] = 0.5 * opening
        return q

    def configurations(self, q: Array, opening: ArrayLike | None = None) -> Array:
        """Return configurations (N, nq) of the whole description for those of the arm ``q`` (N, n).

        ``opening`` is the distance between the pads [m], () or (N,); by default the jaws stand fully open.

        Raises:
            InvalidValue: an opening out of range.
        """
        full = np.tile(self._neutral, (len(q), 1))
        full[:, self._columns] = q
        if len(self._turning):
            # A joint that turns endlessly is stored as cosine and sine.
            column = self._columns[self._turning]
            full[:, column], full[:, column + 1] = np.cos(q[:, self._turning]), np.sin(q[:, self._turning])
        gripper = self.robot.gripper
        if gripper is not None:
            width = np.asarray(gripper.max_opening if opening is None else opening, dtype=float)
            if not np.all((width >= 0.0) & (width <= gripper.max_opening + 1e-9)):
                raise InvalidValue("gripper opening", width.tolist(), f"0 to {gripper.max_opening} m")
            for column in self._jaw_columns:
                full[:, column] = 0.5 * width
        return full

    def placements(self, geometry: Any, q: Array) -> tuple[Any, Any]:
        """Return pinocchio's data of the model and of ``geometry`` at a full configuration (nq,)."""
        data, placed = self.model.createData(), geometry.createData()
        pinocchio.updateGeometryPlacements(self.model, data, geometry, placed, q)
        return data, placed


def massless_links(robot: RobotModel) -> dict[int, str]:
    """Return the moving bodies of the whole description that have no mass: joint of `LinkShapes`, and its link."""
    model = pinocchio.buildModelFromUrdf(str(robot.urdf))
    links: dict[int, str] = {}
    for frame in model.frames:
        if frame.type == pinocchio.FrameType.BODY and model.inertias[frame.parentJoint].mass < 1e-9:
            # The first link at a joint is the one that it moves; others are fixed to that.
            links.setdefault(frame.parentJoint, frame.name)
    links.pop(0, None)
    return links
