"""Inverse kinematics: one tick as a quadratic program, and whole poses in batches."""

from optsc.ik.differential import DifferentialIK, IkSettings, IkStep
from optsc.ik.solvers import QpSolution, QpSolver, Rows, make_solver, solver_names

__all__ = [
    "DifferentialIK",
    "IkSettings",
    "IkStep",
    "QpSolution",
    "QpSolver",
    "Rows",
    "make_solver",
    "solver_names",
]
