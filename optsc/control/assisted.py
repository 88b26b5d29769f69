"""Manual mode with assistance: the hand's motion and the robot's, blended and integrated from where the tool is.

The hand is coupled relatively: it asks for increments of motion, and where the assistance has led the tool meanwhile
is where the next increment starts from. So assistance can come and go, and the clutch with it, and the tool never
jumps.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp, hypot
from typing import NamedTuple

import numpy as np

from optsc.control.activities import Assistance, Coupling, HandInput, Outcome
from optsc.control.approach import Approach
from optsc.control.arbitration import HAND_ALONE, Arbitration, Blend, Moment
from optsc.control.modes import Event
from optsc.control.servo import Servo
from optsc.geometry import scalar
from optsc.geometry.rotation import Array
from optsc.geometry.scalar import Quaternion, Vector
from optsc.operators import prediction
from optsc.operators.clutch import ClutchSettings, Hand
from optsc.operators.prediction import Track
from optsc.operators.smoothing import Smoothing

COMING_IN = 0.15
"""Time constant [s] with which a policy's blend comes in after the clutch has closed, and changes (ours)."""


class Asked(NamedTuple):
    """What the hand asks for at a tick: a step (6,) [m, rad], and the velocity (6,) that it belongs to [m/s, rad/s]."""

    step: Array
    velocity: Array


