"""Compiled kernels against CasADi's virtual machine: the same operations, so the same results to rounding."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from optsc.collision import CollisionModel
from optsc.collision.capsules import link_capsules
from optsc.collision.clearance import ends_over_table, self_pairs
from optsc.collision.kernels.clearance import BOX, clearance
from optsc.geometry.rotation import Array
from optsc.kernels.chain import kinematics
from optsc.kernels.kernel import Kernel, build_kernel
from optsc.kernels.manipulability import penalised_product
from optsc.kernels.rollout import rollout
from optsc.kernels.search import STARTS, search
from optsc.robot.model import RobotModel

DRAWS = 30
"""Inputs that are compared."""
REPEATS = 5
"""Times that all of them are evaluated; the quickest counts."""

Inputs = Callable[[np.random.Generator], "list[Array | float]"]


class KernelComparison(NamedTuple):
    """A kernel, compiled and interpreted.

    Attributes:
        name: what it does.
        compiled: whether there was a compiler; otherwise both are interpreted.
        difference: largest difference of any result.
        compiled_time, interpreted_time: of one evaluation [s].
    """

    name: str
    compiled: bool
    difference: float
    compiled_time: float
    interpreted_time: float

    @property
    def ratio(self) -> float:
        """How many times longer the virtual machine takes."""
        return self.interpreted_time / self.compiled_time


def compare(name: str, function: Any, inputs: Inputs, rng: np.random.Generator) -> KernelComparison:
    """Return how a CasADi function does compiled and interpreted on the same random ``inputs``."""
    kernels = build_kernel(function), Kernel(function, compiled=False)
    draws = [[np.atleast_1d(value) for value in inputs(rng)] for _ in range(DRAWS)]
    results = [[kernel(*arrays) for arrays in draws] for kernel in kernels]
    difference = max(
        float(np.max(np.abs(a - b), initial=0.0))
        for one, other in zip(*results, strict=True)
        for a, b in zip(one, other, strict=True)
    )
    quick, slow = (_time(kernel, draws) for kernel in kernels)
    return KernelComparison(name, kernels[0].compiled, difference, quick, slow)


def _time(kernel: Kernel, draws: Sequence[Sequence[Array]]) -> float:
    """Return the time of one evaluation [s], without filling the buffers."""
    least = np.inf
    for _ in range(REPEATS):
        total = 0.0
        for arrays in draws:
            for buffer, value in zip(kernel.inputs, arrays, strict=True):
                buffer[...] = value
            before = time.perf_counter()
            kernel.run()
            total += time.perf_counter() - before
        least = min(least, total / len(draws))
    return float(least)


def compare_kernels(robot: RobotModel, rng: np.random.Generator) -> tuple[KernelComparison, ...]:
    """Return the comparison of an arm's kernels: kinematics, manipulability, IK, a straight line, clearance."""
    n, limits = robot.n, np.concatenate(robot.limits.positions)
    pairs, hulls = self_pairs(robot, CollisionModel(robot).capsule_pairs), link_capsules(robot, True)
    over = ends_over_table(robot)
    near = clearance(robot.chain, link_capsules(robot), hulls, pairs.informative, pairs.close, over, 4)
    product = penalised_product(robot.chain, robot.limits.positions, "tsai")

    def pose_to_reach(rng: np.random.Generator) -> list[Array | float]:
        X_WT = robot.forward(robot.random_configuration(rng))
        starts = robot.random_configuration(rng, (STARTS,)).T
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

    cases: list[tuple[str, Any, Inputs]] = [
        ("kinematics and Jacobian", kinematics(robot.chain), lambda rng: [robot.random_configuration(rng)]),
        ("penalised manipulability", product, lambda rng: [robot.random_configuration(rng), 5.0]),
        ("inverse kinematics, two starts", search(robot.chain), pose_to_reach),
        (f"straight line of {n} joints, 20 steps", rollout(robot.chain), line),
        ("clearance", near, scene),
    ]
    return tuple(compare(name, function, inputs, rng) for name, function, inputs in cases)
