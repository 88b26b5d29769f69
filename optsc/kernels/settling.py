"""Settling: an arm that cannot get nearer to a target at rest comes to rest, instead of creeping on, in CasADi.

Beyond reach, the quadratic program goes on to move joints for next to nothing: along directions that hardly change the
tool's distance, ever more slowly. The wished velocity is therefore given in full only while one of these holds; below
half of all of them the arm is brought to rest, and in between the share rises evenly:

* the target moves (`optsc.kernels.reference.AT_REST`);
* the tool comes nearer by at least the share `PRODUCTIVE` of what is asked of it;
* it comes nearer by at least the share `WORTHWHILE` of its distance per second;
* it comes nearer at all, and a joint moves faster than the share `SLOW` of its greatest velocity.

Whether it comes nearer by enough is asked of an arm at rest as if its joints could change their velocities at once: it
can only begin slowly.

The last two grow with the time that the first two have not held, in units of `PATIENCE`: with its square, and with its
fourth power. For the first `GRACE` of it everything is given. It begins again where the target goes to another place.
So an arm that is arriving is never stopped, one that finds nothing to gain stops within about two seconds, and one that
is freed (an obstacle leaves, the target comes back) goes on at once.
"""

from __future__ import annotations

import casadi

from optsc.kernels import rotations
from optsc.kernels.chain import Chain, tool_kinematics
from optsc.kernels.pose_task import beyond
from optsc.kernels.symbols import symbols

PRODUCTIVE = 0.5
"""Share of the progress asked for (tuned here)."""
WORTHWHILE = 0.5
"""Progress per second, as share of the error [1/s] (tuned here)."""
SLOW = 0.05
"""Share of the greatest joint velocities (tuned here)."""
PATIENCE = 1.0
"""Time [s] after which both of these have doubled (tuned here)."""
LONGEST = 3.0
"""Time [s] from which on they grow no more (tuned here)."""
GRACE = 0.3
"""Time [s] that an arm is given to find out of a singularity, where nothing seems to be gained (tuned here)."""
ANOTHER_PLACE = (5e-3, 0.02)
"""Distance and angle [m, rad] by which a target is at another place (tuned here): more than the tremor of a hand."""
NEGLIGIBLE = 1e-8
"""Square of a weighted pose error that no motion is worth: 0.1 mm at a weight of one."""
WAITING = 8
"""Numbers that are kept from tick to tick: how long there was little to gain [s], and position and quaternion of the
target at which that time began."""


class SettlingSettings:
    """Layout of the settings vector of `settled` before the n greatest joint velocities [rad/s]."""

    SIZE = 15
    COMPONENTS = slice(0, 6)  # which components of the tool's pose count, one or zero
    TOLERANCE = slice(6, 12)
    PERIOD = 12
    SMOOTHNESS = 13
    ONWARD = 14


