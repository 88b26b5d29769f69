"""Grasps: sampling them on an object's surface, storing them, and placing them in the world."""

from optsc.grasps.antipodal import sample_grasps
from optsc.grasps.grasp_set import GraspSet
from optsc.grasps.settings import AntipodalSettings

__all__ = ["AntipodalSettings", "GraspSet", "sample_grasps"]
