"""No assistance at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from optsc.control.arbitration.interface import Arbitration


@dataclass(frozen=True)
class Manual(Arbitration):
    """The hand alone, u = u_h; the trigger closes the jaws where they are."""

    name: ClassVar[str] = "manual"
    assists: ClassVar[bool] = False
