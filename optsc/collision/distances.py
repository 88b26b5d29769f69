"""Signed distances of an arm to the table, to named obstacles and to itself, as rows on its joint velocity.

Links are capsules (`optsc.collision.capsules`), obstacles are boxes around their convex parts: both hold what they
stand for, so distances are never overestimated. Everything is worked out in one call of a compiled function
(`optsc.collision.kernels.distances`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.collision.capsules import link_capsules
from optsc.collision.clearance import TRAVEL, linked_pairs, sampled_configurations
from optsc.collision.kernels.capsules import LinkCapsules
from optsc.collision.kernels.distances import SelfPair, TableEnd, distance_rows
from optsc.collision.kernels.rows import HEAD, Box
from optsc.collision.model import CollisionModel
from optsc.collision.obstacles import (
    TABLE,
    Boxes,
    Obstacles,
    box_slots,
    boxes_of,
    checked_obstacles,
    convex_parts,
)
from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.kernels.kernel import Kernel, build_kernel
from optsc.robot.model import RobotModel

SPARE_AT_HOME = 0.5
"""Share of a distance at home that a margin may take up, where links are built close together."""
ROUND = 1e-3
"""A capsule no longer than this [m] counts as a ball over the table."""
EVERYTHING = 1e3
"""Joint speed [rad/s] at which no pair is skipped as too far away to matter."""
ABSENT = 1e6
"""Distances above this [m] stand for boxes that are not there, or that the hand may touch."""


class BodyPair(NamedTuple):
    """Two bodies that are kept apart: a link, and another link, the table or an obstacle."""

    link: str
    other: str


class DistanceRows(NamedTuple):
    """What matters at a tick.

    Attributes:
        pair: (m,) into `DistanceModel.pairs`.
        distance: (m,) [m]; negative where bodies overlap.
        lower: (m,) the rate [m/s] that each distance must not fall faster than; what an obstacle's own motion does
            to it is taken off.
        gradient: (m, n) of the distances in the configuration [m/rad].
        need: (m,) how far [m/s] the worst joint velocity of this tick would fall below `lower`; negative.
    """

    pair: np.ndarray
    distance: Array
    lower: Array
    gradient: Array
    need: Array


class DistanceModel:
    """The distances of an arm and its hand.

    Links are compared as `CollisionModel` compares them. Left out besides: capsules that overlap at home where the
    links themselves do not, and distances that no motion changes.

    It owns scratch memory: ask it from one thread at a time.

    Args:
        robot: the arm.
        obstacles: shape and pose X_WO of everything that must not be touched, by name.
        table_height: z of the table top [m]; None for no table.
        margin: distance that is kept [m].
        boxes: how many boxes an obstacle is made of at most.

    Raises:
        InvalidValue: an impossible margin, an obstacle called "table", or a part without volume.
        DamagedFile: the description or one of its collision meshes cannot be read.
    """

    def __init__(
        self,
        robot: RobotModel,
        obstacles: Obstacles | None = None,
        table_height: float | None = 0.0,
        margin: float = 0.01,
        boxes: int = 4,
    ) -> None:
        obstacles = checked_obstacles(obstacles, margin)
        self.robot, self.capsules = robot, link_capsules(robot)
        self._parts: dict[str, tuple[slice, Boxes]] = {}
        count = 0
        for name, (shape, _) in obstacles.items():
            around = boxes_of(convex_parts(shape), boxes, name)
            self._parts[name] = (slice(count, count + len(around.half)), around)
            count += len(around.half)
        self._slots = 0 if count == 0 else box_slots(count)
        self_pairs, table_ends = _relevant(robot, self.capsules, table_height, margin)
        self._name_pairs(self_pairs, table_ends)
        self._kernel = build_kernel(
            distance_rows(robot.chain, robot.limits.rates, self.capsules, self_pairs, table_ends, self._slots)
        )
        self._q, self._low, self._high, self.settings, self.obstacles = self._kernel.inputs
        """Boxes of the obstacles, one column each, as `optsc.collision.kernels.rows.Box` lays them out."""
        self.settings[:] = margin, table_height or 0.0, 1.0, 1.0, 0.1, 0.1
        rows, self._least_need = self._kernel.outputs
        self._rows = rows.T  # (P, 3 + n)
        none = np.zeros(0)
        self._nothing = DistanceRows(np.zeros(0, dtype=np.intp), none, none, np.zeros((0, robot.n)), none)
        self.obstacles[Box.ABSENT] = 1.0
        for name, (_, X_WO) in obstacles.items():
            self.obstacles[Box.ABSENT, self._parts[name][0]] = 0.0
            self.move(name, X_WO)

    def _name_pairs(self, self_pairs: list[SelfPair], table_ends: list[TableEnd]) -> None:
        link = self.capsules.link
        pairs = [BodyPair(link[a], link[b]) for a, b, _ in self_pairs]
        pairs += [BodyPair(link[a], TABLE) for a, _, _ in table_ends]
        owner = [""] * self._slots
        for name, (where, *_) in self._parts.items():
            owner[where] = [name] * (where.stop - where.start)
        moving = self.capsules.moving
        self.pairs: tuple[BodyPair, ...] = (
            *pairs,
            *(BodyPair(link[a], name) for name in owner for a in moving),
        )
        """The two bodies of every row there can be; links of several capsules appear several times."""

    @property
    def obstacle_names(self) -> frozenset[str]:
        """Names of the obstacles."""
        return frozenset(self._parts)

    def _slot(self, name: str) -> tuple[slice, Boxes]:
        if name not in self._parts:
            raise UnknownName("obstacle", name, self._parts)
        return self._parts[name]

    def move(self, name: str, X_WO: Pose, twist: ArrayLike | None = None) -> None:
        """Place an obstacle at ``X_WO``, moving with ``twist`` (6,) in W: linear (its origin), then angular.

        Raises:
            UnknownName: no such obstacle.
            InvalidValue: a twist that is not six finite numbers.
        """
        where, (R, centre, half) = self._slot(name)
        R_WO = X_WO.rotation_matrix()
        turned = R_WO @ R
        offset = centre @ R_WO.T
        self.obstacles[Box.ROTATION, where] = np.swapaxes(turned, 1, 2).reshape(-1, 9).T
        self.obstacles[Box.CENTRE, where] = (offset + X_WO.translation).T
        self.obstacles[Box.HALF, where] = half.T
        if twist is None:
            self.obstacles[Box.LINEAR, where] = self.obstacles[Box.ANGULAR, where] = 0.0
            return
        v = np.asarray(twist, dtype=float)
        if v.shape != (6,) or not np.all(np.isfinite(v)):
            raise InvalidValue("twist", v.tolist(), "six finite numbers")
        self.obstacles[Box.LINEAR, where] = (v[:3] + np.cross(v[3:], offset)).T
        self.obstacles[Box.ANGULAR, where] = v[3:, None]

    def hand_may_touch(self, *names: str) -> None:
        """Let the hand touch these obstacles, such as one it is about to grasp, and no others; raise `UnknownName`."""
        self.obstacles[Box.HAND_MAY_TOUCH] = 0.0
        for name in names:
            self.obstacles[Box.HAND_MAY_TOUCH, self._slot(name)[0]] = 1.0

    def rows(self, q: Array, lowest: Array, highest: Array, most: int) -> DistanceRows:
        """Return the rows that can matter at this tick, at most ``most`` of them, those in greatest need.

        A pair is left out only where no velocity between ``lowest`` and ``highest`` (n,) brings it below its bound:
        what is left out does not change the solution, so rows may come and go without an effect on the motion.
        """
        self._q[:], self._low[:], self._high[:] = q, lowest, highest
        self._kernel.run()
        if self._least_need[0] >= 0.0:
            return self._nothing
        rows = self._rows
        index = np.flatnonzero(rows[:, 0] < 0.0)
        if len(index) > most:
            index = np.sort(index[np.argpartition(rows[index, 0], most)[:most]])
        found = rows[index]
        return DistanceRows(index, found[:, 2], found[:, 1], found[:, HEAD:], found[:, 0])

    def distances(self, q: ArrayLike) -> tuple[Array, Array]:
        """Return the distances (P,) [m] of all `pairs` at a configuration (n,), and their gradients (P, n).

        A distance is infinite where there is no box, or one that the hand may touch.
        """
        self._q[:] = self.robot.checked(q)
        self._low[:], self._high[:] = -EVERYTHING, EVERYTHING
        self._kernel.run()
        distance = self._rows[:, 2].copy()
        distance[distance > ABSENT] = np.inf
        return distance, self._rows[:, HEAD:].copy()


def _relevant(
    robot: RobotModel, capsules: LinkCapsules, table_height: float | None, margin: float
) -> tuple[list[SelfPair], list[TableEnd]]:
    """Return the pairs of capsules, and the ends of capsules over the table, that are kept apart."""
    pairs = [SelfPair(a, b, 0.0) for a, b in linked_pairs(capsules, CollisionModel(robot).self_pairs)]
    moving = capsules.moving if table_height is not None else []
    long = capsules.length > ROUND
    ends = [TableEnd(c, e, 0.0) for c in moving for e in ((0, 1) if long[c] else (0,))]
    kernel = build_kernel(distance_rows(robot.chain, robot.limits.rates, capsules, pairs, ends, 0))
    kernel.inputs[1][:], kernel.inputs[2][:] = -EVERYTHING, EVERYTHING
    kernel.inputs[3][:] = 0.0, table_height or 0.0, 1.0, 1.0, 0.1, 0.1
    distance = np.array([_distances_at(kernel, q) for q in sampled_configurations(robot)])
    keeps = np.minimum(margin, SPARE_AT_HOME * distance[0])
    kept = (distance[0] > 0.0) & (np.ptp(distance, axis=0) > TRAVEL)
    of_pairs, of_ends = np.split(np.arange(len(kept)), [len(pairs)])
    return (
        [pair._replace(margin=float(keeps[k])) for k, pair in zip(of_pairs, pairs, strict=True) if kept[k]],
        [end._replace(margin=float(keeps[k])) for k, end in zip(of_ends, ends, strict=True) if kept[k]],
    )


def _distances_at(kernel: Kernel, q: Array) -> Array:
    kernel.inputs[0][:] = q
    kernel.run()
    return kernel.outputs[0][2].copy()
