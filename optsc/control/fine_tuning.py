"""Fine-tuning: the operator shifts the grasp that the robot goes to, a little, while it goes there.

Chen et al. 2023 name it as future work. A nudge is a small displacement and turn in the gripper's own frame, scaled,
and the sum of them is bounded: the stored grasp is adjusted, not replaced. What the arm cannot execute is not
taken over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot
from typing import Annotated, NamedTuple

import numpy as np

from optsc.checks import Checked, Pair, Positive
from optsc.control.approach import Approach, PathTarget
from optsc.control.path_feasibility import can_travel, grasp_path
from optsc.geometry import Pose, scalar
from optsc.geometry.scalar import Quaternion, Vector
from optsc.grasps import Candidates
from optsc.ik.batch import solve_ik
from optsc.operators.clutch import ClutchSettings, Hand
from optsc.robot import RobotModel
from optsc.selection import Target
from optsc.selection.reach import ClearRows

Nudge = tuple[float, float, float, float, float, float]
"""Displacement [m] and rotation vector [rad] in the gripper's own frame."""
_NONE = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class FineTuning(Checked):
    """How far a grasp may be tuned; all defaults are tuned here.

    Attributes:
        scale: what the tool is shifted by per nudge, in position and rotation [1].
        most: distance and angle from the stored grasp at most [m, rad].
        speed: how fast the robot's path is shifted at most [m/s, rad/s].
        period: time between two checks of what was nudged [s].
        wait: whether the robot waits at the pre-grasp until the operator confirms.
    """

    scale: Annotated[tuple[float, float], Pair] = (0.3, 0.3)
    most: Annotated[tuple[float, float], Pair] = (0.03, 0.35)
    speed: Annotated[tuple[float, float], Pair] = (0.05, 0.25)
    period: Annotated[float, Positive] = 0.02
    wait: bool = True


class TuningScene(NamedTuple):
    """What a tuned grasp is checked in: the arm, how it moves, the candidates, and their collision check."""

    robot: RobotModel
    approach: Approach
    candidates: Candidates
    clear: ClearRows | None


class Tuned(NamedTuple):
    """A grasp and what has become of it: the stored target, the offset in its own frame, and the target now."""

    stored: Target
    offset: Pose
    target: Target


def untouched(target: Target) -> Tuned:
    """Return a grasp as it was stored."""
    return Tuned(target, Pose.identity(), target)


def nudged(settings: FineTuning, scene: TuningScene, tuned: Tuned, nudge: Nudge) -> tuple[Tuned, str]:
    """Return the grasp after a nudge, and why it was refused; the grasp is then as it was.

    X_WG' = X_WG offset' with offset' = offset exp(scale nudge), made as short as `FineTuning.most` asks for. Checked
    are the pre-grasp and the grasp for a configuration within the joint limits and, where the scene has a check, for
    collision, and the straight path between them. The manipulability given with the target stays that of the stored
    grasp.
    """
    a, b = settings.scale
    step = Pose(
        np.array(scalar.exp((b * nudge[3], b * nudge[4], b * nudge[5]))),
        np.array((a * nudge[0], a * nudge[1], a * nudge[2])),
    )
    offset = _shortened(tuned.offset @ step, settings.most)
    stored = tuned.stored
    X_WG = stored.X_WG @ offset
    X_WP = X_WG @ (stored.X_WG.inverse() @ stored.X_WP)
    before, rng = tuned.target, np.random.default_rng(0)
    at_pregrasp = solve_ik(scene.robot, X_WP, rng=rng, seeds=before.q_pregrasp, restarts=0)
    if not at_pregrasp.success:
        return tuned, "the nudged pre-grasp is out of reach"
    at_grasp = solve_ik(scene.robot, X_WG, rng=rng, seeds=at_pregrasp.q, restarts=0)
    if not at_grasp.success:
        return tuned, "the nudged grasp is out of reach"
    target = before._replace(X_WG=X_WG, X_WP=X_WP, q=at_grasp.q, q_pregrasp=at_pregrasp.q)
    _, *path = grasp_path(scene.approach, X_WP, X_WP, X_WG)
    if not can_travel(scene.robot, scene.approach, at_pregrasp.q, path):
        return tuned, "the nudged grasp cannot be reached, and lifted from, on a straight path"
    if not _is_clear(scene, target):
        return tuned, "the nudged grasp would touch something"
    return Tuned(stored, offset, target), ""


def _shortened(offset: Pose, most: tuple[float, float]) -> Pose:
    turn = scalar.shortened(scalar.log(tuple(offset.quaternion.tolist())), most[1])
    return Pose(np.array(scalar.exp(turn)), np.array(scalar.shortened(tuple(offset.translation.tolist()), most[0])))