def settled(chain: Chain) -> casadi.Function:
    """Return what is given of a wished joint velocity, and how far the tool then is from its target.

    Inputs: joints (n, 3), positions, velocities and accelerations; the wish (n); the same for joints that can change
    their velocities at once (n), and one where that is asked; the descent (n + 2) of `pose_task`; the target at the end
    of the tick (14) of `reference_model`; waiting (`WAITING`); interval (n, 2) that the velocity is held in; one where
    the wish has to be given; settings (15 + n), see `SettlingSettings`.

    Outputs: the velocity (n); the waiting after the tick; the error (6) at its end, target minus tool in T's axes,
    beyond the tolerances, in the components that count; distance and angle of that error, speed and angular speed of
    the target, and the greatest share of its greatest velocity that a joint has (5).
    """
    n = chain.n
    inputs = symbols(
        casadi.SX,
        joints=(n, 3),
        wish=n,
        free=n,
        resting=1,
        descent=n + 2,
        target=14,
        waiting=WAITING,
        interval=(n, 2),
        bound=1,
        settings=SettlingSettings.SIZE + n,
    )
    joints, wish, free, resting, descent, target, waiting, interval, bound, s = inputs
    period, weight, most = s[SettlingSettings.PERIOD], s[SettlingSettings.SMOOTHNESS], s[SettlingSettings.SIZE :]
    q, v, a = (joints[:, k] for k in range(3))
    # What the smoothness task has made of the wish is undone, or an arm at rest would seem to have none.
    onward = weight * (v + s[SettlingSettings.ONWARD] * a)
    plain = (1.0 + weight) * wish - onward
    free = casadi.if_else(resting > 0.0, free, plain)
    progress = [casadi.dot(descent[:n], x) for x in (plain, free)]
    share, after = _share(plain / most, progress, descent[n:], target, waiting, period)
    share = casadi.if_else(bound > 0.0, 1.0, share)
    given = wish - (1.0 - share) / (1.0 + weight) * plain
    given = casadi.fmin(casadi.fmax(given, interval[:, 0]), interval[:, 1])
    R, p, _ = tool_kinematics(chain, q + 0.5 * period * (v + given))
    turn = rotations.smooth_from_matrix(R.T @ rotations.to_matrix(target[3:7]))
    error, _ = beyond(casadi.vertcat(R.T @ (target[0:3] - p), turn), s[SettlingSettings.TOLERANCE])
    error = s[SettlingSettings.COMPONENTS] * error
    parts = error[:3], error[3:], target[7:10], target[10:13]
    fastest = casadi.mmax(casadi.fabs(given) / most)
    sizes = casadi.vertcat(*(casadi.sqrt(casadi.dot(part, part)) for part in parts), fastest)
    return casadi.Function("settled", inputs, [casadi.densify(x) for x in (given, after, error, sizes)])


def _share(
    speeds: casadi.SX,
    progress: list[casadi.SX],
    of: casadi.SX,
    target: casadi.SX,
    waiting: casadi.SX,
    period: casadi.SX,
) -> tuple[casadi.SX, casadi.SX]:
    """Return the share that is given, in [0, 1], and the waiting after the tick."""
    square, asked = of[0], of[1]
    moving = casadi.fmax(target[13], progress[1] / (PRODUCTIVE * (asked + NEGLIGIBLE)))
    fresh = casadi.logic_or(waiting[0] == 0.0, _elsewhere(waiting[1:], target))
    anchor = casadi.if_else(fresh, target[:7], waiting[1:])
    waited = casadi.fmin(casadi.if_else(fresh, 0.0, waiting[0]) + period, LONGEST)
    growth = 1.0 + (waited / PATIENCE) ** 2
    rate = progress[0] / (WORTHWHILE * growth * (square + NEGLIGIBLE))
    speed = casadi.mmax(casadi.fabs(speeds)) / (SLOW * growth**2)
    most = casadi.fmax(casadi.fmax(moving, rate), casadi.if_else(progress[0] > 0.0, speed, 0.0))
    share = casadi.fmin(casadi.fmax(2.0 * most - 1.0, 0.0), 1.0)
    arriving = moving >= 1.0
    share = casadi.if_else(casadi.logic_or(arriving, waited < GRACE), 1.0, share)
    return share, casadi.vertcat(casadi.if_else(arriving, 0.0, waited), anchor)


def _elsewhere(anchor: casadi.SX, target: casadi.SX) -> casadi.SX:
    """Tell whether a target is at another place than the anchor (7)."""
    shift = target[:3] - anchor[:3]
    # Four times the square of the chord of unit quaternions is that of the angle, as far as it is small.
    chord = 2.0 - 2.0 * casadi.fabs(casadi.dot(anchor[3:], target[3:7]))
    return casadi.logic_or(casadi.dot(shift, shift) > ANOTHER_PLACE[0] ** 2, 4.0 * chord > ANOTHER_PLACE[1] ** 2)
