"""Every solver behind the one interface, on problems with a known answer and on hopeless ones."""

import numpy as np
import pytest

from optsc.errors import UnknownName
from optsc.ik import Rows, make_solver, solver_names

NAMES = [name for name in ("daqp", "proxqp", "quadprog", "osqp") if name in solver_names()]


@pytest.fixture(params=NAMES)
def solver(request):
    return make_solver(request.param)


def problem(seed, n=7):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    return A @ A.T + np.eye(n), rng.normal(size=n) * 5, -rng.uniform(0.1, 1, n), rng.uniform(0.1, 1, n)


def is_optimal(H, g, lower, upper, x, tolerance):
    """Karush-Kuhn-Tucker conditions of a box: the gradient points outwards exactly where x is at a bound."""
    gradient = H @ x + g
    at_lower, at_upper = x <= lower + tolerance, x >= upper - tolerance
    free = ~(at_lower | at_upper)
    scale = np.abs(H).max()
    return (
        np.all(x >= lower - tolerance)
        and np.all(x <= upper + tolerance)
        and np.all(np.abs(gradient[free]) <= tolerance * scale)
        and np.all(gradient[at_lower] >= -tolerance * scale)
        and np.all(gradient[at_upper] <= tolerance * scale)
    )


def test_solutions_meet_the_optimality_conditions(solver):
    tolerance = 1e-2 if solver.name == "osqp" else 1e-6
    for seed in range(20):
        H, g, lower, upper = problem(seed)
        solution = solver.solve(H, g, lower, upper)
        assert solution.solved, solution.reason
        assert is_optimal(H, g, lower, upper, solution.x, tolerance)


def test_rows_are_kept(solver):
    H, g, lower, upper = problem(1)
    rows = Rows(np.ones((1, 7)), np.array([-np.inf]), np.array([-0.5]))
    solution = solver.solve(H, g, lower, upper, rows)
    assert solution.solved
    assert solution.x.sum() <= -0.5 + 1e-3
    assert solver.solve(H, g, lower, upper).solved


def test_a_problem_that_is_not_finite_is_a_failure_with_a_reason(solver):
    H, g, lower, upper = problem(2)
    g[3] = np.nan
    solution = solver.solve(H, g, lower, upper)
    assert not solution.solved
    assert solver.name in solution.reason
    good = problem(3)
    assert solver.solve(*good).solved


def test_a_problem_without_a_solution_is_a_failure_with_a_reason(solver):
    H, g, lower, upper = problem(4)
    rows = Rows(np.eye(7)[:1], np.array([50.0]), np.array([60.0]))
    solution = solver.solve(H, g, lower, upper, rows)
    assert not solution.solved
    assert solution.reason


def test_an_unknown_solver_is_answered_with_those_there_are():
    with pytest.raises(UnknownName, match="daqp"):
        make_solver("abacus")
