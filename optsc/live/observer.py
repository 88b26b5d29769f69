"""Observer: places and solves the grasps of objects that have moved, in a process beside the control loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any, NamedTuple, Protocol

import numpy as np

from optsc.control.controller import SharedController
from optsc.control.modes import Mode
from optsc.geometry import scalar
from optsc.geometry.rotation import Array
from optsc.live.layout import POSE
from optsc.live.scene import LiveScene, SceneChoice
from optsc.live.settings_block import LiveSettings
from optsc.records import SolvedUpdate
from optsc.selection import GraspSelector, ReachTable

MOVED = (0.003, 0.03)
"""An object that is further from where its grasps were placed [m, rad] has moved ..."""
STILL = (0.0005, 0.005)
"""... and is looked at when it lies still: when it moves less than this from one look to the next [m, rad]."""
_HANDS_OFF = (Mode.HOLD, Mode.MANUAL)


class Pipe(Protocol):
    """One end of a pipe, as `multiprocessing.Pipe` gives it."""

    def send(self, obj: Any) -> None: ...  # noqa: D102
    def poll(self, timeout: float) -> bool: ...  # noqa: D102
    def recv(self) -> Any: ...  # noqa: D102


class SeenObjects(NamedTuple):
    """Poses of the objects (K, 7) and the configuration (n,) [rad] that their grasps were solved from."""

    poses: Array
    q: Array


def solved(scene: LiveScene, selector: GraspSelector, seen: SeenObjects) -> SolvedUpdate:
    """Return the grasps of a scene where its objects are seen, with their reach table: the same bytes everywhere."""
    update = scene.seen(seen.poses)
    return SolvedUpdate(*update, selector.solver.table(update.candidates, seen.q, clear=update.clear, known=None))


class Lookout:
    """The control loop's side: notices that objects have moved, asks, and takes the answer when it comes.

    Args:
        scene: what is driven.
        pipe: to the observer.

    Attributes:
        seen: what the grasps in use follow from.
        count: how often they were placed again.
    """

    def __init__(self, scene: LiveScene, pipe: Pipe) -> None:
        self._scene, self._pipe = scene, pipe
        self._asked: SeenObjects | None = None
        self.count = 0
        self.begin_again()

    def begin_again(self) -> None:
        """The objects are where they were at the start; what was asked for before is of no use any more."""
        self.seen = SeenObjects(self._scene.poses, self._scene.robot.home.copy())
        self._last = self.seen.poses
        self._stale = self._asked is not None

    def look(self, controller: SharedController, poses: Array) -> None:
        """Look at the objects (K, 7): ask where they have come to rest elsewhere, and take an answer."""
        last, self._last = self._last, poses.copy()
        if self._asked is not None:
            if self._pipe.poll(0.0):
                self._answered(controller, self._asked, self._pipe.recv(), poses)
            return
        quiet = controller.mode in _HANDS_OFF and controller.state.held is None
        if quiet and _apart(poses, self.seen.poses, MOVED) and not _apart(poses, last, STILL):
            self._asked = SeenObjects(poses.copy(), controller.servo.guard.q.copy())
            self._pipe.send(self._asked)

    def _answered(self, controller: SharedController, asked: SeenObjects, parts: dict[str, Any], poses: Array) -> None:
        self._asked, stale, self._stale = None, self._stale, False
        if stale or controller.mode not in _HANDS_OFF or _apart(poses, asked.poses, MOVED):
            return  # things have moved on since; the next look asks again
        update = self._scene.seen(asked.poses)
        controller.observe(*update, ReachTable(candidates=update.candidates, **parts))
        self.seen, self.count = asked, self.count + 1


def run_observer(say_ready: Callable[[Any], None], choice: SceneChoice, pipe: Pipe) -> None:
    """Answer until the session ends: the fields of a reach table for each observation that is asked for."""
    scene = LiveScene(choice)
    selector = scene.controller(LiveSettings()).selector
    solved(scene, selector, SeenObjects(scene.poses, scene.robot.home))  # what has to be compiled is compiled now
    say_ready(None)
    while True:
        pipe.send(parts_of(solved(scene, selector, pipe.recv()).table))


def parts_of(table: ReachTable) -> dict[str, Any]:
    """Return the fields of a table, but for its candidates, as they pass through a pipe."""
    parts = {field.name: getattr(table, field.name) for field in fields(table) if field.name != "candidates"}
    return {**parts, "columns": dict(table.columns)}


def _apart(a: Array, b: Array, limit: tuple[float, float]) -> bool:
    """Tell whether any of K poses (K, 7) is further from its partner than a distance and an angle [m, rad]."""
    if np.linalg.norm(a[:, :3] - b[:, :3], axis=1).max(initial=0.0) > limit[0]:
        return True
    pairs = zip(a[:, 3:POSE].tolist(), b[:, 3:POSE].tolist(), strict=True)
    return any(scalar.angle(scalar.multiply(tuple(p), scalar.conjugate(tuple(q)))) > limit[1] for p, q in pairs)
