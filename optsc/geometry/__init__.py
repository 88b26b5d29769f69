"""Poses, rotations, pose metrics and meshes. Depends on numpy alone."""

from optsc.geometry.mesh import TriangleMesh
from optsc.geometry.pose import Pose

__all__ = ["Pose", "TriangleMesh"]
