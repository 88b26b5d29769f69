"""Collisions of an arm and its hand with a table, with named obstacles and with themselves.

Every link is the convex hull of its collision shape in the URDF: a convex pair costs a fiftieth of two triangle
soups, and a hull is never smaller than the link. A tree of bounding boxes decides which pairs are looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import coal
import numpy as np
import pinocchio
from numpy.typing import ArrayLike

from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.robot.model import RobotModel

TABLE = "table"
"""What the table is called in a reason; no obstacle can have this name."""
TABLE_HALF_SIZE = (5.0, 5.0, 1.0)
"""Half extents [m] of the box that stands for the table: wider than any arm's reach."""

Shape: TypeAlias = TriangleMesh | Sequence[TriangleMesh]
"""A convex body, or the convex parts of one that is not; each mesh counts as its convex hull."""


class Clearance(NamedTuple):
    """What `CollisionScene.clear` finds for N postures.

    Attributes:
        clear: (N,) bool, True where nothing touches.
        reason: (N,) the first contact found, in words; "" where the posture is clear.
    """

    clear: np.ndarray
    reason: np.ndarray


def convex_hull(vertices: ArrayLike, field: str = "convex part") -> Any:
    """Return the coal convex hull of points (V, 3) [m]; raise `InvalidValue` when they span no volume."""
    points = coal.StdVec_Vec3s()
    points.extend(list(np.asarray(vertices, dtype=float)))
    try:
        return coal.Convex.convexHull(points, True, "Qt")
    except (RuntimeError, ValueError):
        raise InvalidValue(field, np.shape(vertices), "points (V, 3) [m] that span a volume") from None


def _with_hulls(geometry: Any) -> Any:
    for shape in geometry.geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            # The mesh's own triangles may not be taken for convex: on a dented mesh the support search gets stuck.
            vertices = shape.geometry.vertices() * np.ravel(shape.meshScale)
            if not np.allclose(shape.meshScale, 1.0):
                # The loader has applied the scale already.
                vertices = shape.geometry.vertices()
            shape.geometry = convex_hull(vertices, f"collision mesh of {shape.name}")
    return geometry


