"""What is in the hand: what was between the jaws, and whose place is empty now; it moves as the hand does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from optsc.geometry import DepthImage, Pose
from optsc.perception.memory import Grip, News, SceneEvent, SceneMemory
from optsc.perception.presence import Presence, presence_at
from optsc.robot import Gripper

LEAST = 0.002
"""Of an object between the jaws, at least this share of its points is [-]: a pad's print on a box of 15 cm."""


def share_between_jaws(points_T: np.ndarray, gripper: Gripper) -> float:
    """Return the share of points (N, 3) in T that lie between the open jaws, from the palm to the finger tips."""
    half = 0.5 * np.array([gripper.pad_size[0], gripper.max_opening])
    palm, tips = float(gripper.body[:, 1, 2].max()), float(gripper.finger[:, 1, 2].max())
    beside = np.all(np.abs(points_T[:, :2]) <= half, axis=1)
    inside = beside & (points_T[:, 2] >= palm) & (points_T[:, 2] <= tips)
    return float(np.mean(inside)) if len(points_T) else 0.0


def with_grips(
    memory: SceneMemory, found: Mapping[str, Presence], X_WT: Pose, gripper: Gripper
) -> SceneMemory:
    """Return the memory in which what is between the jaws is noted, at the hand's deepest reach for it.

    Later the hand may have carried it away unseen. What is seen where it was is in no hand.
    """
    grips = {name: grip for name, grip in memory.grips.items() if found.get(name) is not Presence.THERE}
    for name, state in found.items():
        if state is not Presence.HIDDEN:
            continue
        X_TO = X_WT.inverse() @ memory.objects[name].X_WO
        share = share_between_jaws(X_TO.apply(memory.objects[name].cloud.points), gripper)
        if share >= LEAST and (name not in grips or share >= grips[name].share):
            grips[name] = Grip(X_TO, share)
    return replace(memory, grips=grips)


class Hand(NamedTuple):
    """What the hand has to do with what is known.

    Attributes:
        memory: with what it has taken.
        lost: names of objects that are neither in their place nor in the hand.
        unsure: names of objects that the hand took, where it cannot be seen whether it still has them.
        events: what it has taken just now.
    """

    memory: SceneMemory
    lost: frozenset[str]
    unsure: frozenset[str]
    events: tuple[SceneEvent, ...]


def hand(memory: SceneMemory, gone: frozenset[str], X_WT: Pose, image: DepthImage) -> Hand:
    """Return what the hand has taken, and what is lost then.

    Args:
        memory: with grips.
        gone: names of objects whose place is seen to be empty.
        X_WT: pose of the tool.
        image: what is measured.
    """
    events: list[SceneEvent] = []
    lost, unsure = set(gone), set()
    for name in sorted(memory.held | (gone & memory.grips.keys())):
        X_WO = X_WT @ memory.grips[name].X_TO
        there = presence_at(memory.objects[name], X_WO, image)
        if there is Presence.GONE:
            lost.add(name)
            continue
        if there is Presence.HIDDEN:
            unsure.add(name)
        if name not in memory.held:
            events.append(SceneEvent(News.TAKEN, name, "its place is empty, and it was between the jaws"))
        memory = memory.with_held(name, X_WO)
        lost.discard(name)
    return Hand(memory, frozenset(lost), frozenset(unsure), tuple(events))
