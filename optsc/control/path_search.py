"""Path search: the first of many grasps that the arm can go to on a free straight path, looked for a little at a time.

What one `advanced` does is bounded by counts, so that no control tick takes long and a replay does the same: so many
legs of paths are rolled out, or so many configurations are checked for collision. The result is that of
`optsc.control.path_feasibility.most_feasible`, as far as the search is carried on.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from optsc.control.approach import Approach
from optsc.control.path_feasibility import SPEED_LIMIT_SHARE, PathFeasibility, grasp_path
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.grasps import Candidates
from optsc.robot import RobotModel
from optsc.robot.rollout import path_rollout
from optsc.selection import Target
from optsc.selection.reach import ClearRows

LEGS = 3
"""Of the path to a grasp: to the pre-grasp, to the grasp, and up."""
PATHS = 2
"""Paths rolled out side by side."""
LEGS_AT_ONCE = 6
"""Legs rolled out by one `advanced` at most."""
SCREENED = 24
"""Configurations by one `advanced` of which it is asked whether they are clear for certain."""
CHECKED = 5
"""Configurations that one `advanced` checks for collision in full."""


@runtime_checkable
class ScreenedCheck(Protocol):
    """A collision check that has a quick answer for most configurations, such as `optsc.collision.GraspClearance`."""

    def certainly_clear(self, q: Array, hand_may_touch: np.ndarray) -> np.ndarray:
        """Return which configurations (R, n) touch nothing for certain (R,); the others may or may not."""

    def clear(self, q: Array, hand_may_touch: np.ndarray) -> np.ndarray:
        """Return which configurations (R, n) touch nothing (R,) but the object each that the hand may touch."""


class SearchScene(NamedTuple):
    """What paths are searched in.

    Attributes:
        robot: the arm.
        approach: how it moves by itself.
        candidates, clear: the grasps and their collision check, if any.
        target_of: returns a candidate as a target.
    """

    robot: RobotModel
    approach: Approach
    candidates: Candidates
    clear: ClearRows | None
    target_of: Callable[[int], Target]


class RolledPath(NamedTuple):
    """A path that the arm can follow, while it is checked for collision.

    Attributes:
        candidate: the grasp that it leads to.
        good: what it counts if it is free.
        before, after: configurations (B, n) up to the pre-grasp and (A, n) from there on [rad].
        unseen: numbers of the configurations, those before first, that were not looked at.
        doubtful: numbers of those that are not clear for certain, and have to be checked in full.
    """

    candidate: int
    good: PathFeasibility
    before: Array
    after: Array
    unseen: np.ndarray
    doubtful: np.ndarray


class PathSearch(NamedTuple):
    """A search in the making.

    Attributes:
        start, q: where the tool is led from, and the configuration (n,) [rad].
        queue: candidates whose paths were not rolled out, best first.
        paths: those that can be followed and are not judged, best first.
        best, taken: what the best path so far counts, and its candidate.
    """

    start: Pose
    q: Array
    queue: tuple[int, ...]
    paths: tuple[RolledPath, ...] = ()
    best: PathFeasibility = PathFeasibility.INFEASIBLE
    taken: int | None = None

    @property
    def over(self) -> bool:
        """Whether nothing that is left could be better."""
        return self.best is PathFeasibility.FREE or not (self.queue or self.paths)

    def judged(self, found: PathFeasibility) -> PathSearch:
        """Return the search after the first of `paths` was found to count ``found``."""
        first, *rest = self.paths
        better = found < self.best
        return self._replace(
            paths=tuple(rest),
            best=found if better else self.best,
            taken=first.candidate if better else self.taken,
        )


def advanced(search: PathSearch, scene: SearchScene) -> PathSearch:
    """Return the search after a bounded piece of work; the same where it is over."""
    if search.over:
        return search
    if not search.paths:
        return _rolled_out(search, scene)
    first = search.paths[0]
    if first.good >= search.best:
        # Even if it is free, it is no better than what there is.
        return advanced(search.judged(PathFeasibility.INFEASIBLE), scene)
    if scene.clear is None:
        return search.judged(first.good)
    if not isinstance(scene.clear, ScreenedCheck):
        return _checked_in_pairs(search, first, scene, scene.clear)
    return _screened(search, first, scene, scene.clear)


def _rolled_out(search: PathSearch, scene: SearchScene) -> PathSearch:
    """Roll out paths, best first, until some can be followed or `LEGS_AT_ONCE` is reached."""
    queue, paths, left = search.queue, list[RolledPath](), LEGS_AT_ONCE
    settings = scene.approach
    while queue and not paths and left >= min(len(queue), PATHS):
        some, queue = queue[: min(PATHS, left)], queue[min(PATHS, left) :]
        targets = [scene.target_of(candidate) for candidate in some]
        waypoints = [grasp_path(settings, search.start, one.X_WP, one.X_WG)[1:] for one in targets]
        found = path_rollout(
            scene.robot,
            search.q,
            search.start,
            [Pose.stack(leg) for leg in zip(*waypoints, strict=True)],
            speed=settings.speed,
            angular_speed=settings.angular_speed,
        )
        left -= found.rolled
        speeds = zip(some, found.completed.tolist(), found.speed.tolist(), found.legs, strict=True)
        paths += [_rolled_path(candidate, speed, legs) for candidate, completed, speed, legs in speeds if completed]
    return search._replace(queue=queue, paths=tuple(paths))


def _rolled_path(candidate: int, speed: float, legs: tuple[Array, ...]) -> RolledPath:
    good = PathFeasibility.FREE if speed <= SPEED_LIMIT_SHARE else PathFeasibility.SPEED_LIMITED
    before, after = legs[0], np.concatenate(legs[1:])
    return RolledPath(candidate, good, before, after, coarse_first(len(before) + len(after)), _NONE)


def _screened(search: PathSearch, first: RolledPath, scene: SearchScene, clear: ScreenedCheck) -> PathSearch:
    """Check some configurations that are in doubt; without any, look at more of them."""
    name = scene.candidates.object_names[int(scene.candidates.object_index[first.candidate])]
    screens = not len(first.doubtful)
    some = first.unseen[:SCREENED] if screens else first.doubtful[:CHECKED]
    names = np.where(some < len(first.before), "", name)
    q = np.concatenate([first.before, first.after])[some]
    if screens:
        doubtful = some[~np.asarray(clear.certainly_clear(q, names), dtype=bool)]
        first = first._replace(unseen=first.unseen[SCREENED:], doubtful=doubtful)
    elif np.all(clear.clear(q, names)):
        first = first._replace(doubtful=first.doubtful[CHECKED:])
    else:
        return search.judged(PathFeasibility.COLLIDING)
    return _after(search, first)


def _checked_in_pairs(search: PathSearch, first: RolledPath, scene: SearchScene, clear: ClearRows) -> PathSearch:
    """Check some rows of a configuration before the pre-grasp and one after it; the shorter part ends repeated."""
    count = max(len(first.before), len(first.after))
    unseen = first.unseen[first.unseen < count]
    some = unseen[:CHECKED]
    before, after = (part[np.minimum(some, len(part) - 1)] for part in (first.before, first.after))
    if not np.all(clear(after, before, scene.candidates.select(np.full(len(some), first.candidate)))):
        return search.judged(PathFeasibility.COLLIDING)
    return _after(search, first._replace(unseen=unseen[CHECKED:]))


def _after(search: PathSearch, first: RolledPath) -> PathSearch:
    if len(first.unseen) or len(first.doubtful):
        return search._replace(paths=(first, *search.paths[1:]))
    return search.judged(first.good)


_NONE = np.zeros(0, dtype=np.int64)
_NONE.flags.writeable = False


@lru_cache(maxsize=256)
def coarse_first(count: int) -> np.ndarray:
    """Return the numbers below ``count`` (count,), the ends and the middle first and then ever closer ones.

    What touches something mostly does so over a stretch, which is met soon in this order.
    """
    order = dict.fromkeys([0, count - 1] if count else [])
    step = count
    while len(order) < count:
        step = max(1, step // 2)
        order.update(dict.fromkeys(range(0, count, step)))
    numbers = np.fromiter(order, dtype=np.int64, count=count)
    numbers.flags.writeable = False
    return numbers
