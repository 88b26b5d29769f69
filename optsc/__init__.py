"""Optimization-based shared control: a person's hand, a set of grasps, a robot's limits and an optimizer in one loop.

Everything here is loaded when it is first used, so that importing the library costs next to nothing.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_WHERE = {
    "Approach": "optsc.control.approach",
    "Cascade": "optsc.selection",
    "ClutchSettings": "optsc.operators",
    "GraspLibrary": "optsc.grasps",
    "GraspSelector": "optsc.control.selecting",
    "Hysteresis": "optsc.selection",
    "IdealFollower": "optsc.followers",
    "Manipulability": "optsc.robot.manipulability",
    "Mode": "optsc.control.modes",
    "OperatorSample": "optsc.operators",
    "OptscError": "optsc.errors",
    "Pose": "optsc.geometry",
    "PyBulletFollower": "optsc.followers",
    "RobotModel": "optsc.robot",
    "Run": "optsc.records",
    "Servo": "optsc.control.servo",
    "ServoSettings": "optsc.control.servo",
    "SharedController": "optsc.control.controller",
    "Slerp": "optsc.operators",
    "Status": "optsc.control.servo",
    "WeightedSum": "optsc.selection",
    "build_library": "optsc.grasps",
    "load_robot": "optsc.robot",
    "make_policy": "optsc.control.arbitration",
    "replay": "optsc.session",
    "run": "optsc.session",
    "solve_ik": "optsc.ik.batch",
}
_ROOMS = ("ik", "metrics", "operators", "perception", "sim")

__all__ = [
    "Approach",
    "Cascade",
    "ClutchSettings",
    "GraspLibrary",
    "GraspSelector",
    "Hysteresis",
    "IdealFollower",
    "Manipulability",
    "Mode",
    "OperatorSample",
    "OptscError",
    "Pose",
    "PyBulletFollower",
    "RobotModel",
    "Run",
    "Servo",
    "ServoSettings",
    "SharedController",
    "Slerp",
    "Status",
    "WeightedSum",
    "build_library",
    "ik",
    "load_robot",
    "make_policy",
    "metrics",
    "operators",
    "perception",
    "replay",
    "run",
    "sim",
    "solve_ik",
]


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f"optsc.{name}")
    if name in _WHERE:
        return getattr(importlib.import_module(_WHERE[name]), name)
    raise AttributeError(f"module 'optsc' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