def _is_clear(scene: TuningScene, target: Target) -> bool:
    if scene.clear is None:
        return True
    one = np.array([target.candidate])
    X_WG = Pose(target.X_WG.quaternion[None], target.X_WG.translation[None])
    candidates = scene.candidates
    row = replace(
        candidates,
        object_index=candidates.object_index[one],
        grasp_index=candidates.grasp_index[one],
        X_WG=X_WG,
        opening=candidates.opening[one],
        quality=candidates.quality[one],
    )
    return bool(scene.clear(target.q[None], target.q_pregrasp[None], row)[0])


def hand_nudge(clutch: ClutchSettings, before: Hand, after: Hand, grasp: Quaternion) -> Nudge:
    """Return the motion of a hand between two samples as a nudge of a gripper with orientation ``grasp`` in W."""
    to_grasp = scalar.conjugate(grasp)
    p = (after.p[0] - before.p[0], after.p[1] - before.p[1], after.p[2] - before.p[2])
    turn = scalar.log(scalar.multiply(after.q, scalar.conjugate(before.q)))
    x, y, z = scalar.rotate(to_grasp, scalar.rotate(clutch.R_WS, p))
    a, b, c = scalar.rotate(to_grasp, scalar.rotate(clutch.R_WS, turn))
    return x, y, z, a, b, c


class Tuning(NamedTuple):
    """A grasp while it is tuned: nudges are collected, and taken over when the next check is due.

    Attributes:
        settings: how far it may be tuned.
        scene: what it is checked in.
        tuned: the grasp and what has become of it.
        checked: when nudges were taken over last [s].
        waiting: sum of the nudges since then.
    """

    settings: FineTuning
    scene: TuningScene
    tuned: Tuned
    checked: float
    waiting: Nudge = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def pushed(self, nudge: Nudge) -> Tuning:
        """Return the tuning with a nudge more."""
        x, y, z, a, b, c = (old + new for old, new in zip(self.waiting, nudge, strict=True))
        return self._replace(waiting=(x, y, z, a, b, c))

    def settled(self, time: float) -> tuple[Tuning, str]:
        """Return the tuning at ``time`` [s], nudges taken over if that is due, and why they could not be, if so."""
        if not any(self.waiting) or time - self.checked < self.settings.period:
            return self, ""
        tuned, reason = nudged(self.settings, self.scene, self.tuned, self.waiting)
        return Tuning(self.settings, self.scene, tuned, time), reason


class Shift(NamedTuple):
    """A displacement of a path, which moves to its end no faster than it may: a nudge never makes the tool jump.

    Attributes:
        speed: at most [m/s, rad/s].
        p, r: displacement [m] and rotation vector [rad], in W, now.
        end_p, end_r: where it moves to.
    """

    speed: tuple[float, float]
    p: Vector = _NONE
    r: Vector = _NONE
    end_p: Vector = _NONE
    end_r: Vector = _NONE

    def led(self, start: tuple[Vector, Quaternion], end: tuple[Vector, Quaternion]) -> Shift:
        """Return the shift with another end: the displacement that turns one pose in W into another."""
        (p, q), (to_p, to_q) = start, end
        end_p = (to_p[0] - p[0], to_p[1] - p[1], to_p[2] - p[2])
        return Shift(self.speed, self.p, self.r, end_p, scalar.log(scalar.multiply(to_q, scalar.conjugate(q))))

    @property
    def moving(self) -> bool:
        """Whether the end has not been reached."""
        return self.p != self.end_p or self.r != self.end_r

    def applied(self, target: PathTarget, period: float) -> tuple[Shift, PathTarget]:
        """Return the shift one ``period`` [s] later, and the path's target displaced, with its velocity."""
        after = Shift(
            self.speed,
            _stepped(self.p, self.end_p, self.speed[0] * period),
            _stepped(self.r, self.end_r, self.speed[1] * period),
            self.end_p,
            self.end_r,
        )
        v = tuple(t + (b - a) / period for t, a, b in zip(target.v, self.p, after.p, strict=True))
        w = tuple(t + (b - a) / period for t, a, b in zip(target.w, self.r, after.r, strict=True))
        place = tuple(a + b for a, b in zip(target.p, after.p, strict=True))
        turned = scalar.multiply(scalar.exp(after.r), target.q)
        return after, target._replace(p=place, q=turned, v=v, w=w)  # type: ignore[arg-type]


def _stepped(now: Vector, end: Vector, most: float) -> Vector:
    path = (end[0] - now[0], end[1] - now[1], end[2] - now[2])
    length = hypot(*path)
    if length <= most:
        return end
    s = most / length
    return now[0] + s * path[0], now[1] + s * path[1], now[2] + s * path[2]
