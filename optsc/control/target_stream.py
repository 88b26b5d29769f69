"""Stream of targets into the servo: what is no pose, late or a duplicate is skipped and counted; stamps are mapped."""

from __future__ import annotations

from typing import NamedTuple

from optsc.geometry import Pose
from optsc.geometry.scalar import Quaternion, Vector
from optsc.operators.clock import ClockMapping
from optsc.operators.input_counts import InputCounts

FARTHEST = 1e9
"""Positions [m] from here on are faults, not targets."""


class StampedPose(NamedTuple):
    """A usable target: position, orientation, and when it was sampled on the loop's clock [s]."""

    p: Vector
    q: Quaternion
    stamp: float


class TargetStream(NamedTuple):
    """What is known of the stream of targets: the clock of their stamps, and how many could not be used."""

    clock: ClockMapping = ClockMapping()
    counts: InputCounts = InputCounts()

    def read(
        self, X_WT: object, stamp: float | None, time: float, zero: float | None
    ) -> tuple[TargetStream, StampedPose | None]:
        """Return the stream after a target, and the target where it is usable.

        Args:
            X_WT: the target, as it came.
            stamp: when it was sampled, on a clock of its own [s]; ``time`` where it is None.
            time: now [s].
            zero: of the clock that the loop tells, if it does, see `ClockMapping.read`.
        """
        clock, counts = self
        pose = _pose_of(X_WT)
        if isinstance(pose, str):
            return TargetStream(clock, counts.refusing(pose)), None
        if stamp is None:
            return TargetStream(clock, counts.using()), StampedPose(*pose, time)
        clock, at, refusal = clock.read(stamp, time, zero)
        if at is None:
            return TargetStream(clock, counts.skipping(refusal, stamp)), None
        return TargetStream(clock, counts.using()), StampedPose(*pose, at)

    @property
    def lately(self) -> str:
        """What could not be used since the newest usable target, in words, to follow another sentence."""
        lately = self.counts.lately
        return f"; since then {lately}" if lately else ""


def _pose_of(X_WT: object) -> tuple[Vector, Quaternion] | str:
    """Return position and orientation of one finite pose, or why it is none."""
    if not isinstance(X_WT, Pose):
        return f"target is of type {type(X_WT).__name__}, not a pose"
    p, q = X_WT.translation.tolist(), X_WT.quaternion.tolist()
    one = X_WT.translation.shape == (3,) and X_WT.quaternion.shape == (4,)
    # Sums of magnitudes carry what is not finite, and do not cancel.
    finite = one and abs(p[0]) + abs(p[1]) + abs(p[2]) < FARTHEST
    if finite and 0.9 < q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2 < 1.1:
        return (p[0], p[1], p[2]), (q[0], q[1], q[2], q[3])
    return "target is not one finite pose with a unit quaternion"
