"""Clearance: how far an arm is from itself, a table and obstacles, in metres, many configurations at once.

Links are capsules and obstacles boxes, which hold what they stand for, so a clearance is never more than the distance
of the bodies themselves. Hence it also tells which configurations touch nothing for certain, at a fraction of the
cost of comparing the bodies (`optsc.collision.model`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from optsc.collision.capsules import link_capsules
from optsc.collision.kernels.capsules import LinkCapsules, capsule_ends
from optsc.collision.kernels.clearance import BOX, between_capsules, clearance
from optsc.collision.obstacles import Boxes, Obstacles, box_slots, boxes_of, convex_parts
from optsc.geometry import TriangleMesh
from optsc.geometry.rotation import Array
from optsc.kernels.kernel import BatchKernel, build_batch_kernel
from optsc.robot.model import RobotModel

HORIZON = 0.2
"""Clearances count up to this [m]: what is further away is no obstacle."""
SAFE = 1e-5
"""Bodies whose capsules are further apart than this [m] do not touch, whatever the rounding."""
BOXES_PER_OBSTACLE = 4
"""How many boxes an obstacle is made of at most."""
CLEARANCES_PER_LOOP = 8
"""Configurations in one compiled loop."""
SAMPLES = 400
"""Random configurations that tell which distances within the arm change."""
TRAVEL = 0.02
"""A distance within the arm that changes by less than this [m] over all samples says nothing of a configuration."""
LEVEL = 0.01
"""An end of a capsule whose height changes by less than this [m] over all samples is level, as at a shoulder."""
CLOSE = 0.05
"""Links whose capsules are nearer than this [m] at home are built together: only the exact check knows them."""
FAR_AWAY = 1e3
"""Where boxes stand that are not there [m]."""

LinkPairs: TypeAlias = tuple[tuple[str, str], ...]


class SelfPairs(NamedTuple):
    """Pairs of an arm's capsules, by number.

    Attributes:
        informative: pairs whose distance says something about a configuration.
        close: pairs that are close to each other, or always at about the same distance.
        overlapping: pairs of links some of whose capsules overlap at home: only the exact check tells their contacts.
    """

    informative: tuple[tuple[int, int], ...]
    close: tuple[tuple[int, int], ...]
    overlapping: LinkPairs


class Clearances(NamedTuple):
    """Clearances of N configurations [m], none above the horizon that was asked for.

    Attributes:
        own: (N,) to itself, but for links that are built close together.
        own_close: (N,) of those links.
        world: (N,) to the table, but for what never changes its height over it, and to all obstacles.
    """

    own: Array
    own_close: Array
    world: Array


def linked_pairs(capsules: LinkCapsules, linked: LinkPairs) -> list[tuple[int, int]]:
    """Return the pairs of capsules of the pairs of links that are ``linked``, by number."""
    wanted, names = {frozenset(pair) for pair in linked}, capsules.link
    count = len(names)
    return [(a, b) for a in range(count) for b in range(a + 1, count) if frozenset((names[a], names[b])) in wanted]


@lru_cache(maxsize=16)
def self_pairs(robot: RobotModel, linked: LinkPairs) -> SelfPairs:
    """Return the pairs of capsules of the pairs of links that are ``linked``."""
    capsules = link_capsules(robot)
    pairs, names = linked_pairs(capsules, linked), capsules.link
    if not pairs:
        return SelfPairs((), (), ())
    distance = _sampled(robot, capsules, pairs)
    apart = distance[0] > SAFE
    informative = (distance[0] > CLOSE) & (np.ptp(distance, axis=0) > TRAVEL)
    overlapping = dict.fromkeys((names[a], names[b]) for k, (a, b) in enumerate(pairs) if not apart[k])
    return SelfPairs(
        tuple(pair for k, pair in enumerate(pairs) if informative[k]),
        tuple(pair for k, pair in enumerate(pairs) if apart[k] and not informative[k]),
        tuple(overlapping),
    )


@lru_cache(maxsize=16)
def level(robot: RobotModel) -> tuple[int, ...]:
    """Return the capsules of the links' hulls that move but hardly change their height, such as a turning base."""
    return tuple(np.flatnonzero(level_ends(robot).all(axis=1)).tolist())


@lru_cache(maxsize=16)
def level_ends(robot: RobotModel) -> np.ndarray:
    """Return which ends (C, 2) of the hulls' capsules move but hardly change their height, as at a shoulder.

    Their distance from a table is the same in every configuration, so it says nothing of any.
    """
    least, most = _heights(robot)
    still = (most - least < LEVEL) & (link_capsules(robot, True).joint >= 0)[:, None]
    still.flags.writeable = False
    return still


@lru_cache(maxsize=16)
def _heights(robot: RobotModel) -> tuple[Array, Array]:
    """Return the least and the greatest height (C, 2) of the ends of the hulls' capsules over samples [m]."""
    q = sampled_configurations(robot)[:SAMPLES].T
    ends = capsule_ends(robot.chain, link_capsules(robot, True)).map(SAMPLES)(q).full()
    height = ends[[2, 5]].reshape(2, SAMPLES, -1)
    return height.min(axis=1).T, height.max(axis=1).T


