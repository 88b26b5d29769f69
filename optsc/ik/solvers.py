"""Quadratic programs behind one interface: minimise 1/2 x'Hx + g'x within bounds and rows.

A solver never raises in the loop: anything but a solution comes back as a failure with its reason.
"""

from __future__ import annotations

from math import isfinite, isnan
from typing import Any, NamedTuple, Protocol

import numpy as np

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry.rotation import Array

ITERATION_LIMIT = 100
"""A tick's problem needs a handful; without a cap ProxQP spends minutes on an infeasible or non-finite one."""


AT_BOUND = 2e-6
"""How near to a bound [rad/s] an answer of ProxQP, which is accurate to some 1e-6, is at it."""
UNBOUNDED = 1e30
"""What all solvers take for no bound."""


class Rows(NamedTuple):
    """Linear constraints lower <= matrix x <= upper: matrix (m, n), lower and upper (m,).

    With a ``weight`` they are soft: missing them by s (m,) is allowed and adds weight s's / 2 to the cost. The bounds
    on x itself stay hard.
    """

    matrix: Array
    lower: Array
    upper: Array
    weight: float | None = None

    def met(self, x: Array) -> bool:
        """Tell whether x (n,) meets all of them."""
        value = self.matrix @ x
        return bool(((value >= self.lower) & (value <= self.upper)).all())


class QpSolution(NamedTuple):
    """Minimiser x (n,), whether it is one, how many iterations it took, and otherwise why not.

    ``slack`` is the most that any of the rows is missed by; above rounding only where they are soft.
    """

    x: Array
    solved: bool
    iterations: int
    reason: str = ""
    slack: float = 0.0


class QpSolver(Protocol):
    """Solves one problem per call.

    The answer follows from the problem alone, to the last bit: a solver that starts from its last solution would make a
    controller that goes on from a snapshot differ from one that went on before.
    """

    name: str

    def solve(self, H: Array, g: Array, lower: Array, upper: Array, rows: Rows | None = None) -> QpSolution:
        """Return the minimiser of 1/2 x'Hx + g'x with lower <= x <= upper and ``rows``; never raises."""
        ...


def usable_answer(answer: Any, n: int, name: str) -> QpSolution:
    """Return what a solver, which may be a user's, has answered to a problem of ``n`` variables, if it can be used.

    What is called solved and is not n finite numbers is a failure, with a reason.
    """
    solved, x = answer.solved, answer.x
    if not solved:
        return QpSolution(np.zeros(n), False, int(answer.iterations), str(answer.reason) or f"{name}: no solution")
    # Magnitudes carry what is not finite, and do not cancel.
    if type(x) is np.ndarray and x.dtype.char == "d" and x.shape == (n,) and sum(map(abs, x.tolist())) < UNBOUNDED:
        return answer
    return QpSolution(np.zeros(n), False, 0, f"{name} calls solved what is not {n} usable numbers")


def require_shapes(rows: Rows, n: int) -> None:
    """Raise `InvalidValue` for rows that are none on ``n`` variables."""
    matrix, lower, upper, _ = rows
    if matrix.shape[1:] != (n,) or not lower.shape == upper.shape == matrix.shape[:1]:
        shapes = matrix.shape, lower.shape, upper.shape
        raise InvalidValue("shapes of the rows of avoidance", shapes, f"(m, {n}), (m,), (m,)")


def require_numbers(rows: Rows) -> None:
    """Raise `InvalidValue` for rows that are no numbers: a solver may leave them out without a word."""
    # Sums carry what is not a number, and an infinite coefficient; a bound may be infinite.
    sums = (float(np.add.reduce(part, axis=None)) for part in rows[:3])
    if not isfinite(next(sums)) or any(map(isnan, sums)):
        raise InvalidValue("rows of avoidance", "not finite", "numbers")


def solve_soft(
    solver: QpSolver, H: Array, g: Array, lower: Array, upper: Array, rows: Rows, weight: float
) -> QpSolution:
    """Return the minimiser with soft rows: the same problem with one variable more for each row.

    The added variables are the slacks times the root of the weight, so that they count one in the cost and the
    problem stays well conditioned.
    """
    n, m = len(g), len(rows.lower)
    wide_H, wide_matrix = np.zeros((n + m, n + m)), np.zeros((m, n + m))
    wide_H[:n, :n] = H
    wide_matrix[:, :n] = rows.matrix
    index = np.arange(m)
    wide_H[n + index, n + index] = 1.0
    wide_matrix[index, n + index] = weight**-0.5
    wide_g, ends = np.zeros(n + m), np.empty((2, n + m))
    wide_g[:n] = g
    ends[0, :n], ends[1, :n], ends[0, n:], ends[1, n:] = lower, upper, -UNBOUNDED, UNBOUNDED
    solution = solver.solve(wide_H, wide_g, ends[0], ends[1], Rows(wide_matrix, rows.lower, rows.upper))
    x = solution.x[:n]
    value = rows.matrix @ x
    slack = float(np.maximum(rows.lower - value, value - rows.upper).max(initial=0.0))
    return solution._replace(x=x, slack=slack)


