"""The robot alone, as soon as it knows what for."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import ClassVar

from optsc.control.arbitration.interface import Arbitration, Trigger
from optsc.errors import InvalidValue


@dataclass(frozen=True)
class Automatic(Arbitration):
    """The robot begins by itself once the same object has been meant for a while; the operator may step in.

    From then on it is `Alternating`: who has stepped in hands over again with the trigger.

    Attributes:
        dwell: for how long the same object has to be meant [s].
    """

    dwell: float = 0.5

    name: ClassVar[str] = "automatic"
    trigger: ClassVar[Trigger] = Trigger.HANDS_OVER
    assists: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not (isfinite(self.dwell) and self.dwell >= 0):
            raise InvalidValue("dwell", self.dwell, "finite, 0 s or more")

    def begins(self, meant_for: float) -> bool:
        """Tell whether the object has been meant long enough."""
        return meant_for >= self.dwell
