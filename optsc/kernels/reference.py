"""The reference model: a third-order filter that turns a stream of targets into a smooth reference, in CasADi."""

from __future__ import annotations

import casadi

from optsc.kernels import rotations
from optsc.kernels.symbols import symbols

QUICKNESS, SWIFTNESS = 8.0, 2.4
"""Of catching up: omega^2 |e| and omega |de/dt| at most, in units of the braking that is counted on; with either, the
reference then accelerates by up to some 1.9 times that (tuned here)."""

AT_REST = (0.01, 0.05)
"""Speeds of a target [m/s, rad/s] from which on it counts as moving (tuned here)."""


class ReferenceSettings:
    """Layout of the settings vector of `reference_model`; see `optsc.control.servo` for meaning and units."""

    SIZE = 5
    BANDWIDTH = 0
    LINEAR, ANGULAR = slice(1, 3), slice(3, 5)  # braking, greatest speed of catching up


def at_most(v: casadi.SX, length: casadi.SX) -> casadi.SX:
    """Return the vector shortened to ``length`` where it is longer."""
    return v * casadi.fmin(1.0, length / casadi.sqrt(casadi.dot(v, v) + 1e-300))


def reference_model(fading: float) -> casadi.Function:
    """Return one step of the third-order model that turns a stream of targets into a smooth reference.

    Inputs: reference (19) = p, quaternion, v, w, dv/dt, dw/dt; target (19), the same at a time of its own; elapsed,
    from that time to the end of the step [s]; settings (5), see `ReferenceSettings`; period [s]; the share of the
    target's acceleration that is led on to. Outputs: the next reference (19); the target at the end of the step (14) =
    p, quaternion, v, w, and its pace: its speed in units of `AT_REST`. All in W.

    Until the end of the step the target moves on: with constant acceleration where its time lies ahead of the end
    (``elapsed`` below zero), with one that fades with the time constant ``fading`` [s] where it lies behind. The error
    obeys (d/dt + omega)^3 e = 0: critically damped, so it does not overshoot a resting target, and without lag for a
    target of constant velocity, and of constant acceleration where that is led on to in full. Far from the target
    omega falls, see `_bandwidth`.
    """
    size = ReferenceSettings.SIZE
    inputs = symbols(casadi.SX, reference=19, target=19, elapsed=1, settings=size, period=1, share=1)
    r, t, elapsed, settings, period, share = inputs
    p, q, v, w, a, b = r[0:3], r[3:7], r[7:10], r[10:13], r[13:16], r[16:19]
    target_p, target_q, target_v, target_w, target_a, target_b = _moved_on(t, elapsed, fading)
    # Where the target was at the start of this step: the error then follows its own free motion.
    e_p = p - (target_p - period * (target_v - 0.5 * period * target_a))
    back = -period * (target_w - 0.5 * period * target_b)
    e_r = rotations.log(rotations.multiply(q, rotations.conjugate(rotations.multiply(rotations.exp(back), target_q))))
    e_v, e_w = v - target_v + period * target_a, w - target_w + period * target_b
    led_a, led_b = share * target_a, share * target_b
    linear = _catch_up(e_p, e_v, a - led_a, settings, ReferenceSettings.LINEAR, period)
    angular = _catch_up(e_r, e_w, b - led_b, settings, ReferenceSettings.ANGULAR, period)
    next_q = rotations.multiply(rotations.exp(angular[0]), target_q)
    next_q = next_q / casadi.sqrt(casadi.dot(next_q, next_q))
    step = casadi.vertcat(
        target_p + linear[0],
        next_q,
        target_v + linear[1],
        target_w + angular[1],
        led_a + linear[2],
        led_b + angular[2],
    )
    speeds = (casadi.sqrt(casadi.dot(x, x)) for x in (target_v, target_w))
    pace = casadi.fmax(*(speed / least for speed, least in zip(speeds, AT_REST, strict=True)))
    end = casadi.vertcat(target_p, target_q, target_v, target_w, pace)
    return casadi.Function("reference_model", inputs, [casadi.densify(step), casadi.densify(end)])


def _catch_up(
    e: casadi.SX, rate: casadi.SX, acceleration: casadi.SX, s: casadi.SX, which: slice, period: casadi.SX
) -> tuple[casadi.SX, casadi.SX, casadi.SX]:
    """Return error, its rate and acceleration after one exact step of (d/dt + omega)^3 e = 0.

    The generator plus omega times the identity is nilpotent, so the exponential series ends after the second power.
    Of an error longer than the speed of catching up allows, the rest waits.
    """
    entries = s[which]
    braking, speed = entries[0], entries[1]
    counted = speed * speed * 9.0 / (QUICKNESS * braking)
    near = at_most(e, counted)
    omega = _bandwidth(s[ReferenceSettings.BANDWIDTH], braking, near, rate)
    h, pull = period, omega * near
    first = rate + pull
    second = acceleration + omega * (2.0 * rate + pull)
    decay = casadi.exp(-omega * h)
    after = decay * (near + h * first + 0.5 * h * h * second)
    after_rate = decay * (first + h * second) - omega * after
    after_acceleration = decay * second - omega * (2.0 * after_rate + omega * after)
    return (e - near) + after, after_rate, after_acceleration


def _bandwidth(most: casadi.SX, braking: casadi.SX, e: casadi.SX, rate: casadi.SX) -> casadi.SX:
    """Return omega: where the error and its rate are large, no more than the arm can accelerate and brake for.

    The model accelerates by up to 0.23 omega^2 |e| from rest, and by up to 0.8 omega |de/dt| out of a wrong speed.
    """
    size, speed = (casadi.sqrt(casadi.dot(x, x) + 1e-300) for x in (e, rate))
    return casadi.fmin(most, casadi.fmin(casadi.sqrt(QUICKNESS * braking / size), SWIFTNESS * braking / speed))


def _moved_on(t: casadi.SX, elapsed: casadi.SX, fading: float) -> tuple[casadi.SX, ...]:
    """Return pose, velocities and accelerations of a target (19) after ``elapsed``, as `operators.prediction`."""
    p, q, v, w, a, b = t[0:3], t[3:7], t[7:10], t[10:13], t[13:16], t[16:19]
    left = casadi.exp(-casadi.fmax(elapsed, 0.0) / fading)
    speed = fading * (1.0 - left)
    known = elapsed <= 0.0
    speed = casadi.if_else(known, elapsed, speed)
    travelled = casadi.if_else(known, 0.5 * elapsed * elapsed, fading * (elapsed - speed))
    turned = rotations.multiply(rotations.exp(elapsed * w + travelled * b), q)
    return p + elapsed * v + travelled * a, turned, v + speed * a, w + speed * b, left * a, left * b
