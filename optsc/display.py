"""Display: what the operator is shown, as the operator's devices and simulated people see it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from optsc.control.arbitration import Goal
from optsc.control.controller import ControlStep, SharedController
from optsc.followers.protocol import FollowerState
from optsc.geometry import Pose
from optsc.operators import OperatorView
from optsc.selection import Ranking, Target


class Display:
    """What the operator is shown; grasps are placed again only when they have been ranked again."""

    def __init__(self, controller: SharedController) -> None:
        self._controller = controller
        self._placed: tuple[Ranking | None, tuple[Goal, ...]] = (None, ())
        self._grasps: Mapping[str, Pose] = {}

    def grasps(self) -> Mapping[str, Pose]:
        """Return the grasp to mark for each object, tool poses in W."""
        choice, (ranking, goals) = self._controller.state.choice, self._placed
        if choice.ranking is not ranking or choice.goals is not goals:
            self._placed, self._grasps = (choice.ranking, choice.goals), self._controller.shown
        return self._grasps

    def view(
        self, step: ControlStep | None, measured: FollowerState, objects: Mapping[str, Pose], time: float
    ) -> OperatorView:
        """Return what there is to see at ``time`` [s] after ``step``, the last one; None before the first."""
        controller = self._controller
        automatic = step is not None and step.mode.automatic
        goes_for = step.target if step is not None and automatic else None
        target = None if goes_for is None else _seen_target(goes_for, objects)
        X_WT = controller.robot.forward(measured.q)
        view = OperatorView(time, X_WT, automatic, controller.finished, objects, self.grasps(), target)
        if step is None:
            return view
        held = None if step.held is None else step.held.object_name
        # What was a tick ago is what can be seen, but for the mode, which is the present one.
        return view._replace(
            mode=controller.mode.value, status=step.command.status.value, reason=step.reason, held=held
        )


def _seen_target(target: Target, objects: Mapping[str, Pose]) -> str:
    """Return which of the objects the robot is seen to go for, whatever the controller may call it."""
    if target.object_name in objects or not objects:
        return target.object_name
    p = target.X_WG.translation
    return min(objects, key=lambda name: float(np.linalg.norm(objects[name].translation - p)))
