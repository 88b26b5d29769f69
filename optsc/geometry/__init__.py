"""Poses, rotations, pose metrics, meshes, point clouds and cameras. Depends on numpy alone."""

from optsc.geometry.camera import DepthImage, PinholeCamera, look_at
from optsc.geometry.cloud import PointCloud
from optsc.geometry.mesh import TriangleMesh
from optsc.geometry.pose import Pose

__all__ = ["DepthImage", "PinholeCamera", "PointCloud", "Pose", "TriangleMesh", "look_at"]
