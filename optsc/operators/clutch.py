"""Clutch: how a hand's motion becomes the tool's, without a jump whenever the two are coupled again.

Position is always relative to the point of engagement (Chen et al. 2023, section II.A, equations 1 and 2, with the
station's rotation that the text leaves out):

    p_WT = p_WT,0 + scale R_WS (p_SH - p_SH,0)

Orientation is either absolute, R_WT = R_WS R_SH, the paper's setting, where the mismatch at engagement fades out by
SLERP (equation 3); or relative to the point of engagement, the practice elsewhere. A hand that jumps, or that comes
back after it was lost, wishes nothing by that: it is then coupled with an offset that does not fade,

    R_WT = R_WS R_SH R_offset

until the operator engages the clutch again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, hypot, log
from typing import Annotated, Literal, NamedTuple

from optsc.checks import Above, Below, Checked, Each, NonNegative, Positive, require
from optsc.errors import InvalidValue
from optsc.geometry import scalar
from optsc.geometry.rotation import checked
from optsc.geometry.scalar import Quaternion, Vector

_NONE: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Slerp(Checked):
    """How an orientation mismatch fades.

    Attributes:
        time_constant: of the decay [s]; independent of the rate.
        largest_rate: bound of the angular speed that the fading adds [rad/s]. A constant interpolation factor alone
            means a speed of several turns per second after a switch.
        lagging: False lets only the mismatch of the moment of engagement fade, so that a moving hand is followed
            without lag. True filters the orientation for ever, which is equation 3 of the paper to the letter.
            With a hand at rest both are the same.
    """

    time_constant: Annotated[float, Above(0.0)] = 0.1
    largest_rate: Annotated[float, Above(0.0)] = 1.0
    lagging: bool = False

    @classmethod
    def paper(cls, alpha: float, sample_rate: float) -> Slerp:
        """Return equation 3 of the paper: a constant factor ``alpha`` in (0, 1) per sample, unbounded in speed.

        The factor is the share 1 - exp(-T / time_constant) of the mismatch that fades in one sample period T.
        """
        require("alpha", alpha, Above(0.0), Below(1.0))
        require("sample_rate", sample_rate, Positive)
        return cls(-1.0 / (sample_rate * log(1.0 - alpha)), float("inf"), lagging=True)

    def remaining(self, mismatch: Quaternion, elapsed: float) -> Quaternion:
        """Return what is left of ``mismatch`` after ``elapsed`` [s]."""
        vector = scalar.log(mismatch)
        angle = hypot(*vector)
        if angle < 1e-12 or elapsed <= 0.0:
            return mismatch
        left = max(angle * exp(-elapsed / self.time_constant), angle - self.largest_rate * elapsed)
        scale = left / angle
        return scalar.exp((vector[0] * scale, vector[1] * scale, vector[2] * scale))


@dataclass(frozen=True)
class ClutchSettings(Checked):
    """How a hand's motion maps to the tool's.

    Attributes:
        R_WS: unit quaternion of the operator's station in the world; the paper's R_htc.
        scale: tool displacement per hand displacement.
        rotation_scale: tool rotation per hand rotation; needs relative orientation.
        orientation: ``absolute`` (the paper) or ``relative``.
        slerp: how the mismatch of an absolute orientation fades.
        fade: time over which the hand's motion comes in after the clutch has closed [s]. From then on the mapping is
            equations 1 and 2 to the letter; until then a share of the displacement is held back, so that an arm at rest
            is not asked for a jump of speed when a hand is coupled that is already moving. Zero is the paper's.
        largest_step: distance and angle from one sample to the next [m, rad] beyond which a hand has not moved but
            jumped, as trackers do: it is then coupled again where it is.
        largest_acceleration: of a hand [m/s^2, rad/s^2]. Shorter steps are jumps, too, where they are further from a
            steady motion than this allows, and the noise: 30 degrees within 2 ms are no motion of a hand.
        noise: by how much a tracker may be off in one sample [m, rad].
    """

    R_WS: Quaternion = (1.0, 0.0, 0.0, 0.0)
    scale: Annotated[float, Positive] = 1.0
    rotation_scale: Annotated[float, Positive] = 1.0
    orientation: Literal["absolute", "relative"] = "absolute"
    slerp: Slerp = Slerp()
    fade: Annotated[float, NonNegative] = 0.5
    largest_step: Annotated[tuple[float, float], Each(Above(0.0))] = (0.1, 0.6)
    largest_acceleration: Annotated[tuple[float, float], Each(Above(0.0))] = (100.0, 300.0)
    noise: Annotated[tuple[float, float], Each(Above(0.0))] = (0.01, 0.035)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "R_WS", tuple(checked(self.R_WS, "ClutchSettings.R_WS").tolist()))
        if self.orientation == "absolute" and self.rotation_scale != 1.0:
            valid = "1 where the orientation is absolute"
            raise InvalidValue("ClutchSettings.rotation_scale", self.rotation_scale, valid)


class ClutchState(NamedTuple):
    """What the clutch remembers between samples: the last hand, the last target, and what still fades.

    Attributes:
        hand_p, hand_q: hand in the world's axes at the last sample.
        tool_p, tool_q: target of the tool at the last sample.
        mismatch: rotation that still separates tool and hand and fades, applied on the left of the hand's.
        offset: rotation that stays between them, on the right of an absolute hand's, so that the tool turns about the
            axes that the hand turns about; none unless the hand jumped or was lost.
        stamp: time of the last sample [s].
        since: when the clutch closed [s].
        displacement, turn: how far the target was to go since then [m], and the sum of its turns [rad].
        held: share of both that is held back.
    """

    hand_p: Vector
    hand_q: Quaternion
    tool_p: Vector
    tool_q: Quaternion
    mismatch: Quaternion
    stamp: float
    since: float
    displacement: Vector = (0.0, 0.0, 0.0)
    turn: Vector = (0.0, 0.0, 0.0)
    held: float = 1.0
    offset: Quaternion = _NONE


class Hand(NamedTuple):
    """A hand's position and orientation in the station frame, and when it was there [s]."""

    p: Vector
    q: Quaternion
    stamp: float


