"""Collision check of an arm and its hand with a table, with named obstacles and with themselves.

Against the world every link is the convex hull of its collision shape: convex pairs are cheap, and a hull is
never smaller than the link. Between links the shapes themselves are compared, for the hulls of two bent links
overlap at configurations where the links are far from touching.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias
from weakref import WeakKeyDictionary

import coal
import numpy as np
import pinocchio
from numpy.typing import ArrayLike

from optsc.collision.capsules import link_capsules
from optsc.collision.clearance import SAFE, ClearanceScene, level
from optsc.collision.link_shapes import LinkShapes
from optsc.collision.obstacles import TABLE, THINNEST, Obstacles, checked_obstacles, convex_parts, is_flat
from optsc.errors import InvalidValue
from optsc.geometry import Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.robot.model import RobotModel

TABLE_HALF_SIZE = (5.0, 5.0, 1.0)
"""Half extents [m] of the box that stands for the table: wider than any arm's reach."""


class CollisionCheck(NamedTuple):
    """What `CollisionScene.clear` finds for N configurations.

    Attributes:
        clear: (N,) bool, True where nothing touches.
        reason: (N,) the first contact found, in words; "" where the configuration is clear.
    """

    clear: np.ndarray
    reason: np.ndarray


def convex_hull(vertices: ArrayLike, field: str = "convex part") -> Any:
    """Return the convex hull of points (V, 3) [m] as a coal shape; raise `InvalidValue` if they are flat."""
    V = np.asarray(vertices, dtype=float)
    # The library ends the process on points of a plane, so they are refused here.
    if V.ndim != 2 or len(V) < 4 or is_flat(V):
        raise InvalidValue(field, V.shape, f"points (V, 3) that span a volume, thicker than {THINNEST} m")
    points = coal.StdVec_Vec3s()
    points.extend(list(V))
    return coal.Convex.convexHull(points, True, "Qt")


_ShapePair: TypeAlias = tuple[int, int, str]  # two shapes, and what to say when they touch


class _Checker:
    """Pairs of shapes behind a comparison of bounding boxes, and what to say when a pair touches."""

    def __init__(self, model: Any, geometry: Any, pairs: Sequence[_ShapePair], margin: float) -> None:
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
        """Return for every full configuration (N, nq) the first pair (N,) found in contact, -1 for none."""
        found = np.full(len(full), -1)
        if not len(full):
            return found
        for pair in ignored:
            self._data.deactivateCollisionPair(pair)
        for k, q in enumerate(full):
            self._callback.init()
            if pinocchio.computeCollisions(self._model, self._state, self._boxes, self._callback, q):
                found[k] = self._callback.collisionPairIndex
        for pair in ignored:
            self._data.activateCollisionPair(pair)
        return found


