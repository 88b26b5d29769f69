"""Kinds of simulated people: what they do differently is in the parameters."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from math import radians
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import UnknownName
from optsc.people.human_motion import HumanParameters
from optsc.people.simulated import R_WS_DEFAULT, Reach, Simulated


@dataclass(frozen=True)
class OperatorType:
    """A kind of person.

    Attributes:
        name: for tables and records.
        about: what sets these people apart, in words.
        human: motor habits.
        changes_mind_after: first goes for another object, and for the wanted one this long after the trigger [s];
            None: not at all.
    """

    name: str
    about: str
    human: HumanParameters = field(default_factory=HumanParameters)
    changes_mind_after: float | None = None

    def plan(self, wanted: str, objects: Collection[str], seed: int) -> tuple[Reach, ...]:
        """Return what a person of this kind does to get ``wanted``, one of ``objects``; raise `UnknownName`."""
        if wanted not in objects:
            raise UnknownName("object", wanted, sorted(objects))
        others = sorted(set(objects) - {wanted})
        if self.changes_mind_after is None or not others:
            return (Reach(wanted),)
        # A stream of its own: what the hand does must not depend on which object came first.
        first = others[int(np.random.default_rng([seed, 1]).integers(len(others)))]
        return (Reach(first, then_take_over_after=self.changes_mind_after), Reach(wanted))

    def operator(
        self,
        wanted: str,
        objects: Collection[str],
        *,
        seed: int,
        R_WS: ArrayLike = R_WS_DEFAULT,
        by_hand: bool = False,
    ) -> Simulated:
        """Return a person of this kind who wants an object; see `Simulated` for the arguments."""
        plan = self.plan(wanted, objects, seed)
        return Simulated(seed, plan, R_WS, self.human, by_hand=by_hand)


TYPES: Mapping[str, OperatorType] = MappingProxyType(
    {
        kind.name: kind
        for kind in (
            OperatorType("typical", "the middle of what is known; the default elsewhere"),
            OperatorType(
                "patient",
                "slow, exact, looks twice before handing over",
                HumanParameters(
                    fitts_slope=0.45,
                    position_tolerance=0.012,
                    rotation_tolerance=radians(4.0),
                    corrections=6,
                    dwell=0.8,
                    patience=4.0,
                ),
            ),
            OperatorType(
                "hasty",
                "quick, hence noisy, hands over from wherever the first movement ended",
                HumanParameters(
                    fitts_slope=0.2,
                    position_tolerance=0.05,
                    rotation_tolerance=radians(15.0),
                    corrections=1,
                    motor_noise=0.15,
                    dwell=0.1,
                    patience=0.5,
                    retrigger=0.5,
                ),
            ),
            OperatorType(
                "biased",
                "sees the tool 3 cm and 10 degrees off, always the same way",
                HumanParameters(misjudged=(0.03, radians(10.0))),
            ),
            OperatorType(
                "mind-changing",
                "goes for another object first, steps in on the way and wants this one",
                changes_mind_after=0.8,
            ),
        )
    }
)
"""The kinds that are built in, by name; what makes them different is ours, after `HumanParameters`."""


def operator_type(name: str) -> OperatorType:
    """Return the kind of that name; raise `UnknownName`."""
    if name not in TYPES:
        raise UnknownName("operator type", name, TYPES)
    return TYPES[name]
