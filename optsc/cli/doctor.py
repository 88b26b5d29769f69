"""``optsc doctor``: what this machine has, and what that means."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
from pathlib import Path
from typing import Any

_PACKAGES = ("numpy", "pin", "casadi", "proxsuite", "qpsolvers", "daqp", "ruckig", "pybullet", "matplotlib")


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "doctor",
        help="tell what this machine has, and what that means",
        epilog="example: optsc doctor",
    )
    parser.add_argument(
        "--state-machine",
        type=Path,
        metavar="FILE",
        help="write the page of the state machine to FILE instead",
    )
    parser.add_argument("--robot", default="panda", help="arm whose kernels are compared (default: panda)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print versions, compiler, solvers and display."""
    if options.state_machine is not None:
        from optsc.control.modes import markdown

        options.state_machine.write_text(markdown())
        return 0
    import optsc
    from optsc.cache import cache_directory
    from optsc.ik import solver_names
    from optsc.kernels.build import compiler

    print(f"optsc {optsc.__version__} on Python {platform.python_version()}, {platform.system()} {platform.machine()}")
    for package in _PACKAGES:
        try:
            print(f"  {package:<12} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            print(f"  {package:<12} missing")
    command = compiler()
    print(f"compiler: {command or 'none: kernels run in the virtual machine of CasADi, some ten times slower'}")
    _print_kernels(options.robot)
    print(f"QP solvers: {', '.join(solver_names())}")
    display = os.environ.get("DISPLAY")
    print(f"display: {display or 'none: demo and pictures run headless, --gui does not'}")
    print(f"cache: {cache_directory()}")
    return 0


def _print_kernels(robot_name: str) -> None:
    """Print what compiling the kernels of an arm changes: nothing in the results, and a lot in time."""
    import numpy as np

    from optsc.cli.kernel_comparison import compare_kernels
    from optsc.robot import load_robot

    found = compare_kernels(load_robot(robot_name), np.random.default_rng(0))
    if not all(one.compiled for one in found):
        print(f"kernels of the {robot_name}: interpreted")
        for one in found:
            print(f"  {one.name:<36} {1e6 * one.interpreted_time:9.2f} us")
        return
    print(f"kernels of the {robot_name}: compiled, and in the virtual machine of CasADi")
    for one in found:
        print(
            f"  {one.name:<36} {1e6 * one.compiled_time:9.2f} us {1e6 * one.interpreted_time:9.2f} us, "
            f"{one.ratio:4.1f} times; results differ by {one.difference:.0e} at most"
        )
