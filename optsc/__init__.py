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
    "OptscError": "optsc.errors",
    "Pose": "optsc.geometry",
    "PyBulletFollower": "optsc.followers",
    "RobotModel": "optsc.robot",
    "Run": "optsc.records",
    "Servo": "optsc.control.servo",
    "ServoSettings": "optsc.control.servo",
    "SharedController": "optsc.control.controller",
    "Status": "optsc.control.servo",
    "WeightedSum": "optsc.selection",
    "build_library": "optsc.grasps",
    "load_robot": "optsc.robot",
    "make_policy": "optsc.control.arbitration",
    "replay": "optsc.session",
    "run": "optsc.session",
    "solve_ik": "optsc.ik.batch",
}
_ROOMS = (
    *(
        "checks",
        "control",
        "errors",
        "followers",
        "geometry",
        "grasps",
        "ik",
        "metrics",
        "operators",
        "perception",
    ),
    *("records", "robot", "selection", "session", "shaping", "sim", "study", "viewers"),
)
"""All can be reached as attributes; those that most programs need are among the public names."""

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
    "OptscError",
    "Pose",
    "PyBulletFollower",
    "RobotModel",
    "Run",
    "Servo",
    "ServoSettings",
    "SharedController",
    "Status",
    "WeightedSum",
    "build_library",
    "grasps",
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
    "study",
]


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f"optsc.{name}")
    if name in _WHERE:
        return getattr(importlib.import_module(_WHERE[name]), name)
    raise AttributeError(f"module 'optsc' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, *_ROOMS, "__version__"})
