"""What the hand may touch: the object that it is grasping, and nothing else."""

from __future__ import annotations

from optsc.control.modes import Mode
from optsc.ik import Avoidance
from optsc.selection import Target

_AT_THE_OBJECT = (Mode.ADVANCE, Mode.CLOSE, Mode.LIFT, Mode.CARRY)


class Touching:
    """Tells the avoidance what the hand may touch; without avoidance it does nothing.

    While the robot goes to a grasp, closes and lifts, that is the object of the grasp. An operator who steps in
    then leads a hand that is at the object, which stays allowed until the robot sets out anew. Where the hand itself
    grasps, it is the object that is meant.
    """

    def __init__(self, avoid: Avoidance | None) -> None:
        self._avoid = avoid
        self._known = (
            frozenset(pair.other for pair in avoid.model.pairs) if avoid is not None else frozenset()
        )
        self._allowed: str | None = None
        if avoid is not None:
            avoid.hand_may_touch()

    def see(self, mode: Mode, target: Target | None, meant: str | None) -> None:
        """Take in the mode, the target of the robot, and the object that is meant where the hand grasps."""
        if self._avoid is None:
            return
        if mode in _AT_THE_OBJECT:
            name = target.object_name if target is not None else self._allowed
        elif mode is Mode.MANUAL:
            name = meant or self._allowed
        else:
            name = None
        if name != self._allowed:
            self._allowed = name
            self._avoid.hand_may_touch(*([name] if name is not None and name in self._known else []))