class DaqpSolver:
    """DAQP, a dual active-set method, called without an interface between: the quickest for an arm's few variables."""

    def __init__(self) -> None:
        import daqp

        self.name = "daqp"
        self._solve = daqp.solve
        self._no_rows: dict[int, Array] = {}

    def solve(self, H: Array, g: Array, lower: Array, upper: Array, rows: Rows | None = None) -> QpSolution:
        """Return the minimiser; see `QpSolver`."""
        if rows is not None and rows.weight is not None:
            return solve_soft(self, H, g, lower, upper, rows, rows.weight)
        n = len(g)
        if rows is None:
            matrix = self._no_rows.setdefault(n, np.zeros((0, n)))
        else:
            matrix = np.ascontiguousarray(rows.matrix)
            lower, upper = np.concatenate([lower, rows.lower]), np.concatenate([upper, rows.upper])
        x, _, flag, info = self._solve(H, g, matrix, upper, lower, primal_tol=1e-9, iter_limit=ITERATION_LIMIT)
        if flag == 1 and x[0] == x[0]:
            return QpSolution(x, True, info["iterations"])
        return QpSolution(np.zeros(n), False, info["iterations"], f"daqp: exit flag {flag}")


class ProxQpSolver:
    """ProxQP, each problem from the beginning.

    Started from the last solution it would take some 0.7 of the time, but its answer would then depend on the problem
    before.
    """

    def __init__(self) -> None:
        import proxsuite

        self.name = "proxqp"
        self._proxqp = proxsuite.proxqp

    def solve(self, H: Array, g: Array, lower: Array, upper: Array, rows: Rows | None = None) -> QpSolution:
        """Return the minimiser; see `QpSolver`."""
        if rows is not None and rows.weight is not None:
            return solve_soft(self, H, g, lower, upper, rows, rows.weight)
        n, m = len(g), 0 if rows is None else len(rows.lower)
        if not np.isfinite(H.sum() + g.sum() + lower.sum() + upper.sum()):
            return QpSolution(np.zeros(n), False, 0, "proxqp: the problem is not finite")
        C, c_low, c_high = (None, None, None) if rows is None else (rows.matrix, rows.lower, rows.upper)
        problem = self._proxqp.dense.QP(n, 0, m, True)
        problem.settings.eps_abs, problem.settings.eps_rel = 1e-9, 0.0
        problem.settings.max_iter = problem.settings.max_iter_in = ITERATION_LIMIT
        problem.settings.initial_guess = self._proxqp.InitialGuess.NO_INITIAL_GUESS
        # By the residuals alone a problem with soft rows counts as solved up to 2e-3 rad/s from its solution.
        problem.settings.check_duality_gap = True
        problem.settings.eps_duality_gap_abs, problem.settings.eps_duality_gap_rel = 1e-6, 0.0
        problem.init(H, g, None, None, C, c_low, c_high, lower, upper)
        problem.solve()
        info = problem.results.info
        if info.status == self._proxqp.PROXQP_SOLVED:
            x = np.array(problem.results.x)
            # What a bound holds is at it exactly: by that the servo tells which limit a joint is at.
            x = np.where(x < lower + AT_BOUND, lower, np.where(x > upper - AT_BOUND, upper, x))
            return QpSolution(x, True, int(info.iter))
        return QpSolution(np.zeros(n), False, int(info.iter), f"proxqp: {info.status}")


class QpSolversBackend:
    """Any solver that qpsolvers finds installed, by its name there."""

    def __init__(self, name: str) -> None:
        import qpsolvers

        if name not in qpsolvers.available_solvers:
            raise UnknownName("QP solver", name, solver_names())
        self.name = name
        self._qpsolvers = qpsolvers

    def solve(self, H: Array, g: Array, lower: Array, upper: Array, rows: Rows | None = None) -> QpSolution:
        """Return the minimiser; see `QpSolver`."""
        if rows is not None and rows.weight is not None:
            return solve_soft(self, H, g, lower, upper, rows, rows.weight)
        G, h = None, None
        if rows is not None:
            h = np.concatenate([rows.upper, -rows.lower])
            bounded = h < UNBOUNDED
            G, h = np.vstack([rows.matrix, -rows.matrix])[bounded], h[bounded]
        if not np.isfinite(H.sum() + g.sum() + lower.sum() + upper.sum()):
            return QpSolution(np.zeros(len(g)), False, 0, f"{self.name}: the problem is not finite")
        problem = self._qpsolvers.Problem(np.asarray(H), g, G, h, None, None, lower, upper)
        try:
            solution = self._qpsolvers.solve_problem(problem, solver=self.name)
        # Backends raise types of their own for a failed problem; in the loop every one of them means "no solution".
        except (self._qpsolvers.exceptions.QPError, ValueError, ArithmeticError, RuntimeError) as error:
            return QpSolution(np.zeros(len(g)), False, 0, f"{self.name}: {error}")
        if not solution.found or solution.x is None:
            return QpSolution(np.zeros(len(g)), False, 0, f"{self.name}: no solution")
        return QpSolution(np.asarray(solution.x, dtype=float), True, 0)


def solver_names() -> tuple[str, ...]:
    """Return the names that `make_solver` accepts on this machine."""
    import qpsolvers

    return tuple(sorted({"daqp", "proxqp", *qpsolvers.available_solvers}))


def make_solver(name: str = "daqp") -> QpSolver:
    """Return a solver: ``daqp`` and ``proxqp`` directly, every other through qpsolvers; raise `UnknownName`."""
    if name == "daqp":
        return DaqpSolver()
    if name == "proxqp":
        return ProxQpSolver()
    return QpSolversBackend(name)
