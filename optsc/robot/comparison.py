"""The kernels of an arm, compiled against interpreted."""

from __future__ import annotations

import numpy as np

from optsc.geometry.rotation import Array
from optsc.kernels.chain import kinematics
from optsc.kernels.clearance import BOX, clearance
from optsc.kernels.comparison import KernelComparison, compare
from optsc.kernels.manipulability import penalised_product
from optsc.kernels.rollout import rollout
from optsc.kernels.search import STARTS, search
from optsc.robot.capsules import link_capsules
from optsc.robot.clearance import ends_over_table, self_pairs
from optsc.robot.collision import CollisionModel
from optsc.robot.model import RobotModel


def compare_kernels(robot: RobotModel, rng: np.random.Generator) -> tuple[KernelComparison, ...]:
    """Return the comparison of an arm's kernels: kinematics, manipulability, IK, a straight way, clearance."""
    n, limits = robot.n, np.concatenate([robot.limits.lower, robot.limits.upper])
    pairs, hulls = self_pairs(robot, CollisionModel(robot).capsule_pairs), link_capsules(robot, True)
    over = ends_over_table(robot)
    near = clearance(robot.chain, link_capsules(robot), hulls, pairs.telling, pairs.close, over, 4)

    def posture(rng: np.random.Generator) -> list[Array | float]:
        return [robot.random_configuration(rng)]

    def pose_to_reach(rng: np.random.Generator) -> list[Array | float]:
        X_WT, starts = (
            robot.forward(robot.random_configuration(rng)),
            robot.random_configuration(rng, (STARTS,)).T,
        )
        best = np.concatenate([robot.home, [np.inf, 0.0, 0.0]])
        target = np.concatenate([X_WT.quaternion, X_WT.translation, [1e-5]])
        return [best, target, robot.home, starts, 2.0, limits, limits]

    def line(rng: np.random.Generator) -> list[Array | float]:
        X_WT = robot.forward(robot.home)
        numbers = np.concatenate([X_WT.quaternion, X_WT.translation, rng.uniform(-0.1, 0.1, 6)])
        return [robot.home, numbers, 20.0, 0.15, limits, robot.limits.velocity]

    def scene(rng: np.random.Generator) -> list[Array | float]:
        boxes = np.tile(np.concatenate([np.eye(3).ravel(), np.zeros(3), np.full(3, 0.05)])[:, None], 4)
        boxes[9:12] = rng.uniform(-0.6, 0.6, (3, 4))
        return [robot.random_configuration(rng), 0.2, 0.0, boxes.reshape(BOX, 4)]

    return (
        compare("kinematics and Jacobian", kinematics(robot.chain), posture, rng),
        compare(
            "penalised manipulability",
            penalised_product(robot.chain, robot.limits.positions, "tsai"),
            lambda rng: [robot.random_configuration(rng), 5.0],
            rng,
        ),
        compare("inverse kinematics, two starts", search(robot.chain), pose_to_reach, rng),
        compare(f"straight line of {n} joints, 20 steps", rollout(robot.chain), line, rng),
        compare("clearance", near, scene, rng),
    )
