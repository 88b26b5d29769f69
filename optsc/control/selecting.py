"""The grasp selector with this library's inverse kinematics built in: selection and IK meet here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from optsc import selection
from optsc.geometry import Pose
from optsc.geometry.rotation import Array
from optsc.ik.batch import solve_ik
from optsc.robot import RobotModel
from optsc.robot.manipulability import Manipulability
from optsc.selection import GraspFilter, Hysteresis, Rule, StraightMotion

RESTARTS = 0
"""A grasp has to be reached from the present posture: the arm goes there on a straight line, in the branch it is in."""


class GraspSelector(selection.GraspSelector):
    """`optsc.selection.GraspSelector` that solves the reach of its candidates with `optsc.solve_ik`."""

    def __init__(
        self,
        robot: RobotModel,
        rule: Rule | None = None,
        manipulability: Manipulability | None = None,
        *,
        standoff: float = 0.1,
        filters: Sequence[GraspFilter] = (),
        hysteresis: Hysteresis | None = None,
        speed: float = 0.1,
        angular_speed: float = 0.5,
    ) -> None:
        """Make a selector without candidates.

        Args:
            robot: the arm.
            rule: how candidates are ranked; by default the paper's cascade.
            manipulability: the measure M; by default Yoshikawa's index times the normalised joint limit penalty.
            standoff: distance from the pre-grasp to the grasp along the approach axis [m].
            filters: which candidates may be ranked, besides reachability.
            hysteresis: how far hand and arm move before the ranking takes notice; None, as in the paper, for at once.
            speed, angular_speed: of the tool on the approach [m/s, rad/s], by which straight ways are judged.
        """

        def solve(X_WT: Pose, seeds: Array) -> tuple[Array, np.ndarray]:
            solutions = solve_ik(robot, X_WT, rng=np.random.default_rng(0), seeds=seeds, restarts=RESTARTS)
            return solutions.q, solutions.success

        # What a single pose needs is built now, not in the middle of a control tick.
        solve(robot.forward(robot.home[None]), robot.home)
        super().__init__(
            robot,
            rule,
            manipulability,
            solve=solve,
            standoff=standoff,
            filters=filters,
            hysteresis=hysteresis,
            motion=StraightMotion(robot, speed, angular_speed),
        )
