"""Compiled kernels against CasADi's virtual machine: the same operations, so the same results to rounding."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import casadi
import numpy as np

from optsc.geometry.rotation import Array
from optsc.kernels.kernel import Kernel, build_kernel

DRAWS = 30
"""Inputs that are compared."""
REPEATS = 5
"""Times that all of them are evaluated; the quickest counts."""

Inputs = Callable[[np.random.Generator], "list[Array | float]"]


class KernelComparison(NamedTuple):
    """A kernel both ways.

    Attributes:
        name: what it does.
        compiled: whether there was a compiler; otherwise both ways are the same one.
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


def compare(
    name: str, function: casadi.Function, inputs: Inputs, rng: np.random.Generator
) -> KernelComparison:
    """Return how a function does both ways on the same random ``inputs``."""
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
