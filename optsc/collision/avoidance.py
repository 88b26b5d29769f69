"""Collision avoidance as rows of the quadratic program: no distance falls faster than the arm can brake.

Rows are soft and the joints' own bounds are hard: an arm that is too near already is led out gently, and a problem
without any solution cannot arise. A row says nothing about motion that makes its distance grow, so moving away
is always free.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import AtLeast, Checked, Positive, Range
from optsc.collision.distances import DistanceModel, DistanceRows
from optsc.collision.kernels.rows import RowSettings
from optsc.collision.obstacles import Obstacles
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.ik.avoidance import Nearness
from optsc.ik.differential import ramp_time
from optsc.ik.solvers import QpSolver, Rows
from optsc.robot.limits import JointLimits
from optsc.robot.model import RobotModel

ACTIVE = 1e-4
"""A row within this rate [m/s] of its bound holds the motion back."""
LEAST_DELAY = 0.05
"""Delay [s] of arms that ramp their accelerations quickly (tuned here)."""
RAMPS = 3.0
"""Delay of the others, in units of the time that they take for it (tuned here)."""


@dataclass(frozen=True)
class AvoidanceSettings(Checked):
    """How near the arm may come to things, and how fast.

    Attributes:
        margin: distance that is kept [m]; less between links that are nearer to each other at home.
        braking: share of the deceleration that the joints have together that braking counts on [1].
        most_braking: deceleration at most that is counted on [m/s^2].
        delay: time constant of coming to rest at the margin [s]; covers the delay by jerk limits. By default it follows
            from them: `RAMPS` times what the slowest joint takes to ramp up its acceleration, `LEAST_DELAY` at least.
        push: speed at most of being led out of the margin [m/s].
        weight: of missing a row, against the weights of the tool's task [s^2/m^2].
        most_rows: rows at most in one tick, those in greatest need.
        boxes: boxes at most that stand for one obstacle.
    """

    margin: Annotated[float, Range("0 to 1", 0.0, 1.0, open_high=True)] = 0.01
    braking: Annotated[float, Positive] = 0.4
    most_braking: Annotated[float, Positive] = 3.0
    delay: Annotated[float | None, Positive] = None
    push: Annotated[float, Positive] = 0.1
    weight: Annotated[float, Positive] = 1e5
    most_rows: Annotated[int, AtLeast(1)] = 16
    boxes: Annotated[int, AtLeast(1)] = 4

    def delay_of(self, limits: JointLimits) -> float:
        """Return the delay [s] that is counted on with joints of ``limits``."""
        return max(LEAST_DELAY, RAMPS * ramp_time(limits)) if self.delay is None else self.delay


class CollisionAvoidance:
    """Keeps an arm clear of the table, of named obstacles and of itself.

    Args:
        robot: the arm.
        obstacles: shape and pose X_WO of everything that must not be touched, by name; move them with `move`.
        table_height: z of the table top [m]; None for no table.
        settings: how near and how fast.

    Raises:
        InvalidValue: an obstacle called "table", or a part without volume.
        DamagedFile: the robot's collision geometry cannot be read.
    """

    def __init__(
        self,
        robot: RobotModel,
        obstacles: Obstacles | None = None,
        table_height: float | None = 0.0,
        settings: AvoidanceSettings | None = None,
    ) -> None:
        s = self.settings = settings or AvoidanceSettings()
        self.model = DistanceModel(robot, obstacles, table_height, s.margin, s.boxes)
        values = self.model.settings
        values[RowSettings.BRAKING] = s.braking
        values[RowSettings.MOST_BRAKING] = s.most_braking
        values[RowSettings.DELAY], values[RowSettings.PUSH] = s.delay_of(robot.limits), s.push
        self._near: DistanceRows | None = None

    @property
    def obstacles(self) -> frozenset[str]:
        """Names of the obstacles."""
        return self.model.obstacle_names

    def move(self, name: str, X_WO: Pose, twist: ArrayLike | None = None) -> None:
        """Place an obstacle, moving with ``twist`` (6,) in W; see `DistanceModel.move`."""
        self.model.move(name, X_WO, twist)

    def hand_may_touch(self, *names: str | None) -> None:
        """Let the hand touch these obstacles from now on and no others, such as one that it is about to grasp.

        The hand is every link after the last joint. Links of the arm keep clear of these obstacles as before. None is
        no obstacle: ``hand_may_touch(None)`` and ``hand_may_touch()`` let it touch nothing. Raises `UnknownName`.
        """
        self.model.hand_may_touch(*(name for name in names if name is not None))

    def snapshot(self) -> Array:
        """Return where the obstacles are, how they move, and which of them the hand may touch, for `restore`."""
        return self.model.obstacles.copy()

    def restore(self, obstacles: Array) -> None:
        """Put back what `snapshot` returned."""
        self.model.obstacles[:] = obstacles

    def rows(self, q: Array, lowest: Array, highest: Array) -> Rows | None:
        """Return the rows on the joint velocity of the next tick, which has the bounds given (n,) [rad/s]."""
        near = self._near = self.model.rows(q, lowest, highest, self.settings.most_rows)
        if not len(near.pair):
            return None
        return Rows(near.gradient, near.lower, np.full(len(near.pair), np.inf), self.settings.weight)

    def stopping(self, q: Array, lowest: Array, highest: Array, solver: QpSolver) -> Array:
        """Return the velocity (n,) to brake to at this tick: rest, or the nearest to it that leads nowhere too fast.

        Joints that brake one by one do not stay on their common path, which may lead them towards something.
        """
        rows = self.rows(q, lowest, highest)
        rest = np.zeros(len(q))
        if rows is None:
            return rest
        rows = rows._replace(lower=np.minimum(rows.lower, 0.0))  # a stop pushes nothing out
        next_to_rest = np.minimum(np.maximum(rest, lowest), highest)
        if (rows.matrix @ next_to_rest >= rows.lower).all():
            return rest
        solution = solver.solve(np.eye(len(q)), -next_to_rest, lowest, highest, rows)
        return np.minimum(np.maximum(solution.x, lowest), highest) if solution.solved else rest

    def blocking(self, velocity: Array) -> Nearness | None:
        """Return the nearest pair whose row, of the last `rows`, holds this velocity (n,) back, if any does."""
        near = self._near
        if near is None or not len(near.pair):
            return None
        active = np.flatnonzero(near.gradient @ velocity <= near.lower + ACTIVE)
        if not len(active):
            return None
        row = int(active[np.argmin(near.distance[active])])
        pair = self.model.pairs[int(near.pair[row])]
        return Nearness(pair.link, pair.other, float(near.distance[row]))
