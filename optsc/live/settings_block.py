"""Live settings: what a person changes on the page while the loop runs, as a row that processes share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np

from optsc.checks import AtLeast, AtMost, Checked, NonNegative, OneOf, from_mapping
from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.live.columns import Columns
from optsc.operators.smoothing import Smoothing
from optsc.selection import Cascade, RankingRule, WeightedSum
from optsc.selection.costs import JointTravel, ManipulabilityLoss, OrientationDistance, PositionDistance

RULES = ("cascade", "weighted sum")


@dataclass(frozen=True)
class LiveSettings(Checked):
    """What can be changed on the page.

    Attributes:
        rule: how grasps are ranked.
        keep_orientation, keep_position: how many grasps of an object the first two stages of the cascade leave.
        orientation, position, manipulability, travel: weights of the sum [-, 1/m, -, 1/rad].
        scale: motion of the tool per motion of the hand.
        cutoff: of the smoothing of the hand at rest [Hz]; 0 for none.
        restarts: how often the scene was to begin again.
    """

    rule: Annotated[str, OneOf(RULES, "rule")] = "cascade"
    keep_orientation: Annotated[int, AtLeast(1), AtMost(200)] = 30
    keep_position: Annotated[int, AtLeast(1), AtMost(200)] = 6
    orientation: Annotated[float, NonNegative, AtMost(10.0)] = 1.0
    position: Annotated[float, NonNegative, AtMost(10.0)] = 2.0
    manipulability: Annotated[float, NonNegative, AtMost(10.0)] = 1.0
    travel: Annotated[float, NonNegative, AtMost(10.0)] = 0.1
    scale: Annotated[float, AtLeast(0.1), AtMost(3.0)] = 1.0
    cutoff: Annotated[float, NonNegative, AtMost(20.0)] = 0.0
    restarts: Annotated[int, AtLeast(0), AtMost(1_000_000)] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rule != "cascade" and not any(self.weights):
            raise InvalidValue("weights", self.weights, "at least one above 0")

    @property
    def weights(self) -> tuple[float, float, float, float]:
        """The weights of the sum."""
        return self.orientation, self.position, self.manipulability, self.travel

    @property
    def ranking_rule(self) -> RankingRule:
        """The rule as the selector takes it."""
        if self.rule == "cascade":
            return Cascade.paper(self.keep_orientation, self.keep_position)
        costs = (OrientationDistance(), PositionDistance(), ManipulabilityLoss(), JointTravel())
        return WeightedSum(tuple(zip(costs, self.weights, strict=True)))

    @property
    def smoothing(self) -> Smoothing | None:
        """The smoothing as the controller takes it."""
        return Smoothing(cutoff=self.cutoff) if self.cutoff else None

    def changed(self, values: Mapping[str, Any]) -> LiveSettings:
        """Return the settings with other values; raise `InvalidValue` or `UnknownName` for what is none of them."""
        return from_mapping(LiveSettings, {**asdict(self), **values})

    def row(self) -> Array:
        """Return the settings as a row of `COLUMNS`."""
        values = asdict(self)
        values["rule"] = RULES.index(self.rule)
        return np.array([float(values[name]) for name in COLUMNS])

    @classmethod
    def of_row(cls, row: Array) -> LiveSettings:
        """Return the settings of a row; raise `InvalidValue`."""
        values: dict[str, Any] = dict(zip(COLUMNS, row.tolist(), strict=True))
        values["rule"] = RULES[int(values["rule"])]
        for name in ("keep_orientation", "keep_position", "restarts"):
            values[name] = int(values[name])
        return cls(**values)


COLUMNS = Columns(dict.fromkeys(LiveSettings.__dataclass_fields__, 1))