def ends_over_table(robot: RobotModel) -> list[tuple[int, int]]:
    """Return the ends of capsules, by numbers of capsule and end, whose distance from a table says something."""
    hulls = link_capsules(robot, True)
    informative = ~level_ends(robot) & (hulls.joint >= 0)[:, None]
    return [(int(k), int(end)) for k, end in np.argwhere(informative)]


def sampled_configurations(robot: RobotModel) -> Array:
    """Return home and random configurations (1 + `SAMPLES`, n)."""
    return np.vstack([robot.home, robot.random_configuration(np.random.default_rng(0), (SAMPLES,))])


def _sampled(robot: RobotModel, capsules: LinkCapsules, pairs: Sequence[tuple[int, int]]) -> Array:
    """Return the distances (1 + `SAMPLES`, P) of pairs of capsules over all samples [m]."""
    q = sampled_configurations(robot)
    ends = capsule_ends(robot.chain, capsules).map(len(q))(q.T).full().reshape(6, len(q), -1)
    first, second = [a for a, _ in pairs], [b for _, b in pairs]
    radii = np.tile(capsules.radius[first] + capsules.radius[second], len(q))
    each = between_capsules().map(len(radii))
    distance = each(ends[:, :, first].reshape(6, -1), ends[:, :, second].reshape(6, -1), radii)
    return distance.full().reshape(len(q), -1)


@lru_cache(maxsize=16)
def _kernel(robot: RobotModel, linked: LinkPairs, slots: int) -> BatchKernel:
    pairs, hulls = self_pairs(robot, linked), link_capsules(robot, True)
    over = ends_over_table(robot)
    function = clearance(robot.chain, link_capsules(robot), hulls, pairs.informative, pairs.close, over, slots)
    return build_batch_kernel(function, CLEARANCES_PER_LOOP, shared=3)


@lru_cache(maxsize=64)
def _boxes(parts: tuple[TriangleMesh, ...], name: str) -> Boxes:
    return boxes_of(parts, BOXES_PER_OBSTACLE, name)


class ClearanceScene:
    """An arm among a table and obstacles that stand still.

    Args:
        robot: the arm.
        linked: pairs of links that are compared with each other, as `CollisionModel.self_pairs` has them.
        obstacles: shape and pose X_WO of everything that must not be touched, by name.
        table_height: z of the table top [m]; None for no table.

    Raises:
        InvalidValue: a part of an obstacle without volume.
    """

    def __init__(
        self,
        robot: RobotModel,
        linked: LinkPairs,
        obstacles: Obstacles,
        table_height: float | None,
    ) -> None:
        columns, owner = [np.zeros((BOX, 0))], []
        for name, (shape, X_WO) in obstacles.items():
            R, centre, half = _boxes(convex_parts(shape), name)
            turned = X_WO.rotation_matrix() @ R
            flat = np.swapaxes(turned, 1, 2).reshape(-1, 9)
            columns.append(np.concatenate([flat, X_WO.apply(centre), half], axis=1).T)
            owner += [name] * len(half)
        slots = box_slots(len(owner))
        nowhere = np.concatenate([np.eye(3).ravel(), np.full(3, FAR_AWAY), np.zeros(3)])
        self._box = np.tile(nowhere[:, None], slots)
        self._box[:, : len(owner)] = np.concatenate(columns, axis=1)
        self._robot = robot
        self._owner = np.array([*owner, *[""] * (slots - len(owner))])
        self._height = -FAR_AWAY if table_height is None else table_height
        self._kernel = _kernel(robot, linked, slots)
        self.finds_self_contacts = not self_pairs(robot, linked).overlapping
        """Whether there are configurations in which no capsules touch each other; not where some always do."""

    def level_ends_clear(self, margin: float) -> bool:
        """Tell whether the level ends of capsules that are not level themselves are above the table by a margin [m]."""
        hulls, ends = link_capsules(self._robot, True), level_ends(self._robot)
        least, most = _heights(self._robot)
        # What the samples did not show is assumed to be as much again as they did.
        height = least - (most - least) - hulls.radius[:, None] - self._height
        return bool(np.all(height[ends & ~ends.all(axis=1, keepdims=True)] > margin + SAFE))

    @property
    def compiled(self) -> bool:
        """Whether machine code runs, or CasADi's virtual machine."""
        return self._kernel.compiled

    def measure(self, q: Array, hand_may_touch: np.ndarray | None = None, horizon: float = HORIZON) -> Clearances:
        """Return the clearances of configurations ``q`` (N, n).

        Args:
            q: finite [rad].
            hand_may_touch: (N,) name of the obstacle that the hand may touch at each configuration; "" for none.
            horizon: what is further away than this [m] is not examined.
        """
        (found,) = self._kernel(q, shared=(horizon, self._height, self._box))
        slots = len(self._owner)
        arm, hand = found[:, 3 : 3 + slots], found[:, 3 + slots :]
        if hand_may_touch is not None:
            allowed = (hand_may_touch[:, None] == self._owner) & (self._owner != "")
            hand = np.where(allowed, horizon, hand)
        world = np.minimum(np.minimum(arm, hand).min(axis=1), found[:, 2])
        return Clearances(found[:, 0], found[:, 1], world)
