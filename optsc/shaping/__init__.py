"""Jerk-limited shaping with Ruckig: the joint guard and time laws."""

from optsc.shaping.guard import JointGuard, JointState
from optsc.shaping.time_law import PathPoint, TimeLaw

__all__ = ["JointGuard", "JointState", "PathPoint", "TimeLaw"]