class CollisionModel:
    """The collision geometry of an arm with its hand.

    Two links are checked against each other unless they are neighbours (fixed to each other or joined by one joint),
    both belong to the hand (jaws meet by design), or already touch at the home posture (hulls overlap there by
    construction, which says nothing about the arm). Links that do not move are not checked against the table, which
    they stand on, nor against obstacles, which no motion can help.

    Raises:
        DamagedFile: the description or one of its collision meshes cannot be read.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        try:
            self._model = pinocchio.buildModelFromUrdf(str(robot.urdf))
            geometry = pinocchio.buildGeomFromUrdf(
                self._model, str(robot.urdf), pinocchio.GeometryType.COLLISION
            )
        except (ValueError, RuntimeError) as error:
            raise DamagedFile(robot.urdf, f"collision geometry cannot be loaded ({error})") from None
        self._geometry = _with_hulls(geometry)
        self._links = [self._model.frames[g.parentFrame].name for g in geometry.geometryObjects]
        self._moving = [i for i, g in enumerate(geometry.geometryObjects) if g.parentJoint != 0]
        self._hand = self._hand_shapes()
        self._columns, self._jaws, self._neutral = self._layout()
        self._self_pairs = self._checked_pairs()

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links that have collision geometry, base first."""
        return tuple(dict.fromkeys(self._links))

    @property
    def hand_links(self) -> tuple[str, ...]:
        """Names of the links of the hand: the jaws and the link that carries them."""
        return tuple(dict.fromkeys(self._links[i] for i in sorted(self._hand)))

    @property
    def self_pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of links that are checked against each other."""
        return tuple(dict.fromkeys((self._links[a], self._links[b]) for a, b in self._self_pairs))

    def scene(
        self,
        obstacles: Mapping[str, tuple[Shape, Pose]] | None = None,
        table_height: float | None = 0.0,
        margin: float = 0.0,
    ) -> CollisionScene:
        """Return the arm among things that stand still; making it costs about 3 ms, asking it 25 us a posture.

        Args:
            obstacles: shape and pose X_WO of everything that must not be touched, by name.
            table_height: z of the table top [m]; None for no table.
            margin: closest allowed distance to the table and the obstacles [m].

        Raises:
            InvalidValue: a margin below zero, an obstacle called "table", or a flat obstacle.
        """
        return CollisionScene(self, dict(obstacles or {}), table_height, margin)

    def clear(
        self,
        q: ArrayLike,
        obstacles: Mapping[str, tuple[Shape, Pose]] | None = None,
        table_height: float | None = 0.0,
        margin: float = 0.0,
        opening: ArrayLike | None = None,
    ) -> Clearance:
        """Return which postures (N, n) touch nothing; see `scene` and `CollisionScene.clear`."""
        return self.scene(obstacles, table_height, margin).clear(q, opening)

    def _hand_shapes(self) -> frozenset[int]:
        gripper = self.robot.gripper
        joints = [] if gripper is None else [j for j in gripper.finger_joints if self._model.existJointName(j)]
        jaws = {self._model.getJointId(j) for j in joints}
        carriers = {self._model.frames[self._model.getFrameId(j)].parentFrame for j in joints}
        shapes = enumerate(self._geometry.geometryObjects)
        return frozenset(i for i, g in shapes if g.parentJoint in jaws or g.parentFrame in carriers)

    def _layout(self) -> tuple[list[tuple[int, int]], list[int], Array]:
        """Return where each arm joint's (first number, count) and each jaw's number stand in the full posture."""
        model, gripper = self._model, self.robot.gripper
        joints = [model.joints[model.getJointId(name)] for name in self.robot.joint_names]
        names = () if gripper is None else gripper.finger_joints
        jaws = [model.joints[model.getJointId(j)].idx_q for j in names if model.existJointName(j)]
        neutral = np.clip(pinocchio.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)
        return [(j.idx_q, j.nq) for j in joints], jaws, neutral

    def full_postures(self, q: Array, opening: ArrayLike | None) -> Array:
        """Return postures (N, nq) of the whole description, jaws included, for arm postures ``q`` (N, n)."""
        full = np.tile(self._neutral, (len(q), 1))
        for k, (start, count) in enumerate(self._columns):
            # A continuous joint is stored as cosine and sine.
            full[:, start : start + count] = np.c_[np.cos(q[:, k]), np.sin(q[:, k])] if count == 2 else q[:, [k]]
        gripper = self.robot.gripper
        if gripper is not None:
            width = np.asarray(gripper.max_opening if opening is None else opening, dtype=float)
            if not np.all((width >= 0.0) & (width <= gripper.max_opening + 1e-9)):
                raise InvalidValue("gripper opening", width.tolist(), f"0 to {gripper.max_opening} m")
            for start in self._jaws:
                full[:, start] = 0.5 * width
        return full

    def _checked_pairs(self) -> list[tuple[int, int]]:
        geometry, shapes, parents = self._geometry, self._geometry.geometryObjects, self._model.parents
        pairs = []
        for a in range(len(shapes)):
            for b in range(a + 1, len(shapes)):
                i, j = shapes[a].parentJoint, shapes[b].parentJoint
                neighbours = i == j or parents[i] == j or parents[j] == i
                if not neighbours and not {a, b} <= self._hand:
                    pairs.append((a, b))
        for a, b in pairs:
            geometry.addCollisionPair(pinocchio.CollisionPair(a, b))
        data = geometry.createData()
        home = self.full_postures(self.robot.home[None], None)[0]
        pinocchio.computeCollisions(self._model, self._model.createData(), geometry, data, home, False)
        touching = [result.isCollision() for result in data.collisionResults]
        geometry.removeAllCollisionPairs()
        return [pair for pair, touches in zip(pairs, touching, strict=True) if not touches]


class CollisionScene:
    """An arm among a table and obstacles that stand still; made by `CollisionModel.scene`.

    It owns scratch memory of the collision library: ask it from one thread at a time.
    """

    def __init__(
        self,
        model: CollisionModel,
        obstacles: Mapping[str, tuple[Shape, Pose]],
        table_height: float | None,
        margin: float,
    ) -> None:
        if not 0.0 <= margin < 1.0:
            raise InvalidValue("collision margin", margin, "0 to 1 m")
        if TABLE in obstacles:
            raise InvalidValue("obstacle name", TABLE, "any name but that of the table")
        self.collision_model = model
        self._geometry = model._geometry.copy()
        self._reasons: list[str] = []
        self._hand_pairs: dict[str, list[int]] = {}
        for a, b in model._self_pairs:
            self._add_pair(a, b, f"{model._links[a]} touches {model._links[b]}")
        count = len(self._reasons)
        if table_height is not None:
            x, y, z = TABLE_HALF_SIZE
            box = coal.Box(2 * x, 2 * y, 2 * z)
            self._add_obstacle(TABLE, box, Pose.from_translation([0.0, 0.0, table_height - z]))
        for name, (shape, X_WO) in obstacles.items():
            for part in (shape,) if isinstance(shape, TriangleMesh) else shape:
                self._add_obstacle(name, convex_hull(part.vertices, f"a part of {name}"), X_WO)
        self._prepare(count, margin)

    def _prepare(self, first_outside: int, margin: float) -> None:
        self._state = self.collision_model._model.createData()
        self._data = self._geometry.createData()
        requests = self._data.collisionRequests
        for k in range(first_outside, len(requests)):
            requests[k].security_margin = margin
        # Made after the margins are set: it inflates the boxes of its tree by them.
        self._tree = pinocchio.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            self.collision_model._model, self._geometry, self._data
        )

    def _add_pair(self, a: int, b: int, reason: str) -> None:
        self._geometry.addCollisionPair(pinocchio.CollisionPair(a, b))
        self._reasons.append(reason)

    def _add_obstacle(self, name: str, shape: Any, X_WO: Pose) -> None:
        placement = pinocchio.SE3(X_WO.rotation_matrix(), X_WO.translation)
        label = f"{name} {self._geometry.ngeoms}"
        index = self._geometry.addGeometryObject(pinocchio.GeometryObject(label, 0, 0, placement, shape))
        article = "the " if name == TABLE else ""
        for a in self.collision_model._moving:
            if a in self.collision_model._hand:
                self._hand_pairs.setdefault(name, []).append(len(self._reasons))
            self._add_pair(a, index, f"{self.collision_model._links[a]} touches {article}{name}")

    def clear(
        self,
        q: ArrayLike,
        opening: ArrayLike | None = None,
        hand_may_touch: Sequence[str | None] | None = None,
    ) -> Clearance:
        """Return which of N postures touch nothing, and what the others touch.

        Args:
            q: (N, n) [rad].
            opening: distance between the pads [m], () or (N,); by default the jaws stand fully open.
            hand_may_touch: (N,) for each posture the obstacle that the hand may touch, such as the one it is about
                to grasp, or None; the rest of the arm may not. Names without an obstacle change nothing.

        Raises:
            InvalidValue: a posture or an opening is not finite, of the wrong shape or out of range.
        """
        q = np.atleast_2d(self.collision_model.robot.checked(q))
        full = self.collision_model.full_postures(q, opening)
        allowed = np.array([""] * len(q) if hand_may_touch is None else [n or "" for n in hand_may_touch])
        if allowed.shape != (len(q),):
            raise InvalidValue("hand_may_touch", allowed.shape, f"shape ({len(q)},), one entry per posture")
        found = np.full(len(q), -1)
        for name in np.unique(allowed):
            rows = np.flatnonzero(allowed == name)
            found[rows] = self._contacts(full[rows], self._hand_pairs.get(str(name), []))
        reasons = np.array([*self._reasons, ""], dtype=object)[found]
        return Clearance(found < 0, reasons)

    def _contacts(self, full: Array, permitted: Sequence[int]) -> Array:
        """Return for every full posture the first pair (N,) found in contact, -1 for none."""
        model, found = self.collision_model._model, np.full(len(full), -1)
        for pair in permitted:
            self._data.deactivateCollisionPair(pair)
        callback = pinocchio.CollisionCallBackDefault(self._geometry, self._data, True)
        for k, posture in enumerate(full):
            callback.init()
            if pinocchio.computeCollisions(model, self._state, self._tree, callback, posture):
                found[k] = callback.collisionPairIndex
        for pair in permitted:
            self._data.activateCollisionPair(pair)
        return found
