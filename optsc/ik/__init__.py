"""Inverse kinematics: one tick as a quadratic program, and whole poses in batches."""

from optsc.ik.avoidance import Avoidance, Nearness
from optsc.ik.differential import DifferentialIK, IkSettings, IkStep, ramp_time, tool_braking
from optsc.ik.solvers import QpSolution, QpSolver, Rows, make_solver, solver_names

__all__ = [
    "Avoidance",
    "DifferentialIK",
    "IkSettings",
    "IkStep",
    "Nearness",
    "QpSolution",
    "QpSolver",
    "Rows",
    "make_solver",
    "ramp_time",
    "solver_names",
    "tool_braking",
]
