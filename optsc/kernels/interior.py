"""The unconstrained minimum of a quadratic program, and whether its bounds hold it: then it is the solution."""

from __future__ import annotations

import casadi

from optsc.kernels.symbols import symbols


def interior_minimum(n: int) -> casadi.Function:
    """Return the function (H, g, lower, upper) -> x, inside.

    ``x`` (n) minimises 1/2 x'Hx + g'x for a symmetric positive definite H (n, n), by LDL'; ``inside`` is one where
    lower <= x <= upper, so that no bound is needed, and zero otherwise, also where H is not positive definite or
    something is not finite.
    """
    inputs = symbols(casadi.SX, H=(n, n), g=n, lower=n, upper=n)
    H, g, lower, upper = inputs
    D, L, order = casadi.ldl(H, False)
    x = casadi.ldl_solve(-g, D, L, order)
    inside = casadi.SX(1)
    for i in range(n):
        held = casadi.logic_and(x[i] >= lower[i], x[i] <= upper[i])
        inside = casadi.logic_and(inside, casadi.logic_and(held, D[i] > 0))
    return casadi.Function("interior_minimum", inputs, [casadi.densify(x), inside])
