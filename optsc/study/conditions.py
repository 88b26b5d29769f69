"""What a study varies besides the scene: the operator, the rule that ranks grasps, and the definition of M."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

from optsc.checks import AtLeast, Checked, OneOf
from optsc.errors import UnknownName
from optsc.operators import Operator
from optsc.people import TYPES, Simulated, operator_type
from optsc.robot.manipulability import DEFINITIONS, Manipulability
from optsc.selection import Cascade, RankingRule
from optsc.study.fingerprint import Plain, fingerprint, plain


@dataclass(frozen=True)
class OperatorSpec(Checked):
    """A simulated operator as a value.

    Attributes:
        kind: one of `optsc.people.TYPES`.
        seed: of everything random; the same seed under every condition gives common random numbers.
    """

    kind: Annotated[str, OneOf(TYPES, "operator type")] = "typical"
    seed: Annotated[int, AtLeast(0)] = 0

    @property
    def steps_in(self) -> bool:
        """Whether the operator takes over again during the approach."""
        return operator_type(self.kind).changes_mind_after is not None

    def operator(self, goal: str, objects: Collection[str], *, by_hand: bool = False) -> Operator:
        """Return an operator for one run who wants ``goal`` of ``objects``."""
        return Simulated.of_type(self.kind, goal, objects, seed=self.seed, by_hand=by_hand)

    def describe(self) -> Plain:
        """Return everything that determines the operator, motor parameters in full."""
        return plain([self, operator_type(self.kind)])


DEFAULT_MEASURE = "yoshikawa-tsai"


def measure(name: str) -> Manipulability:
    """Return the definition of M of that name, one of `DEFINITIONS`; raise `UnknownName`."""
    if name not in DEFINITIONS:
        raise UnknownName("definition of M", name, DEFINITIONS)
    return DEFINITIONS[name]


@dataclass(frozen=True)
class Condition(Checked):
    """How the target is chosen.

    Attributes:
        name: for tables.
        rule: how candidates are ranked.
        measure: name of the definition of M.
        about: what tables say about it besides, such as the point of a sweep; no part of its key.
    """

    name: str
    rule: RankingRule
    measure: Annotated[str, OneOf(DEFINITIONS, "definition of M")] = DEFAULT_MEASURE
    about: Mapping[str, Any] = field(default_factory=dict, compare=False, hash=False)

    @cached_property
    def key(self) -> str:
        """Hash of the rule and of the definition of M, whatever they are called."""
        return fingerprint([self.rule, measure(self.measure)])

    def labels(self) -> dict[str, Any]:
        """Return what tables say about it: its name, the definition of M, and ``about`` as ``at_...``."""
        varied = {f"at_{name}": value for name, value in self.about.items()}
        return {"condition": self.name, "measure": self.measure, **varied}

    def with_measure(self, name: str) -> Condition:
        """Return the same rule with another definition of M."""
        return replace(self, measure=name)


PAPER = Condition("paper", Cascade.paper())
"""Of the grasps the 30 nearest in orientation, of them the 6 nearest in position, of them the greatest M."""
MANIPULABILITY_ONLY = Condition("manipulability", Cascade.manipulability_only())
"""The greatest M of all grasps: the strategy that the paper compares itself with."""
