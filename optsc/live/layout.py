"""Layout of what processes of a live session share: which numbers of a tick are where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optsc.geometry.rotation import Array
from optsc.live import hand_mailbox, settings_block
from optsc.live.columns import CHARACTERS_PER_NUMBER, Columns
from optsc.live.ring import RowRing
from optsc.live.shared_block import SharedBlock, SharedSegment
from optsc.selection.costs import GraspCost, JointTravel, ManipulabilityLoss, OrientationDistance, PositionDistance

TERMS: tuple[GraspCost, ...] = (OrientationDistance(), PositionDistance(), ManipulabilityLoss(), JointTravel())
"""The costs that the page shows of the selected grasp."""
POSE = 7
"""Position and unit quaternion (w, x, y, z)."""
REASON = 50
"""Numbers that carry the reason: 400 characters."""
RING_SECONDS = 20.0
"""How long a recorder may be away before ticks are lost."""


@dataclass(frozen=True)
class Sizes:
    """What determines the layout.

    Attributes:
        joints, objects, candidates: how many there are.
        rate: of the control loop [Hz].
    """

    joints: int
    objects: int
    candidates: int
    rate: float = 500.0


def state_columns(sizes: Sizes) -> Columns:
    """Return what the page is shown of a moment: the newest tick, the choice, and the reason at the end as text."""
    n, objects = sizes.joints, sizes.objects
    widths = {
        "time": 1,
        "ticks": 1,
        "mode": 1,
        "status": 1,
        "events": 1,  # how many there were
        "event": 1,  # the last one
        "q": n,
        "q_measured": n,
        "opening": 1,
        "opening_measured": 1,
        "target": POSE,  # of the tool, as it is led
        "error": 6,
        "elapsed": 1,
        "late": 1,
        "worst_late": 1,  # since the state before this one
        "late_ticks": 1,
        "lost": 1,
        "engaged": 1,
        "arrival": 1,
        "settings": settings_block.COLUMNS.size,  # those in force
        "objects": POSE * objects,
        "shown": POSE * objects,  # the selected grasp of each; not a number where there is none
        "selected": objects,  # its candidate, -1 for none
        "widths": objects,  # its opening
        "intended": 1,  # which object is, -1 for none
        "target_object": 1,  # which one the robot goes for, -1 for none
        "held": 1,  # which one the jaws hold; -1 for none, -2 for something that is none of them
        "path": 2 * POSE,  # pre-grasp and grasp
        "terms": len(TERMS),
        "ranks": sizes.candidates,  # 0 best, 1 worst of its object; not a number where it is not admissible
        "reason": REASON,
    }
    return Columns(widths)


def tick_columns(sizes: Sizes) -> Columns:
    """Return what is recorded of every tick."""
    n = sizes.joints
    widths = {
        "tick": 1,
        "time": 1,
        "clock": 1,
        "late": 1,
        "lost": 1,
        "elapsed": 1,
        "mode": 1,
        "status": 1,
        "event": 1,  # -1 for none
        "arrival": 1,
        "device_time": 1,
        "raw_p": 3,
        "raw_q": 4,
        "sample": 1,  # whether the controller got one at this tick
        "stamp": 1,
        "engaged": 1,
        "trigger": 1,
        "buttons": 1,  # a bit for each
        "q": n,
        "v": n,
        "a": n,
        "opening": 1,
        "q_measured": n,
        "v_measured": n,
        "opening_measured": 1,
        "target": POSE,
        "error": 6,
        "intended": 1,
        "held": 1,
        "selected": 1,
        "terms": len(TERMS),
        "objects": POSE * sizes.objects,
        "measured_time": 1,
        "observations": 1,  # how often grasps were placed again
        "seen": POSE * sizes.objects,  # where the objects were then
        "seen_q": n,  # and the arm
        "settings": settings_block.COLUMNS.size,  # those in force
        "reason": REASON,
    }
    return Columns(widths)


def text_numbers(text: str, numbers: int) -> Array:
    """Return a text as ``numbers`` doubles, cut where it is too long."""
    size = numbers * CHARACTERS_PER_NUMBER
    data = text.encode()[:size].decode(errors="ignore").encode()
    return np.frombuffer(data.ljust(size, b"\0"), dtype=float)


def text_of(row: Array) -> str:
    """Return the text that `text_numbers` made numbers of."""
    return row.tobytes().rstrip(b"\0").decode(errors="replace")


class SharedParts:
    """The shared memory of a live session, with everything in it.

    Args:
        sizes: what determines the layout.
        name: of the segment, where another process made it.

    Attributes:
        segment: where it all lies.
        hand: the operator's hand, from the page server to the control process.
        settings: likewise what is changed on the page.
        state: the newest moment, from the control process to whoever looks.
        ticks: every tick, from the control process to the recorder.
    """

    def __init__(self, sizes: Sizes, name: str | None = None) -> None:
        self.sizes = sizes
        self.state_columns, self.tick_columns = state_columns(sizes), tick_columns(sizes)
        capacity = int(RING_SECONDS * sizes.rate)
        hand, settings = hand_mailbox.COLUMNS.size, settings_block.COLUMNS.size
        if name is None:
            blocks = sum(SharedBlock.doubles(size) for size in (hand, settings, self.state_columns.size))
            self.segment = SharedSegment(blocks + RowRing.doubles(self.tick_columns.size, capacity))
        else:
            self.segment = SharedSegment(name=name)
        self.hand = SharedBlock(self.segment, hand)
        self.settings = SharedBlock(self.segment, settings)
        self.state = SharedBlock(self.segment, self.state_columns.size)
        self.ticks = RowRing(self.segment, self.tick_columns.size, capacity)
