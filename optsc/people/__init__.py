"""Simulated operators: what they intend, how their hand moves, and how kinds of people differ."""

from optsc.people.parameters import TYPES, Intention, OperatorType, operator_type
from optsc.people.simulated import R_WS_DEFAULT, Simulated

__all__ = ["R_WS_DEFAULT", "TYPES", "Intention", "OperatorType", "Simulated", "operator_type"]
