"""Fine-tuning: the operator shifts the grasp that the robot goes to, a little, while it goes there.

Chen et al. 2023 name it as future work. A nudge is a small displacement and turn in the gripper's own frame, scaled,
and the sum of them is bounded: the stored grasp is adjusted, not replaced. What the arm cannot execute is not
taken over.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, nan
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
STILL: Nudge = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""No nudge at all."""
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


class NudgeCheck(NamedTuple):
    """A nudge while it is checked, in three steps: its reach, its path, and what it would touch.

    Attributes:
        offset, target: as in `Tuned`, once the nudge is taken over.
        steps: how many of `STEPS` it has passed.
        reason: why it is refused; empty as long as it is not.
    """

    offset: Pose
    target: Target
    steps: int = 0
    reason: str = ""

    def after_step(self, scene: TuningScene) -> NudgeCheck:
        """Return the check after its next step."""
        checked = STEPS[self.steps](scene, self)
        return checked._replace(steps=self.steps + 1)

    @property
    def over(self) -> bool:
        """Whether it is taken over or refused."""
        return bool(self.reason) or self.steps == len(STEPS)


def nudge_check(settings: FineTuning, tuned: Tuned, nudge: Nudge) -> NudgeCheck:
    """Return the check of a nudge before its first step.

    X_WG' = X_WG offset' with offset' = offset exp(scale nudge), made as short as `FineTuning.most` asks for.
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
    # How wide the object is beside the stored grasp, nobody knows.
    return NudgeCheck(offset, tuned.target._replace(X_WG=X_WG, X_WP=X_WP, opening=nan))


def _reached(scene: TuningScene, check: NudgeCheck) -> NudgeCheck:
    target, rng = check.target, np.random.default_rng(0)
    at_pregrasp = solve_ik(scene.robot, target.X_WP, rng=rng, seeds=target.q_pregrasp, restarts=0)
    if not at_pregrasp.success:
        return check._replace(reason="the nudged pre-grasp is out of reach")
    at_grasp = solve_ik(scene.robot, target.X_WG, rng=rng, seeds=at_pregrasp.q, restarts=0)
    if not at_grasp.success:
        return check._replace(reason="the nudged grasp is out of reach")
    return check._replace(target=target._replace(q=at_grasp.q, q_pregrasp=at_pregrasp.q))


def _travelled(scene: TuningScene, check: NudgeCheck) -> NudgeCheck:
    target = check.target
    _, *path = grasp_path(scene.approach, target.X_WP, target.X_WP, target.X_WG)
    if can_travel(scene.robot, scene.approach, target.q_pregrasp, path):
        return check
    return check._replace(reason="the nudged grasp cannot be reached, and lifted from, on a straight path")


def _cleared(scene: TuningScene, check: NudgeCheck) -> NudgeCheck:
    target, one = check.target, np.array([check.target.candidate])
    if scene.clear is None:
        return check
    row = scene.candidates.select(one, Pose(target.X_WG.quaternion[None], target.X_WG.translation[None]))
    if scene.clear(target.q[None], target.q_pregrasp[None], row)[0]:
        return check
    return check._replace(reason="the nudged grasp would touch something")


STEPS = (_reached, _travelled, _cleared)


def nudged(settings: FineTuning, scene: TuningScene, tuned: Tuned, nudge: Nudge) -> tuple[Tuned, str]:
    """Return the grasp after a nudge, and why it was refused; the grasp is then as it was.

    Checked are the pre-grasp and the grasp for a configuration within the joint limits, the straight path between them
    and up and, where the scene has a check, both for collision. The manipulability given with the target stays that of
    the stored grasp.
    """
    check = nudge_check(settings, tuned, nudge)
    while not check.over:
        check = check.after_step(scene)
    return (tuned, check.reason) if check.reason else (Tuned(tuned.stored, check.offset, check.target), "")


def _shortened(offset: Pose, most: tuple[float, float]) -> Pose:
    turn = scalar.shortened(scalar.log(tuple(offset.quaternion.tolist())), most[1])
    return Pose(np.array(scalar.exp(turn)), np.array(scalar.shortened(tuple(offset.translation.tolist()), most[0])))


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
        check: of nudges that are being checked; None while there are none.
    """

    settings: FineTuning
    scene: TuningScene
    tuned: Tuned
    checked: float
    waiting: Nudge = STILL
    check: NudgeCheck | None = None

    def was_checked_since(self, before: Tuning) -> bool:
        """Tell whether a step of a check was done since ``before``."""
        return self.check is not before.check or self.checked != before.checked

    def pushed(self, nudge: Nudge) -> Tuning:
        """Return the tuning with a nudge more."""
        x, y, z, a, b, c = (old + new for old, new in zip(self.waiting, nudge, strict=True))
        return self._replace(waiting=(x, y, z, a, b, c))

    def settled(self, time: float, steps: int = len(STEPS)) -> tuple[Tuning, str]:
        """Return the tuning at ``time`` [s], and why nudges could not be taken over, if so.

        Where a check is due it begins; it goes on by so many ``steps``, of which it has three.
        """
        check, after = self.check, self
        if check is None:
            if not any(self.waiting) or time - self.checked < self.settings.period:
                return self, ""
            check = nudge_check(self.settings, self.tuned, self.waiting)
            after = self._replace(checked=time, waiting=STILL)
        for _ in range(steps):
            if not check.over:
                check = check.after_step(self.scene)
        if not check.over:
            return after._replace(check=check), ""
        tuned = self.tuned if check.reason else Tuned(self.tuned.stored, check.offset, check.target)
        return after._replace(check=None, tuned=tuned), check.reason


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
