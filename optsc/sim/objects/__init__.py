"""Graspable objects that the library makes itself, and how the simulator takes them in."""

from optsc.sim.objects.catalogue import OBJECT_NAMES, object_model
from optsc.sim.objects.model import ObjectModel

__all__ = ["OBJECT_NAMES", "ObjectModel", "object_model"]
