"""Grasp sampling: antipodal grasps on meshes and measured clouds, their quality, import from other formats."""

from optsc.sampling.antipodal import sample_grasps
from optsc.sampling.detection import detect_grasps
from optsc.sampling.importing import import_grasps
from optsc.sampling.library import build_library
from optsc.sampling.settings import AntipodalSettings

__all__ = ["AntipodalSettings", "build_library", "detect_grasps", "import_grasps", "sample_grasps"]
