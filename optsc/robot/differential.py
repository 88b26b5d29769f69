"""The arithmetic of one differential IK tick as CasADi functions: reference model and quadratic cost.

Both are smooth arithmetic without decisions of their own; the rooms above give the settings and read the results.
"""

from __future__ import annotations

import casadi

from optsc.robot.kernels.kinematics import chain
from optsc.robot.model import RobotModel

GRIP = 0.8
"""Share of a dead band that is entirely free; over the rest the component is taken hold of."""


QUICKNESS, SWIFTNESS = 8.0, 2.4
"""Of catching up: omega^2 |e| and omega |de/dt| at most, in units of the braking that is counted on; either way the
reference then accelerates by up to some 1.9 times that (ours)."""


class ReferenceSettings:
    """Layout of the settings vector of `reference_model`; see `optsc.control.servo` for meaning and units."""

    SIZE = 5
    BANDWIDTH = 0
    LINEAR, ANGULAR = slice(1, 3), slice(3, 5)  # braking, greatest speed of catching up


class PoseTaskSettings:
    """Layout of the settings vector of `pose_task`; see `optsc.ik.differential` for meaning and units."""

    SIZE = 23
    WEIGHTS = slice(0, 6)
    GAIN = slice(6, 8)
    LARGEST_ERROR = slice(8, 10)
    POSTURE_WEIGHT = 10
    POSTURE_GAIN = 11
    DAMPING = 12
    ERROR_DAMPING = 13
    TOLERANCE = slice(14, 20)
    BRAKING = slice(20, 22)
    SMOOTHNESS = 22


def _multiply(a: casadi.SX, b: casadi.SX) -> casadi.SX:
    w = a[0] * b[0] - casadi.dot(a[1:], b[1:])
    return casadi.vertcat(w, a[0] * b[1:] + b[0] * a[1:] + casadi.cross(a[1:], b[1:]))


def _conjugate(q: casadi.SX) -> casadi.SX:
    return casadi.vertcat(q[0], -q[1:])


def _exp(v: casadi.SX) -> casadi.SX:
    """Quaternion of a rotation vector; the series of sin(x)/x below 1e-4 keeps all digits."""
    square = casadi.dot(v, v)
    half = 0.5 * casadi.sqrt(square + 1e-300)
    scale = casadi.if_else(square < 1e-8, 0.5 - square / 48.0, 0.5 * casadi.sin(half) / half)
    return casadi.vertcat(casadi.cos(half), scale * v)


def _log(q: casadi.SX) -> casadi.SX:
    """Shortest rotation vector of a unit quaternion; exact for small angles, at most pi long."""
    q = casadi.if_else(q[0] < 0, -q, q)
    sine = casadi.sqrt(casadi.dot(q[1:], q[1:]) + 1e-300)
    scale = casadi.if_else(sine < 1e-9, 2.0, 2.0 * casadi.atan2(sine, q[0]) / sine)
    return scale * q[1:]


