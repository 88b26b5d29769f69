"""Collisions of an arm and its hand with a table, with named obstacles and with themselves.

Against the world every link is the convex hull of its collision shape: convex pairs are cheap, and a hull is
never smaller than the link. Between links the shapes themselves are compared, for the hulls of two bent links
overlap at postures where the links are far from touching.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias
from weakref import WeakKeyDictionary

import coal
import numpy as np
import pinocchio
from numpy.typing import ArrayLike

from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.robot.boxes import FLAT
from optsc.robot.capsules import link_capsules
from optsc.robot.clearance import SAFE, ClearanceScene, level
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
    """Return the convex hull of points (V, 3) [m] as a coal shape; raise `InvalidValue` if they are flat."""
    V = np.asarray(vertices, dtype=float)
    # The library ends the process on points of a plane, so they are refused here.
    if V.ndim != 2 or len(V) < 4 or np.linalg.svd(V - V.mean(axis=0), compute_uv=False)[-1] < FLAT:
        raise InvalidValue(field, V.shape, f"points (V, 3) that span a volume, thicker than {FLAT} m")
    points = coal.StdVec_Vec3s()
    points.extend(list(V))
    return coal.Convex.convexHull(points, True, "Qt")


_Pair: TypeAlias = tuple[int, int, str]  # two shapes, and what to say when they touch


class _Checker:
    """Pairs of shapes behind a comparison of bounding boxes, and what to say when a pair touches."""

    def __init__(self, model: Any, geometry: Any, pairs: Sequence[_Pair], margin: float) -> None:
        for a, b, _ in pairs:
            geometry.addCollisionPair(pinocchio.CollisionPair(a, b))
        self.reasons = np.array([*(reason for *_, reason in pairs), ""], dtype=object)
        self._model, self._state = model, model.createData()
        self._geometry, self._data = geometry, geometry.createData()
        for request in self._data.collisionRequests:
            request.security_margin = margin
        # Made after the margins are set: it inflates the bounding boxes by them. With up to a hundred shapes,
        # comparing all boxes takes half the time of keeping a tree of them.
        self._boxes = pinocchio.BroadPhaseManager_NaiveCollisionManager(model, geometry, self._data)
        self._callback = pinocchio.CollisionCallBackDefault(geometry, self._data, True)

    def first_contacts(self, full: Array, ignored: Sequence[int] = ()) -> Array:
        """Return for every full posture (N, nq) the first pair (N,) found in contact, -1 for none."""
        found = np.full(len(full), -1)
        if not len(full):
            return found
        for pair in ignored:
            self._data.deactivateCollisionPair(pair)
        for k, posture in enumerate(full):
            self._callback.init()
            if pinocchio.computeCollisions(self._model, self._state, self._boxes, self._callback, posture):
                found[k] = self._callback.collisionPairIndex
        for pair in ignored:
            self._data.activateCollisionPair(pair)
        return found


class CollisionModel:
    """The collision geometry of an arm with its hand.

    Two links are checked against each other unless they are neighbours (fixed to each other or joined by one
    joint), both belong to the hand (jaws meet by design), or touch at the home posture already. Links that no
    joint moves are not checked against the table, which they stand on, nor against obstacles, which no motion
    of the arm can help.

    It owns scratch memory of the collision library: ask it from one thread at a time.

    Raises:
        DamagedFile: the description or one of its collision meshes cannot be read.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        path = str(robot.urdf)
        try:
            self._model = pinocchio.buildModelFromUrdf(path)
            exact = pinocchio.buildGeomFromUrdf(self._model, path, pinocchio.GeometryType.COLLISION)
        except (ValueError, RuntimeError) as error:
            raise DamagedFile(robot.urdf, f"collision geometry cannot be loaded ({error})") from None
        shapes = exact.geometryObjects
        self._links = [self._model.frames[g.parentFrame].name for g in shapes]
        self._moving = [i for i, g in enumerate(shapes) if g.parentJoint != 0]
        self._hand = self._hand_shapes(shapes)
        self._hulls = self._hulls_of(exact)
        self._lay_out()
        self._self_pairs = self._pairs_apart_at_home(exact)
        self._self_checker = _Checker(self._model, exact, self._self_pairs, 0.0)
        self._obstacle_hulls: WeakKeyDictionary[TriangleMesh, Any] = WeakKeyDictionary()

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
        return tuple(dict.fromkeys((self._links[a], self._links[b]) for a, b, _ in self._self_pairs))

    @cached_property
    def capsule_pairs(self) -> tuple[tuple[str, str], ...]:
        """`self_pairs` by the names that `optsc.robot.capsules` has: both fingers are called after the first."""
        jaws = [self._links[i] for i in sorted(self._jaw_shapes)]
        pairs = ((jaws[0] if a in jaws else a, jaws[0] if b in jaws else b) for a, b in self.self_pairs)
        return tuple(dict.fromkeys(pairs))

    @cached_property
    def _covered(self) -> bool:
        """Whether capsules hold all that moves: not where something is moved by joints that are not the arm's."""
        capsules = link_capsules(self.robot)
        moving = {name for name, joint in zip(capsules.link, capsules.joint, strict=True) if joint >= 0}
        return {self._links[i] for i in self._moving if i not in self._jaw_shapes} <= moving

    def scene(
        self,
        obstacles: Mapping[str, tuple[Shape, Pose]] | None = None,
        table_height: float | None = 0.0,
        margin: float = 0.0,
    ) -> CollisionScene:
        """Return the arm among things that stand still.

        Hulls of obstacles are kept while their meshes live, so a scene whose objects only moved is cheap.

        Args:
            obstacles: shape and pose X_WO of everything that must not be touched, by name.
            table_height: z of the table top [m]; None for no table.
            margin: closest allowed distance to the table and the obstacles [m].

        Raises:
            InvalidValue: a margin out of range, an obstacle called "table", or a flat part.
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

    def _hand_shapes(self, shapes: Sequence[Any]) -> frozenset[int]:
        jaws = {self._model.getJointId(name) for name in self._finger_joints()}
        self._jaw_shapes = frozenset(i for i, g in enumerate(shapes) if g.parentJoint in jaws)
        frames = [self._model.frames[self._model.getFrameId(name)] for name in self._finger_joints()]
        carriers = {frame.parentFrame for frame in frames}
        return frozenset(
            i for i, g in enumerate(shapes) if g.parentJoint in jaws or g.parentFrame in carriers
        )

    def _finger_joints(self) -> list[str]:
        gripper = self.robot.gripper
        names = () if gripper is None else gripper.finger_joints
        return [name for name in names if self._model.existJointName(name)]

    def _hulls_of(self, exact: Any) -> Any:
        hulls = exact.copy()
        for shape in hulls.geometryObjects:
            if isinstance(shape.geometry, coal.BVHModelBase):
                # Not the mesh's own triangles: on a dented mesh the search for a support point gets stuck.
                shape.geometry = convex_hull(shape.geometry.vertices(), f"collision mesh of {shape.name}")
        return hulls

    def _lay_out(self) -> None:
        """Find out where the joints of the arm and the jaws stand in a posture of the whole description."""
        model = self._model
        joints = [model.joints[model.getJointId(name)] for name in self.robot.joint_names]
        self._columns = np.array([joint.idx_q for joint in joints])
        self._turning = np.flatnonzero([joint.nq == 2 for joint in joints])
        self._jaws = [model.joints[model.getJointId(name)].idx_q for name in self._finger_joints()]
        self._neutral = np.clip(pinocchio.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)

    def _full_postures(self, q: Array, opening: ArrayLike | None) -> Array:
        """Return postures (N, nq) of the whole description, jaws included, for arm postures ``q`` (N, n)."""
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
            for start in self._jaws:
                full[:, start] = 0.5 * width
        return full

    def _pairs_apart_at_home(self, exact: Any) -> list[_Pair]:
        shapes, parents, links = exact.geometryObjects, self._model.parents, self._links
        pairs = []
        for a in range(len(shapes)):
            for b in range(a + 1, len(shapes)):
                i, j = shapes[a].parentJoint, shapes[b].parentJoint
                neighbours = i == j or parents[i] == j or parents[j] == i
                if not neighbours and not {a, b} <= self._hand:
                    pairs.append((a, b, f"{links[a]} touches {links[b]}"))
        home = self._full_postures(self.robot.home[None], None)
        ignored: list[int] = []
        checker = _Checker(self._model, exact.copy(), pairs, 0.0)
        while (contact := int(checker.first_contacts(home, ignored)[0])) >= 0:
            ignored.append(contact)
        return [pair for k, pair in enumerate(pairs) if k not in ignored]


class CollisionScene:
    """An arm among a table and obstacles that stand still; made by `CollisionModel.scene`."""

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
        self._arm, self._margin = model, margin
        self._obstacles, self._table_height = obstacles, table_height
        self._geometry = model._hulls.copy()
        self._pairs: list[_Pair] = []
        self._hand_pairs: dict[str, list[int]] = {}
        if table_height is not None:
            box = coal.Box(*(2.0 * half for half in TABLE_HALF_SIZE))
            self._add(TABLE, box, Pose.from_translation([0.0, 0.0, table_height - TABLE_HALF_SIZE[2]]))
        for name, (shape, X_WO) in obstacles.items():
            for part in (shape,) if isinstance(shape, TriangleMesh) else shape:
                self._add(name, self._hull(part, name), X_WO)
        self._checker = _Checker(model._model, self._geometry, self._pairs, margin)

    def _hull(self, part: TriangleMesh, name: str) -> Any:
        hulls = self._arm._obstacle_hulls
        if part not in hulls:
            hulls[part] = convex_hull(part.vertices, f"a part of {name}")
        return hulls[part]

    def _add(self, name: str, shape: Any, X_WO: Pose) -> None:
        placement = pinocchio.SE3(X_WO.rotation_matrix(), X_WO.translation)
        label = f"{name} {self._geometry.ngeoms}"
        index = self._geometry.addGeometryObject(pinocchio.GeometryObject(label, 0, 0, placement, shape))
        for a in self._arm._moving:
            if a in self._arm._hand:
                self._hand_pairs.setdefault(name, []).append(len(self._pairs))
            self._pairs.append((a, index, f"{self._arm._links[a]} touches {name}"))

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
            hand_may_touch: (N,) for each posture the obstacle that the hand may touch, such as the one it is
                about to grasp, or None; the rest of the arm may not. Other names have no effect.

        Raises:
            InvalidValue: a posture or an opening is not finite, of the wrong shape or out of range.
        """
        q = np.atleast_2d(self._arm.robot.checked(q))
        names = [None] * len(q) if hand_may_touch is None else hand_may_touch
        allowed = np.array([name or "" for name in names])
        if allowed.shape != (len(q),):
            raise InvalidValue("hand_may_touch", allowed.shape, f"shape ({len(q)},), one entry per posture")
        world, own = self._certainly_clear(q, allowed)
        reason = np.full(len(q), "", dtype=object)
        # A given opening is looked at even where the capsules, which hold the fingers at any, tell enough.
        some = np.flatnonzero(~(world & own)) if opening is None else np.arange(len(q))
        if len(some):
            full = self._arm._full_postures(q[some], opening)
            reason[some] = self._reasons(full, allowed[some], world[some], own[some])
        return Clearance(reason == "", reason)

    def _reasons(self, full: Array, allowed: np.ndarray, world: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Return the first contacts in words (N,); ``world`` and ``own`` are free already where they are true."""
        contacts = self._world_contacts(full, allowed, np.flatnonzero(~world))
        reason = self._checker.reasons[contacts]
        rest = np.flatnonzero((contacts < 0) & ~own)
        checker = self._arm._self_checker
        reason[rest] = checker.reasons[checker.first_contacts(full[rest])]
        return reason

    def _world_contacts(self, full: Array, allowed: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return the first contact (N,) with table or obstacles in some of the postures, -1 in the others."""
        contacts = np.full(len(full), -1)
        contacts[rows] = self._checker.first_contacts(full[rows])
        for name in set(allowed[contacts >= 0].tolist()) & set(self._hand_pairs):
            # Switching pairs off costs more than a posture: only those that met a permitted pair start over.
            pairs = self._hand_pairs[name]
            again = np.flatnonzero((allowed == name) & np.isin(contacts, pairs))
            contacts[again] = self._checker.first_contacts(full[again], pairs)
        return contacts

    @cached_property
    def capsules(self) -> ClearanceScene:
        """The same scene made of capsules and boxes, which tells clearances in metres."""
        arm = self._arm
        return ClearanceScene(arm.robot, arm.capsule_pairs, self._obstacles, self._table_height)

    @cached_property
    def _level_links_clear(self) -> bool:
        """Whether what never changes its height is above the table, which the clearances do not tell."""
        arm, capsules = self._arm, link_capsules(self._arm.robot, True)
        links = {capsules.link[k] for k in level(arm.robot)}
        if self._table_height is None:
            return True
        data, geometry = arm._model.createData(), self._geometry.createData()
        full = arm._full_postures(arm.robot.home[None], None)[0]
        pinocchio.updateGeometryPlacements(arm._model, data, self._geometry, geometry, full)
        shapes = [k for k in arm._moving if arm._links[k] in links]
        if not self.capsules.level_ends_clear(self._margin):
            return False
        return all(self._height_over_table(k, geometry) > self._margin + SAFE for k in shapes)

    def _height_over_table(self, shape: int, placed: Any) -> float:
        """Return the height of a shape over the table [m]."""
        objects, table = self._geometry.geometryObjects, len(self._arm._links)
        at = [coal.Transform3s(placed.oMg[k].rotation, placed.oMg[k].translation) for k in (shape, table)]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        return coal.distance(objects[shape].geometry, at[0], objects[table].geometry, at[1], request, result)

    def _certainly_clear(self, q: Array, allowed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return which postures (N,) touch nothing of the world, and not themselves, as their capsules tell."""
        if not (self._arm._covered and self._level_links_clear and self.capsules.compiled):
            # Interpreted, the capsules take longer than the bodies themselves.
            return np.zeros(len(q), dtype=bool), np.zeros(len(q), dtype=bool)
        found = self.capsules.measure(q, allowed, self._margin + 2.0 * SAFE)
        own = (np.minimum(found.own, found.own_close) > SAFE) & self.capsules.tells_of_itself
        return found.world > self._margin + SAFE, own
