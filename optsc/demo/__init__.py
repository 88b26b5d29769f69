"""The demonstration: every object of a scene grasped under both strategies."""

from optsc.demo.demonstration import Demo, run_demo

__all__ = ["Demo", "run_demo"]