class Assisted:
    """Follow the hand and the robot, as an arbitration policy blends them.

    Args:
        settings: of the clutch; orientation is relative in any case, as an absolute one leaves nothing to assist.
        smoothing: of the hand, if any.
        policy: how hand and robot are blended.
        approach: the robot's speeds, which what it adds keeps to.
    """

    def __init__(
        self, settings: ClutchSettings, smoothing: Smoothing | None, policy: Arbitration, approach: Approach
    ) -> None:
        self._coupling = Coupling(replace(settings, orientation="relative"), smoothing)
        self._policy, self._approach = policy, approach
        self._release()

    def _release(self) -> None:
        self._coupling.release()
        self._track: Track | None = None  # of what the hand alone would have led the tool to
        self._wish: tuple[Vector, Quaternion] | None = None  # the same at the last tick
        self._last, self._blend = HAND_ALONE, HAND_ALONE

    def step(self, servo: Servo, hand: HandInput, opening: float) -> Outcome:
        """Do one tick; see `optsc.control.activities.Activity`."""
        if hand.hand is None or not hand.clutch:
            self._release()
            return Outcome(servo.stop())
        reason = self._take_in(servo, hand.hand) if hand.new else ""
        track = self._track
        if track is None or servo.time - track.stamp > servo.settings.timeout:
            self._release()
            return Outcome(servo.stop(), reason="the newest sample of the hand is too old")
        asked = self._asked(servo, track)
        moment = Moment(
            *self._at, asked.velocity, hand.goals, hand.gap, self._last, servo.period, self._approach
        )
        answer = self._policy.blend(moment)
        if not _usable(answer):
            self._release()
            return Outcome(servo.stop(), Event.FAULT, f"{self._policy.name} gave no finite blend")
        self._last = answer
        return self._moved(servo, asked, answer, reason)

    def _take_in(self, servo: Servo, hand: Hand) -> str:
        coupled = self._coupling.take_in(hand, servo.reference)
        pose = coupled.p, coupled.q
        if coupled.anew or self._track is None:
            self._release_blend(servo)
            self._track, self._wish = prediction.at_rest(*pose, coupled.stamp), pose
        else:
            self._track = prediction.updated(servo.settings.prediction, self._track, *pose, coupled.stamp)
        return coupled.reason

    def _release_blend(self, servo: Servo) -> None:
        self._at = servo.reference
        self._last = self._blend = HAND_ALONE

    def _asked(self, servo: Servo, track: Track) -> Asked:
        """Return the motion of the hand since the last tick, predicted as the servo predicts its targets."""
        settings = servo.settings
        elapsed = servo.time - track.stamp + servo.period - settings.lag
        coasting = elapsed <= settings.prediction.horizon
        p, q = prediction.predicted(track, elapsed if coasting else settings.prediction.horizon)
        last_p, last_q = self._wish or (p, q)
        self._wish = p, q
        turn = scalar.log(scalar.multiply(q, scalar.conjugate(last_q)))
        step = np.array([p[0] - last_p[0], p[1] - last_p[1], p[2] - last_p[2], *turn])
        velocity = np.array([*track.v, *track.w])
        if not coasting:
            velocity[:] = 0.0
        return Asked(step, velocity)

    def _moved(self, servo: Servo, asked: Asked, answer: Blend, reason: str) -> Outcome:
        """Move the target by what is blended, and the tool after it."""
        speeds = self._approach.speed, self._approach.angular_speed
        share = 1.0 - exp(-servo.period / COMING_IN)
        A, r, _ = self._blend
        A = A + share * (answer.hand - A)
        r = r + share * (_bounded(answer.robot, speeds) - r)
        self._blend = Blend(A, r, answer.share)
        robot = r * self._room(servo)
        twist = _no_faster(A @ asked.velocity + robot, asked.velocity, speeds)
        way = speeds[0] * servo.period, speeds[1] * servo.period
        step = _no_faster(A @ asked.step + robot * servo.period, asked.step, way).tolist()
        (x, y, z), q = self._at
        turned = scalar.normalised(scalar.multiply(scalar.exp((step[3], step[4], step[5])), q))
        self._at = self._held((x + step[0], y + step[1], z + step[2]), turned, servo)
        u = twist.tolist()
        command = servo.track(*self._at, (u[0], u[1], u[2]), (u[3], u[4], u[5]))
        return Outcome(
            command, reason=reason, assistance=Assistance(asked.velocity, robot, twist, answer.share)
        )

    def _held(self, p: Vector, q: Quaternion, servo: Servo) -> tuple[Vector, Quaternion]:
        """Return a pose no further ahead than counts as within reach: what the arm cannot follow is not saved up.

        The hand asks for increments; those that lead nowhere are lost, and the way back begins at once.
        """
        (rx, ry, rz), rq = servo.reference
        far_p, far_r = servo.settings.far
        x, y, z = scalar.shortened((p[0] - rx, p[1] - ry, p[2] - rz), far_p)
        ahead = scalar.log(scalar.multiply(q, scalar.conjugate(rq)))
        if hypot(*ahead) > far_r:
            q = scalar.multiply(scalar.exp(scalar.shortened(ahead, far_r)), rq)
        return (rx + x, ry + y, rz + z), q

    def _room(self, servo: Servo) -> float:
        """Return the share of its wish that the robot may add: less, the further the arm is behind, as at a limit."""
        (x, y, z), q = self._at
        (rx, ry, rz), rq = servo.reference
        far_p, far_r = servo.settings.far
        behind = max(
            hypot(x - rx, y - ry, z - rz) / far_p,
            scalar.angle(scalar.multiply(q, scalar.conjugate(rq))) / far_r,
        )
        return max(0.0, 1.0 - behind)


def _usable(blend: Blend) -> bool:
    shapes = blend.hand.shape == (6, 6) and blend.robot.shape == (6,)
    # Magnitudes carry what is not finite, and do not cancel.
    return shapes and bool(np.isfinite(np.abs(blend.hand).sum() + np.abs(blend.robot).sum() + blend.share))


def _bounded(twist: Array, most: tuple[float, float]) -> Array:
    return _no_faster(twist, np.zeros(6), most)


def _no_faster(twist: Array, hand: Array, more: tuple[float, float]) -> Array:
    """Return ``twist`` (6,), whose two parts are no longer than the hand's by more than ``more`` [per part]."""
    x, y, z, a, b, c = hand.tolist()
    t = twist.tolist()
    linear = scalar.shortened((t[0], t[1], t[2]), hypot(x, y, z) + more[0])
    angular = scalar.shortened((t[3], t[4], t[5]), hypot(a, b, c) + more[1])
    return np.array([*linear, *angular])
