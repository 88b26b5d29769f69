"""Building blocks of CasADi functions: inputs by name, and branches that are really jumped over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi


def symbols(kind: Any, **sizes: int | tuple[int, int]) -> list[Any]:
    """Return one symbol of ``kind``, `casadi.SX` or `casadi.MX`, for each name, in order."""
    return [kind.sym(name, *((size,) if isinstance(size, int) else size)) for name, size in sizes.items()]


def inputs_like(function: casadi.Function) -> list[casadi.MX]:
    """Return symbols of the sizes of a function's inputs."""
    return [casadi.MX.sym(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())]


def only_if(
    function: casadi.Function, inputs: Sequence[Any] | None = None, otherwise: Sequence[Any] | None = None
) -> casadi.Function:
    """Return (condition, *inputs) -> what ``function`` returns where the condition holds, else ``otherwise``.

    Args:
        function: evaluated on demand.
        inputs: symbols that ``otherwise`` is written in; by default new ones.
        otherwise: expressions that stand for the outputs; by default the first input.
    """
    inputs = inputs_like(function) if inputs is None else list(inputs)
    otherwise = [inputs[0]] if otherwise is None else list(otherwise)
    name = function.name()
    skipped = casadi.Function(f"{name}_skipped", inputs, otherwise)
    return casadi.Function.if_else(f"{name}_if", function, skipped)
