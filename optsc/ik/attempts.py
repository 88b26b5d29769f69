"""Attempts at the poses of a call: from seeds, from the nearest of random starts, and without limits."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from optsc.geometry.rotation import Array
from optsc.ik.arm import ArmSearch, features
from optsc.kernels.search import STARTS

FIRST_STARTS = 3 * STARTS
"""Starts from the fixed first table, before others are drawn."""
LIMIT_PROBES = 16
"""Attempts without limits, which tell poses behind the limits from poses out of reach. They are other starts than those
tried before, because where limits play no part the same ones would fail alike."""


class IkStatus(IntEnum):
    """What became of a pose; `IkSolutions.reason` says it in words."""

    SOLVED = 0
    OUT_OF_REACH = 1
    """Further away than the arm is long, or no configuration was found even with the limits lifted."""
    JOINT_LIMITS = 2
    """With the limits lifted a configuration was found, within them none."""
    COLLISION = 3
    """There are configurations, and the given check refused all that were found."""
    NOT_FOUND = 4
    """The seeds do not lead there, and without restarts nothing else was tried."""


class PoseBatch:
    """The poses of one call, and the best configuration that was found for each so far.

    Attributes:
        arm: its search.
        targets: (N, 8) or (N, 13), as `optsc.kernels.search.search` takes them.
        seeds: (N, n), the configurations near which turning joints end.
        best: (N, n + 3): configuration, residual, success, iterations.
    """

    def __init__(self, arm: ArmSearch, targets: Array, seeds: Array) -> None:
        self.arm, self.targets, self.seeds = arm, targets, seeds
        self.best = np.tile(arm.nothing, (len(targets), 1))

    @property
    def q(self) -> Array:
        """The configurations (N, n)."""
        return self.best[:, : self.arm.n]

    @property
    def residual(self) -> Array:
        """The residuals (N,) of the configurations."""
        return self.best[:, self.arm.n]

    @property
    def success(self) -> NDArray[np.bool_]:
        """Which configurations (N,) are solutions."""
        return self.best[:, self.arm.n + 1] > 0.0

    @property
    def by_component(self) -> bool:
        """Whether there is a tolerance for each component."""
        return self.targets.shape[1] > 8

    def subset(self, index: NDArray[np.intp]) -> PoseBatch:
        """Return some of the poses, with what was found."""
        part = self.unsolved_subset(index)
        part.best = self.best[index]
        return part

    def unsolved_subset(self, index: NDArray[np.intp]) -> PoseBatch:
        """Return some of the poses, with nothing found."""
        return PoseBatch(self.arm, self.targets[index], self.seeds[index])

    def features(self) -> Array:
        """Return the features (N, ...) that starts should have."""
        return features(self.targets[:, :4], self.targets[:, 4:7], self.arm.folded(self.seeds))

    def attempt(self, starts: Array, shared: tuple[Array, Array] | None = None) -> None:
        """Try the starts (N, S, n) one after another, for the poses without success."""
        count, each, n = starts.shape
        kernel = self.arm.search_by_component if self.by_component else self.arm.search
        bounds = self.arm.shared if shared is None else shared
        for tried in range(0, each, STARTS):
            now = min(STARTS, each - tried)
            rows = np.zeros((count, STARTS * n))
            rows[:, : now * n] = starts[:, tried : tried + now].reshape(count, now * n)
            times = np.full((count, 1), float(now))
            (self.best,) = kernel(self.best, self.targets, self.seeds, rows, times, shared=bounds)

    def attempt_some(self, index: NDArray[np.intp], starts: Array) -> NDArray[np.intp]:
        """Try the starts (R, S, n) for the poses ``index`` (R,); return those that are still not solved."""
        part = self.subset(index)
        part.attempt(starts)
        self.best[index] = part.best
        return index[~part.success]


def restart(batch: PoseBatch, restarts: int, rng: np.random.Generator | None) -> NDArray[np.int8]:
    """Solve by other starts what the seeds left; return the statuses (N,)."""
    arm = batch.arm
    status = np.full(len(batch.best), IkStatus.NOT_FOUND, dtype=np.int8)
    if not batch.by_component:  # with room in orientation the last joint may be elsewhere
        excluded = arm.reach.excludes(batch.targets[:, :4], batch.targets[:, 4:7])
        status[excluded] = IkStatus.OUT_OF_REACH
    left, table, wanted = np.flatnonzero(status == IkStatus.NOT_FOUND), arm.first_table, batch.features()
    further = arm.further_tables(rng)
    for tried in range(0, restarts, STARTS):
        skip = tried
        if tried >= FIRST_STARTS and len(left):
            table, skip = next(further), 0
        near = table.nearest(wanted[left], skip + STARTS)[:, skip : skip + restarts - tried]
        left = batch.attempt_some(left, table.q[near])
        if not tried:
            status[left] = _without_limits(batch, left, wanted[left])
            # What has no configuration even without limits has none to look for.
            left = left[status[left] == IkStatus.JOINT_LIMITS]
        if not len(left):
            break
    status[batch.success] = IkStatus.SOLVED
    return status


def _without_limits(batch: PoseBatch, index: NDArray[np.intp], wanted: Array) -> NDArray[np.int8]:
    """Return why the poses ``index`` have no configuration yet: whether they have one when limits are ignored."""
    arm, free = batch.arm, batch.unsolved_subset(index)
    near = arm.first_table.nearest(wanted, STARTS + LIMIT_PROBES)[:, STARTS:]
    free.attempt(arm.first_table.q[near], arm.endless)
    behind = free.success
    # From a configuration outside the search may still lead inside; then the pose is solved after all.
    inside = np.clip(free.q[behind], arm.bounds[: arm.n], arm.bounds[arm.n :])
    batch.attempt_some(index[behind], inside[:, None])
    return np.where(behind, IkStatus.JOINT_LIMITS, IkStatus.OUT_OF_REACH).astype(np.int8)
