"""The paper's arbitration: either the hand or the robot, and the trigger changes over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from optsc.control.arbitration.interface import Arbitration, Trigger


@dataclass(frozen=True)
class Alternating(Arbitration):
    """Alternating control (Chen et al. 2023): u = u_h until the trigger, then the robot alone until the next."""

    name: ClassVar[str] = "alternating"
    trigger: ClassVar[Trigger] = Trigger.HANDS_OVER
    assists: ClassVar[bool] = False
