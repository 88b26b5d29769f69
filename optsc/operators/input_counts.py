"""Counts of samples that could not be used: refused, late, duplicate, and why the last one was refused."""

from __future__ import annotations

from typing import NamedTuple

from optsc.operators.clock import Refusal


class InputCounts(NamedTuple):
    """How many samples of a stream were skipped.

    Attributes:
        refused: no usable sample at all, such as a pose that is not finite.
        late: earlier than one before, or too old.
        duplicate: with the stamp of the sample before, as from a tracker that stands still.
        reason: what was wrong with the last one that was refused, in words.
        before: the first three as they were when the newest usable sample came.
    """

    refused: int = 0
    late: int = 0
    duplicate: int = 0
    reason: str = ""
    before: tuple[int, int, int] = (0, 0, 0)

    def refusing(self, reason: str) -> InputCounts:
        """Return the counts after a sample that is refused for a reason."""
        return self._replace(refused=self.refused + 1, reason=reason)

    def skipping(self, refusal: Refusal | None, stamp: float) -> InputCounts:
        """Return the counts after a sample whose stamp [s] is refused."""
        if refusal is Refusal.DUPLICATE:
            return self._replace(duplicate=self.duplicate + 1)
        if refusal is Refusal.LATE:
            return self._replace(late=self.late + 1)
        return self.refusing(f"its stamp {stamp} {(refusal or Refusal.NOT_A_TIME).value}")

    def using(self) -> InputCounts:
        """Return the counts after a usable sample."""
        now = self[:3]
        return self if self.before == now else self._replace(before=now)

    @property
    def lately(self) -> str:
        """What could not be used since the newest usable sample, in words; empty where there was nothing."""
        refused, late, duplicate = (now - then for now, then in zip(self[:3], self.before, strict=True))
        parts = []
        if refused:
            parts.append(f"{refused} refused ({self.reason})")
        if late:
            parts.append(f"{late} late")
        if duplicate:
            parts.append(f"{duplicate} duplicate")
        return ", ".join(parts)

    @property
    def refused_lately(self) -> bool:
        """Whether a sample was refused since the newest usable one."""
        return self.refused > self.before[0]
