"""Simulated operators: what they intend, how their hand moves, and how kinds of people differ."""

from optsc.people.people import TYPES, OperatorType, operator_type
from optsc.people.simulated import R_WS_DEFAULT, Reach, Simulated

__all__ = ["R_WS_DEFAULT", "TYPES", "OperatorType", "Reach", "Simulated", "operator_type"]