class CollisionModel:
    """The collision geometry of an arm with its hand.

    Two links are checked against each other unless they are neighbours (fixed to each other or joined by one
    joint), both belong to the hand (jaws meet by design), or touch at the home configuration already. Links that no
    joint moves are not checked against the table, which they stand on, nor against obstacles, which no motion
    of the arm can help.

    It owns scratch memory of the collision library: ask it from one thread at a time.

    Raises:
        DamagedFile: the description or one of its collision meshes cannot be read.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self.shapes = robot, LinkShapes(robot)
        self.hulls = self.shapes.geometry.copy()
        for shape in self.hulls.geometryObjects:
            if isinstance(shape.geometry, coal.BVHModelBase):
                # Not the mesh's own triangles: on a dented mesh the search for a support point gets stuck.
                shape.geometry = convex_hull(shape.geometry.vertices(), f"collision mesh of {shape.name}")
        self._self_pairs = self._pairs_apart_at_home()
        self.self_checker = _Checker(self.shapes.model, self.shapes.geometry, self._self_pairs, 0.0)
        self.obstacle_hulls: WeakKeyDictionary[TriangleMesh, Any] = WeakKeyDictionary()

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links that have collision geometry, base first."""
        return tuple(dict.fromkeys(self.shapes.links))

    @property
    def self_pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of links that are checked against each other."""
        links = self.shapes.links
        return tuple(dict.fromkeys((links[a], links[b]) for a, b, _ in self._self_pairs))

    @cached_property
    def capsule_pairs(self) -> tuple[tuple[str, str], ...]:
        """`self_pairs` by the names that `optsc.collision.capsules` has: both fingers are called after the first."""
        jaws = [self.shapes.links[i] for i in sorted(self.shapes.jaws)]
        pairs = ((jaws[0] if a in jaws else a, jaws[0] if b in jaws else b) for a, b in self.self_pairs)
        return tuple(dict.fromkeys(pairs))

    @cached_property
    def covered(self) -> bool:
        """Whether capsules hold all that moves: not where something is moved by joints that are not the arm's."""
        capsules, shapes = link_capsules(self.robot), self.shapes
        moving = {capsules.link[k] for k in capsules.moving}
        return {shapes.links[i] for i in shapes.moving if i not in shapes.jaws} <= moving

    def scene(
        self, obstacles: Obstacles | None = None, table_height: float | None = 0.0, margin: float = 0.0
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
        return CollisionScene(self, obstacles, table_height, margin)

    def clear(
        self,
        q: ArrayLike,
        obstacles: Obstacles | None = None,
        table_height: float | None = 0.0,
        margin: float = 0.0,
        opening: ArrayLike | None = None,
    ) -> CollisionCheck:
        """Return which configurations (N, n) touch nothing; see `scene` and `CollisionScene.clear`."""
        return self.scene(obstacles, table_height, margin).clear(q, opening)

    def _pairs_apart_at_home(self) -> list[_ShapePair]:
        shapes, links, parents = self.shapes.shapes, self.shapes.links, self.shapes.model.parents
        pairs = []
        for a in range(len(shapes)):
            for b in range(a + 1, len(shapes)):
                i, j = shapes[a].parentJoint, shapes[b].parentJoint
                neighbours = i == j or parents[i] == j or parents[j] == i
                if not neighbours and not {a, b} <= self.shapes.hand:
                    pairs.append((a, b, f"{links[a]} touches {links[b]}"))
        home = self.shapes.configurations(self.robot.home[None])
        ignored: list[int] = []
        checker = _Checker(self.shapes.model, self.shapes.geometry.copy(), pairs, 0.0)
        while (contact := int(checker.first_contacts(home, ignored)[0])) >= 0:
            ignored.append(contact)
        return [pair for k, pair in enumerate(pairs) if k not in ignored]


class CollisionScene:
    """An arm among a table and obstacles that stand still; made by `CollisionModel.scene`."""

    def __init__(
        self, model: CollisionModel, obstacles: Obstacles | None, table_height: float | None, margin: float
    ) -> None:
        self._obstacles = checked_obstacles(obstacles, margin)
        self._arm, self._margin, self._table_height = model, margin, table_height
        self._geometry = model.hulls.copy()
        self._pairs: list[_ShapePair] = []
        self._hand_pairs: dict[str, list[int]] = {}
        if table_height is not None:
            box = coal.Box(*(2.0 * half for half in TABLE_HALF_SIZE))
            self._add(TABLE, box, Pose.from_translation([0.0, 0.0, table_height - TABLE_HALF_SIZE[2]]))
        for name, (shape, X_WO) in self._obstacles.items():
            for part in convex_parts(shape):
                self._add(name, self._hull(part, name), X_WO)
        self._checker = _Checker(model.shapes.model, self._geometry, self._pairs, margin)

    def _hull(self, part: TriangleMesh, name: str) -> Any:
        hulls = self._arm.obstacle_hulls
        if part not in hulls:
            hulls[part] = convex_hull(part.vertices, f"a part of {name}")
        return hulls[part]

    def _add(self, name: str, shape: Any, X_WO: Pose) -> None:
        placement = pinocchio.SE3(X_WO.rotation_matrix(), X_WO.translation)
        label = f"{name} {self._geometry.ngeoms}"
        index = self._geometry.addGeometryObject(pinocchio.GeometryObject(label, 0, 0, placement, shape))
        shapes = self._arm.shapes
        for a in shapes.moving:
            if a in shapes.hand:
                self._hand_pairs.setdefault(name, []).append(len(self._pairs))
            self._pairs.append((a, index, f"{shapes.links[a]} touches {name}"))

    def clear(
        self,
        q: ArrayLike,
        opening: ArrayLike | None = None,
        hand_may_touch: Sequence[str | None] | None = None,
    ) -> CollisionCheck:
        """Return which of N configurations touch nothing, and what the others touch.

        Args:
            q: (N, n) [rad].
            opening: distance between the pads [m], () or (N,); by default the jaws stand fully open.
            hand_may_touch: (N,) for each configuration the obstacle that the hand may touch, such as the one it is
                about to grasp, or None; the rest of the arm may not. Other names have no effect.

        Raises:
            InvalidValue: a configuration or an opening is not finite, of the wrong shape or out of range.
        """
        q = np.atleast_2d(self._arm.robot.checked(q))
        names = [None] * len(q) if hand_may_touch is None else hand_may_touch
        allowed = np.array([name or "" for name in names])
        if allowed.shape != (len(q),):
            raise InvalidValue("hand_may_touch", allowed.shape, f"shape ({len(q)},), one entry per configuration")
        world, own = self.certainly_clear(q, allowed)
        reason = np.full(len(q), "", dtype=object)
        # A given opening is checked even where the capsules, which hold the fingers at any, tell enough.
        some = np.flatnonzero(~(world & own)) if opening is None else np.arange(len(q))
        if len(some):
            full = self._arm.shapes.configurations(q[some], opening)
            reason[some] = self._reasons(full, allowed[some], world[some], own[some])
        return CollisionCheck(reason == "", reason)

    def _reasons(self, full: Array, allowed: np.ndarray, world: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Return the first contacts in words (N,); ``world`` and ``own`` are free already where they are true."""
        contacts = self._world_contacts(full, allowed, np.flatnonzero(~world))
        reason = self._checker.reasons[contacts]
        rest = np.flatnonzero((contacts < 0) & ~own)
        checker = self._arm.self_checker
        reason[rest] = checker.reasons[checker.first_contacts(full[rest])]
        return reason

    def _world_contacts(self, full: Array, allowed: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return the first contact (N,) with table or obstacles in some of the configurations, -1 in the others."""
        contacts = np.full(len(full), -1)
        contacts[rows] = self._checker.first_contacts(full[rows])
        for name in set(allowed[contacts >= 0].tolist()) & set(self._hand_pairs):
            # Switching pairs off costs more than a check: only those that met a permitted pair start over.
            pairs = self._hand_pairs[name]
            again = np.flatnonzero((allowed == name) & np.isin(contacts, pairs))
            contacts[again] = self._checker.first_contacts(full[again], pairs)
        return contacts

    def prepare(self) -> None:
        """Work out now what the first check would need; that takes a millisecond or two."""
        if self._arm.covered:
            self.certainly_clear(self._arm.robot.home[None], np.array([""]))

    @cached_property
    def capsules(self) -> ClearanceScene:
        """The same scene made of capsules and boxes, which tells clearances in metres."""
        arm = self._arm
        return ClearanceScene(arm.robot, arm.capsule_pairs, self._obstacles, self._table_height)

    @cached_property
    def _level_links_clear(self) -> bool:
        """Whether what never changes its height is above the table, which the clearances do not tell."""
        arm, capsules = self._arm, link_capsules(self._arm.robot, True)
        if self._table_height is None:
            return True
        if not self.capsules.level_ends_clear(self._margin):
            return False
        links = {capsules.link[k] for k in level(arm.robot)}
        home = arm.shapes.configurations(arm.robot.home[None])[0]
        _, placed = arm.shapes.placements(self._geometry, home)
        shapes = [k for k in arm.shapes.moving if arm.shapes.links[k] in links]
        return all(self._height_over_table(k, placed) > self._margin + SAFE for k in shapes)

    def _height_over_table(self, shape: int, placed: Any) -> float:
        """Return the height of a shape over the table [m]."""
        objects, table = self._geometry.geometryObjects, len(self._arm.shapes.links)
        at = [coal.Transform3s(placed.oMg[k].rotation, placed.oMg[k].translation) for k in (shape, table)]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        return coal.distance(objects[shape].geometry, at[0], objects[table].geometry, at[1], request, result)

    def certainly_clear(self, q: Array, allowed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return which configurations ``q`` (N, n) touch nothing of the world, and not themselves, as capsules tell.

        ``allowed`` (N,) names the obstacle that the hand may touch at each configuration; "" for none.
        """
        if not (self._arm.covered and self._level_links_clear and self.capsules.compiled):
            # Interpreted, the capsules take longer than the bodies themselves.
            return np.zeros(len(q), dtype=bool), np.zeros(len(q), dtype=bool)
        found = self.capsules.measure(q, allowed, self._margin + 2.0 * SAFE)
        own = (np.minimum(found.own, found.own_close) > SAFE) & self.capsules.finds_self_contacts
        return found.world > self._margin + SAFE, own
