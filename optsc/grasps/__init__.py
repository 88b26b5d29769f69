"""Grasps: sampling them on an object's surface, storing them, and placing them in the world."""

from optsc.grasps.antipodal import sample_grasps
from optsc.grasps.candidates import Candidates
from optsc.grasps.detection import detect_grasps
from optsc.grasps.grasp_set import GraspSet
from optsc.grasps.importing import import_grasps
from optsc.grasps.library import GraspLibrary, build_library
from optsc.grasps.settings import AntipodalSettings

__all__ = [
    "AntipodalSettings",
    "Candidates",
    "GraspLibrary",
    "GraspSet",
    "build_library",
    "detect_grasps",
    "import_grasps",
    "sample_grasps",
]