def _quaternion_to_matrix(q: casadi.SX) -> casadi.SX:
    w, x, y, z = (q[i] for i in range(4))
    return casadi.vertcat(
        casadi.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        casadi.horzcat(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        casadi.horzcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _at_most(v: casadi.SX, length: casadi.SX) -> casadi.SX:
    return v * casadi.fmin(1.0, length / casadi.sqrt(casadi.dot(v, v) + 1e-300))


def reference_model(fading: float) -> casadi.Function:
    """Return one step of the third-order model that turns a stream of targets into a smooth reference.

    Inputs: reference (19) = p, quaternion, v, w, dv/dt, dw/dt; target (19), the same at a time of its own; elapsed,
    from that time to the end of the step [s]; settings (5), see `ReferenceSettings`; period [s]; the share of the
    target's acceleration that is led on to. Outputs: the next reference (19); its distance and angle to the target (2).
    All in W.

    Until the end of the step the target moves on: with constant acceleration where its time lies ahead of the end
    (``elapsed`` below zero), with one that fades with the time constant ``fading`` [s] where it lies behind. The error
    obeys (d/dt + omega)^3 e = 0: critically damped, so it does not overshoot a resting target, and without lag for a
    target of constant velocity, and of constant acceleration where that is led on to in full. Far from the target
    omega falls, see `_bandwidth`.
    """
    r, t = casadi.SX.sym("reference", 19), casadi.SX.sym("target", 19)
    settings = casadi.SX.sym("settings", ReferenceSettings.SIZE)
    period, elapsed, share = (casadi.SX.sym(name) for name in ("period", "elapsed", "share"))
    p, q, v, w, a, b = r[0:3], r[3:7], r[7:10], r[10:13], r[13:16], r[16:19]
    target_p, target_q, target_v, target_w, target_a, target_b = _moved_on(t, elapsed, fading)
    # Where the target was at the start of this step: the error then follows its own free motion.
    e_p = p - (target_p - period * (target_v - 0.5 * period * target_a))
    back = -period * (target_w - 0.5 * period * target_b)
    e_r = _log(_multiply(q, _conjugate(_multiply(_exp(back), target_q))))
    e_v, e_w = v - target_v + period * target_a, w - target_w + period * target_b
    led_a, led_b = share * target_a, share * target_b
    linear = _catch_up(e_p, e_v, a - led_a, settings, ReferenceSettings.LINEAR, period)
    angular = _catch_up(e_r, e_w, b - led_b, settings, ReferenceSettings.ANGULAR, period)
    next_q = _multiply(_exp(angular[0]), target_q)
    next_q = next_q / casadi.sqrt(casadi.dot(next_q, next_q))
    step = casadi.vertcat(
        target_p + linear[0],
        next_q,
        target_v + linear[1],
        target_w + angular[1],
        led_a + linear[2],
        led_b + angular[2],
    )
    gap = casadi.vertcat(*(casadi.sqrt(casadi.dot(part[0], part[0])) for part in (linear, angular)))
    inputs = [r, t, elapsed, settings, period, share]
    return casadi.Function("reference_model", inputs, [casadi.densify(step), casadi.densify(gap)])


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
    near = _at_most(e, counted)
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
    return casadi.fmin(
        most, casadi.fmin(casadi.sqrt(QUICKNESS * braking / size), SWIFTNESS * braking / speed)
    )


def _moved_on(t: casadi.SX, elapsed: casadi.SX, fading: float) -> tuple[casadi.SX, ...]:
    """Return pose, velocities and accelerations of a target (19) after ``elapsed``, as `operators.prediction`."""
    p, q, v, w, a, b = t[0:3], t[3:7], t[7:10], t[10:13], t[13:16], t[16:19]
    left = casadi.exp(-casadi.fmax(elapsed, 0.0) / fading)
    speed = fading * (1.0 - left)
    known = elapsed <= 0.0
    speed = casadi.if_else(known, elapsed, speed)
    way = casadi.if_else(known, 0.5 * elapsed * elapsed, fading * (elapsed - speed))
    turned = _multiply(_exp(elapsed * w + way * b), q)
    return p + elapsed * v + way * a, turned, v + speed * a, w + speed * b, left * a, left * b


def pose_task(robot: RobotModel) -> casadi.Function:
    """Return the quadratic cost of one tick in the joint velocity.

    Inputs: q (n); reference (7) = p, quaternion of T in W; twist (6), linear over angular, in W; posture (n);
    onward (n), the joint velocity that goes on smoothly; settings
    (23), see `PoseTaskSettings`. Outputs: H (n, n) and g (n) of 1/2 v'Hv + g'v; pose error (6) beyond the
    tolerances, reference minus present, in T's axes [m, rad]; sqrt(det(J J')) or, below six joints, sqrt(det(J'J)).
    """
    n = robot.n
    q, posture, onward = (casadi.SX.sym(name, n) for name in ("q", "posture", "onward"))
    reference, twist = casadi.SX.sym("reference", 7), casadi.SX.sym("twist", 6)
    s = casadi.SX.sym("settings", PoseTaskSettings.SIZE)
    R, p, J = chain(robot, q)
    error = casadi.vertcat(R.T @ (reference[0:3] - p), _rotation_error(R, reference[3:7]))
    error, hold = _beyond(error, s[PoseTaskSettings.TOLERANCE])
    gain, largest = s[PoseTaskSettings.GAIN], s[PoseTaskSettings.LARGEST_ERROR]
    braking = s[PoseTaskSettings.BRAKING]
    pull = casadi.vertcat(_pull(error[:3], gain[0], braking[0]), _pull(error[3:], gain[1], braking[1]))
    wanted = casadi.vertcat(R.T @ twist[:3], R.T @ twist[3:]) + pull
    tool_J = casadi.vertcat(R.T @ J[:3, :], R.T @ J[3:, :])
    weight = hold * s[PoseTaskSettings.WEIGHTS]
    weighted_J = casadi.repmat(weight, 1, n) * tool_J
    posture_weight = s[PoseTaskSettings.POSTURE_WEIGHT]
    # Levenberg-Marquardt damping that grows with the error (Sugihara 2011): next to nothing while the tool is on its
    # reference, and calm where a target is out of reach and the Jacobian loses a direction.
    weighted_error = (
        weight[:3] * _at_most(error[:3], largest[0]),
        weight[3:] * _at_most(error[3:], largest[1]),
    )
    square = casadi.dot(weighted_error[0], weighted_error[0]) + casadi.dot(
        weighted_error[1], weighted_error[1]
    )
    damping = s[PoseTaskSettings.DAMPING] + s[PoseTaskSettings.ERROR_DAMPING] * square
    H = weighted_J.T @ weighted_J + (posture_weight + damping) * casadi.SX.eye(n)
    homeward = s[PoseTaskSettings.POSTURE_GAIN] * (posture - q)
    smoothness = s[PoseTaskSettings.SMOOTHNESS]
    H = H + smoothness * casadi.SX.eye(n)
    g = -weighted_J.T @ (weight * wanted) - posture_weight * homeward - smoothness * onward
    gram = tool_J @ tool_J.T if n >= 6 else tool_J.T @ tool_J
    volume = casadi.sqrt(_determinant(gram))
    outputs = [casadi.densify(x) for x in (H, g, error, volume)]
    return casadi.Function("pose_task", [q, reference, twist, posture, onward, s], outputs)


def _pull(error: casadi.SX, gain: casadi.SX, braking: casadi.SX) -> casadi.SX:
    """Return the velocity towards the reference: in proportion to the error, but never faster than can be braked.

    A joint that has fallen behind because it could not accelerate more cannot decelerate more either. Pulled back by
    proportion alone it overshoots, and goes on doing so.
    """
    size = casadi.sqrt(casadi.dot(error, error) + 1e-300)
    return error * casadi.fmin(gain, casadi.sqrt(braking / size))


def _beyond(error: casadi.SX, tolerance: casadi.SX) -> tuple[casadi.SX, casadi.SX]:
    """Return the error (6) beyond its dead band, and how firmly each component is held (6), in [0, 1].

    Inside the band a component is free. It is taken hold of over the last share of the band, so that nothing
    switches at its edge: there it follows the reference's velocity, and only beyond is it led back.
    """
    size = casadi.fabs(error)
    excess = casadi.sign(error) * casadi.fmax(size - tolerance, 0.0)
    used = size / casadi.fmax(tolerance, 1e-12)
    hold = casadi.fmin(casadi.fmax((used - GRIP) / (1.0 - GRIP), 0.0), 1.0)
    return excess, casadi.if_else(tolerance > 0.0, hold, 1.0)


def _rotation_error(R: casadi.SX, quaternion: casadi.SX) -> casadi.SX:
    """Rotation vector from R to ``quaternion``, in R's own axes: the logarithm of R' R_reference."""
    E = R.T @ _quaternion_to_matrix(quaternion)
    axis = 0.5 * casadi.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1])
    sine = casadi.sqrt(casadi.dot(axis, axis) + 1e-300)
    cosine = 0.5 * (E[0, 0] + E[1, 1] + E[2, 2] - 1.0)
    angle = casadi.atan2(sine, cosine)
    # Near half a turn the antisymmetric part vanishes; its direction then still points the right way, and the
    # length is bounded by the caller's largest error.
    return casadi.if_else(sine < 1e-9, axis, (angle / sine) * axis)


def _determinant(gram: casadi.SX) -> casadi.SX:
    """Determinant of a symmetric positive matrix by LDL': far shorter code than the expansion by minors."""
    D, _, _ = casadi.ldl(gram)
    result = casadi.SX(1)
    for i in range(D.numel()):
        result = result * casadi.fmax(D[i], 0.0)
    return result