def engage(
    settings: ClutchSettings, hand: Hand, tool_p: Vector, tool_q: Quaternion, keeps_offset: bool = False
) -> ClutchState:
    """Return the clutch coupled at the tool's present target, which therefore does not move.

    The mismatch in orientation fades, unless the clutch ``keeps_offset``: then it stays as it is.
    """
    hand_p = scalar.rotate(settings.R_WS, hand.p)
    hand_q = scalar.multiply(settings.R_WS, scalar.normalised(hand.q))
    mismatch, offset = scalar.multiply(tool_q, scalar.conjugate(hand_q)), _NONE
    if keeps_offset:
        mismatch, offset = _NONE, scalar.multiply(scalar.conjugate(hand_q), tool_q)
    return ClutchState(hand_p, hand_q, tool_p, tool_q, mismatch, hand.stamp, hand.stamp, offset=offset)


def follow(settings: ClutchSettings, state: ClutchState, hand: Hand) -> ClutchState:
    """Return the clutch after the hand has moved; `tool_p`, `tool_q` are the new target.

    Steps are added up from sample to sample: the sum of the displacements is the paper's difference to the point
    of engagement, and a scaled rotation stays continuous beyond half a turn.
    """
    hand_p = scalar.rotate(settings.R_WS, hand.p)
    hand_q = scalar.multiply(settings.R_WS, scalar.normalised(hand.q))
    held = _held(settings.fade, hand.stamp - state.since)
    step = _times(settings.scale, _minus(hand_p, state.hand_p))
    displacement = _plus(state.displacement, step)
    tool_p = _plus(state.tool_p, step)
    if held or state.held:
        tool_p = _plus(tool_p, _minus(_times(state.held, state.displacement), _times(held, displacement)))
    mismatch, turn = state.mismatch, state.turn
    if settings.orientation == "relative":
        hand_turn = scalar.log(scalar.multiply(hand_q, scalar.conjugate(state.hand_q)))
        tool_turn = _times(settings.rotation_scale, hand_turn)
        turn = _plus(state.turn, tool_turn)
        tool_q = state.tool_q
        if state.held:
            tool_q = scalar.multiply(scalar.exp(_times(state.held, state.turn)), tool_q)
        tool_q = scalar.multiply(scalar.exp(tool_turn), tool_q)
        if held:
            tool_q = scalar.multiply(scalar.exp(_times(-held, turn)), tool_q)
    else:
        asked = scalar.multiply(hand_q, state.offset)
        if settings.slerp.lagging:
            # The paper filters towards the hand's orientation: what the hand turned since adds to the mismatch.
            mismatch = scalar.multiply(state.tool_q, scalar.conjugate(asked))
        mismatch = settings.slerp.remaining(mismatch, hand.stamp - state.stamp)
        tool_q = scalar.multiply(mismatch, asked)
    tool_q = scalar.normalised(tool_q)
    return ClutchState(
        hand_p, hand_q, tool_p, tool_q, mismatch, hand.stamp, state.since, displacement, turn, held, state.offset
    )


def _held(fade: float, elapsed: float) -> float:
    """Return the share of the displacement since the clutch closed that is held back ``elapsed`` [s] later: (1 - u)^2.

    Of a steady hand's displacement v t the target then goes v t (2 u - u^2): it starts from rest, speeds up by
    4 v / fade at most, and makes up for what it was behind at no more than 4/3 of the hand's speed.
    """
    if elapsed >= fade:
        return 0.0
    left = 1.0 - max(elapsed, 0.0) / fade
    return left * left


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _times(k: float, a: Vector) -> Vector:
    return k * a[0], k * a[1], k * a[2]


def recentred(settings: ClutchSettings, hand: Hand, tool_q: Quaternion) -> ClutchSettings:
    """Return settings whose station is turned about the vertical so that the hand now heads where the tool does.

    "Forward" is then what the operator means by it; tilts are left alone.
    """
    hand_q = scalar.multiply(settings.R_WS, scalar.normalised(hand.q))
    heading = scalar.twist_about(scalar.multiply(tool_q, scalar.conjugate(hand_q)), (0.0, 0.0, 1.0))
    return replace(settings, R_WS=scalar.multiply(scalar.exp((0.0, 0.0, heading)), settings.R_WS))
