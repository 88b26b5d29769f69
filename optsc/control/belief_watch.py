"""Belief watch: the hand's own motion, from one update of the belief over objects to the next."""

from __future__ import annotations

from math import hypot
from typing import NamedTuple

import numpy as np

from optsc.control.arbitration import Goal, GraspPose
from optsc.geometry import Pose, rotation, scalar
from optsc.geometry.scalar import Vector
from optsc.operators.clutch import ClutchSettings, Hand
from optsc.selection.intent import Belief, CostToGo, Goals, IntentSettings, cost_to_go, updated, wasted


class BeliefWatch(NamedTuple):
    """The belief over the objects, and what it is updated from.

    Attributes:
        belief: how likely each object is intended.
        goals: the objects as a policy is given them.
        origin: hand and tool from which motion counts for the next update; None where none does.
    """

    belief: Belief
    goals: tuple[Goal, ...]
    origin: tuple[Hand, Pose] | None


def moved_by_hand(last: Hand, hand: Hand, clutch: ClutchSettings) -> bool:
    """Tell whether a hand has moved from one sample to the next; a greater step is a tracker that jumped."""
    return hypot(*_displacement(hand, last)) <= clutch.largest_step[0]


def believed(
    watch: BeliefWatch,
    settings: IntentSettings,
    goals: Goals,
    X_WT: Pose,
    hand: Hand | None,
    clutch: ClutchSettings,
) -> BeliefWatch:
    """Return the watch with the hand as it is now, the belief updated once it has moved far enough to say something."""
    belief = watch.belief.among(goals.names)
    here = cost_to_go(settings, goals, X_WT.translation, X_WT.quaternion)
    watch = watch._replace(belief=belief, goals=_goals(goals, here, belief))
    if hand is None or watch.origin is None:
        return watch._replace(origin=None if hand is None else (hand, X_WT))
    earlier, X_from = watch.origin
    shift = scalar.rotate(clutch.R_WS, _displacement(hand, earlier))
    turn = scalar.log(scalar.multiply(hand.q, scalar.conjugate(earlier.q)))
    moved, turned = clutch.scale * hypot(*shift), clutch.rotation_scale * hypot(*turn)
    if moved < settings.dead_band[0] and turned < settings.dead_band[1]:
        return watch
    R_turn = rotation.exp(clutch.rotation_scale * np.array(scalar.rotate(clutch.R_WS, turn)))
    before = cost_to_go(settings, goals, X_from.translation, X_from.quaternion)
    after = cost_to_go(
        settings,
        goals,
        X_from.translation + clutch.scale * np.array(shift),
        rotation.multiply(R_turn, X_from.quaternion),
    )
    belief = updated(settings, belief, wasted(settings, before, after, moved, turned))
    return watch._replace(belief=belief, origin=(hand, X_WT))


def _displacement(hand: Hand, earlier: Hand) -> Vector:
    (x, y, z), (a, b, c) = hand.p, earlier.p
    return x - a, y - b, z - c


def _goals(goals: Goals, here: CostToGo, belief: Belief) -> tuple[Goal, ...]:
    """Return the objects as a policy is given them."""
    best = [line.start + int(np.argmax(goals.manipulability[line])) for line in goals.lines]
    rows = zip(goals.names, belief.probability.tolist(), here.row.tolist(), best, strict=True)

    def grasp(row: int) -> GraspPose:
        p, q = goals.positions[row].tolist(), goals.quaternions[row].tolist()
        return GraspPose(tuple(p), tuple(q), int(goals.candidate[row]))

    return tuple(Goal(name, b, grasp(i), grasp(j)) for name, b, i, j in rows)
