"""Manual mode with assistance: the hand's motion and the robot's, blended and integrated from where the tool is.

The hand is coupled in relative motion: it asks for increments, and where the assistance has led the tool meanwhile is
where the next increment starts from. So assistance can come and go, and the clutch with it, and the tool never jumps.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp, hypot
from typing import NamedTuple

import numpy as np

from optsc.control.activities import Activity, Assistance, Coupling, HandInput, Outcome
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
"""Time constant [s] with which a policy's blend comes in after the clutch has closed, and changes (tuned here)."""


class Asked(NamedTuple):
    """What the hand asks for at a tick: a step (6,) [m, rad], and the velocity (6,) that it belongs to [m/s, rad/s]."""

    step: Array
    velocity: Array


class Assisted(NamedTuple):
    """Follow the hand and the robot, as an arbitration policy blends them.

    Attributes:
        policy: how hand and robot are blended.
        approach: the robot's speeds, which what it adds keeps to.
        coupling: of the hand.
        track: of what the hand alone would have led the tool to; None while the hand is not coupled.
        wish: that pose at the last tick.
        at: the pose that hand and robot have led the tool to.
        last: the policy's last answer.
        blend: what of its answers has come in.
    """

    policy: Arbitration
    approach: Approach
    coupling: Coupling
    track: Track | None = None
    wish: tuple[Vector, Quaternion] | None = None
    at: tuple[Vector, Quaternion] = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    last: Blend = HAND_ALONE
    blend: Blend = HAND_ALONE

    @classmethod
    def begin(
        cls, policy: Arbitration, approach: Approach, clutch: ClutchSettings, smoothing: Smoothing | None
    ) -> Assisted:
        """Return the mode with an open clutch.

        Its orientation is relative in any case, as an absolute one leaves nothing to assist.
        """
        return cls(policy, approach, Coupling(replace(clutch, orientation="relative"), smoothing))

    def released(self) -> Assisted:
        """Return the mode with an open clutch."""
        return Assisted(self.policy, self.approach, self.coupling.released())

    def step(self, servo: Servo, hand: HandInput, opening: float) -> tuple[Activity, Outcome]:
        """Do one tick; see `optsc.control.activities.Activity`."""
        if hand.hand is None or not hand.clutch:
            return self.released(), Outcome(servo.stop())
        now, reason = self.after(servo, hand.hand) if hand.new else (self, "")
        track = now.track
        if track is None or servo.time - track.stamp > servo.settings.timeout:
            return self.released(), Outcome(servo.stop(), reason="the newest sample of the hand is too old")
        wish, asked = now.asked(servo, track)
        moment = Moment(*now.at, asked.velocity, hand.goals, hand.gap, now.last, servo.period, self.approach)
        hand_gain, robot, robot_share = self.policy.blend(moment)
        # Copies: the answer is part of the state, and a policy may use its arrays again. It sees them at the next tick.
        answer = Blend(np.array(hand_gain, dtype=float), np.array(robot, dtype=float), float(robot_share))
        answer.hand.flags.writeable = answer.robot.flags.writeable = False
        if not _usable(answer):
            fault = f"{self.policy.name} gave no finite blend"
            return self.released(), Outcome(servo.stop(), Event.FAULT, fault)
        return now._replace(wish=wish, last=answer).moved(servo, asked, answer, reason)

    def after(self, servo: Servo, hand: Hand) -> tuple[Assisted, str]:
        """Return the mode after a new sample, and a message where the hand had to be coupled again."""
        coupling, coupled = self.coupling.after(hand, servo.reference)
        pose = coupled.p, coupled.q
        if coupled.again or self.track is None:
            track = prediction.at_rest(*pose, coupled.stamp)
            begun = Assisted(self.policy, self.approach, coupling, track, pose, servo.reference)
            return begun, coupled.reason
        track = prediction.updated(servo.settings.prediction, self.track, *pose, coupled.stamp)
        return self._replace(coupling=coupling, track=track), coupled.reason

    def asked(self, servo: Servo, track: Track) -> tuple[tuple[Vector, Quaternion], Asked]:
        """Return where the hand alone leads the tool now, and how it has moved since the last tick.

        It is predicted as the servo predicts its targets.
        """
        settings = servo.settings
        elapsed = max(servo.time - track.stamp + servo.period - settings.lag, -settings.prediction.hindsight)
        coasting = elapsed <= settings.prediction.horizon
        p, q = prediction.predicted(track, elapsed if coasting else settings.prediction.horizon)
        last_p, last_q = self.wish or (p, q)
        turn = scalar.log(scalar.multiply(q, scalar.conjugate(last_q)))
        step = np.array([p[0] - last_p[0], p[1] - last_p[1], p[2] - last_p[2], *turn])
        velocity = np.array([*track.v, *track.w]) if coasting else np.zeros(6)
        velocity.flags.writeable = False  # a policy is given it, and the speed limit below relies on it
        return (p, q), Asked(step, velocity)

    def moved(self, servo: Servo, asked: Asked, answer: Blend, reason: str) -> tuple[Activity, Outcome]:
        """Move the target by what is blended, and the tool after it."""
        speeds = self.approach.speed, self.approach.angular_speed
        share = 1.0 - exp(-servo.period / COMING_IN)
        A, r, _ = self.blend
        A = A + share * (answer.hand - A)
        r = r + share * (_bounded(answer.robot, speeds) - r)
        robot = r * self._room(servo)
        twist = _no_faster(A @ asked.velocity + robot, asked.velocity, speeds)
        longest = speeds[0] * servo.period, speeds[1] * servo.period
        step = _no_faster(A @ asked.step + robot * servo.period, asked.step, longest).tolist()
        (x, y, z), q = self.at
        turned = scalar.normalised(scalar.multiply(scalar.exp((step[3], step[4], step[5])), q))
        at = _within_reach((x + step[0], y + step[1], z + step[2]), turned, servo)
        u = twist.tolist()
        command = servo.track(*at, (u[0], u[1], u[2]), (u[3], u[4], u[5]))
        assistance = Assistance(asked.velocity, robot, twist, answer.share)
        after = self._replace(at=at, blend=Blend(A, r, answer.share))
        return after, Outcome(command, reason=reason, assistance=assistance)

    def _room(self, servo: Servo) -> float:
        """Return the share of its wish that the robot may add: less, the further the arm is behind, as at a limit."""
        (x, y, z), q = self.at
        (rx, ry, rz), rq = servo.reference
        far_p, far_r = servo.settings.far
        behind = max(
            hypot(x - rx, y - ry, z - rz) / far_p,
            scalar.angle(scalar.multiply(q, scalar.conjugate(rq))) / far_r,
        )
        return max(0.0, 1.0 - behind)


def _within_reach(p: Vector, q: Quaternion, servo: Servo) -> tuple[Vector, Quaternion]:
    """Return a pose no further ahead than counts as within reach: what the arm cannot follow is not saved up.

    The hand asks for increments; those that lead nowhere are lost, and the motion back begins at once.
    """
    (rx, ry, rz), rq = servo.reference
    far_p, far_r = servo.settings.far
    x, y, z = scalar.shortened((p[0] - rx, p[1] - ry, p[2] - rz), far_p)
    ahead = scalar.log(scalar.multiply(q, scalar.conjugate(rq)))
    if hypot(*ahead) > far_r:
        q = scalar.multiply(scalar.exp(scalar.shortened(ahead, far_r)), rq)
    return (rx + x, ry + y, rz + z), q


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
