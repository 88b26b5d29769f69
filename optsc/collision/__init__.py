"""Collision: what the arm must not touch, checked, measured, and kept away from in motion."""

from optsc.collision.avoidance import AvoidanceSettings, CollisionAvoidance
from optsc.collision.grasp_clearance import GraspClearance
from optsc.collision.model import CollisionModel

__all__ = ["AvoidanceSettings", "CollisionAvoidance", "CollisionModel", "GraspClearance"]
