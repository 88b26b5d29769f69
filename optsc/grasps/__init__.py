"""Sets of grasps: stored, kept as a library, and placed in the world as candidates."""

from optsc.grasps.candidates import Candidates
from optsc.grasps.grasp_set import GraspSet
from optsc.grasps.library import GraspLibrary

__all__ = ["Candidates", "GraspLibrary", "GraspSet"]
