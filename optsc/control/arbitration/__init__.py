"""Arbitration policies: how the hand's wish and the robot's become one motion; see ``docs/arbitration.md``."""

from types import MappingProxyType

from optsc.control.arbitration.alternating import Alternating
from optsc.control.arbitration.automatic import Automatic
from optsc.control.arbitration.continuous import Continuous
from optsc.control.arbitration.experts import ProductOfExperts
from optsc.control.arbitration.fixture import VirtualFixture
from optsc.control.arbitration.hindsight import Hindsight
from optsc.control.arbitration.interface import (
    HAND_ALONE,
    Arbitration,
    Blend,
    Goal,
    GraspPose,
    Moment,
    Trigger,
)
from optsc.control.arbitration.linear import LinearBlending
from optsc.control.arbitration.manual import Manual
from optsc.errors import UnknownName

POLICIES = MappingProxyType(
    {
        policy.name: policy
        for policy in (
            Alternating,
            Automatic,
            Continuous,
            Hindsight,
            LinearBlending,
            Manual,
            ProductOfExperts,
            VirtualFixture,
        )
    }
)
"""The policies that are built in, by name."""


def make_policy(name: str) -> Arbitration:
    """Return the policy of that name with its default settings; raise `UnknownName`."""
    if name not in POLICIES:
        raise UnknownName("arbitration policy", name, POLICIES)
    return POLICIES[name]()


__all__ = [
    "HAND_ALONE",
    "POLICIES",
    "Alternating",
    "Arbitration",
    "Automatic",
    "Blend",
    "Continuous",
    "Goal",
    "GraspPose",
    "Hindsight",
    "LinearBlending",
    "Manual",
    "Moment",
    "ProductOfExperts",
    "Trigger",
    "VirtualFixture",
    "make_policy",
]
