"""The simulated world: a table, objects, an arm and contact physics. Nothing is started by importing it."""

from optsc.sim.objects import OBJECT_NAMES, ObjectModel, object_model
from optsc.sim.tabletop import Tabletop, tabletop

__all__ = ["OBJECT_NAMES", "ObjectModel", "Tabletop", "object_model", "tabletop"]
