"""Distances of an arm's capsules to a table, to boxes and to each other, with their gradients, as CasADi functions.

Every pair gives one row g(q) v >= lower on the joint velocity v, where g is the gradient of its distance d. The rate
at which d may fall is the one from which the arm can brake with the deceleration A after a delay T:

    allowed(d) = sqrt((A T)^2 + 2 A d) - A T     for d > 0,        max(d / T, -push)     for d <= 0.

It has the slope 1/T on both sides of d = 0, the end of the margin, so an arm comes to rest there without a jolt.

Distances of segments are blended: phi = min |p(t) - c|^2 + e (t - 1/2)^2 with a small e instead of the plain minimum, so
that the nearest point runs along a segment which lies parallel to something, where it would jump otherwise. The
gradient stays exact (the minimiser's motion does not enter, as at any minimum), and taking `BLEND` off the result
keeps it below the true distance wherever two bodies do not touch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi
import numpy as np

from optsc.geometry.rotation import Array
from optsc.robot.capsules import LinkCapsules
from optsc.robot.kernels.kinematics import _constant, _rotation_about, axis_of
from optsc.robot.model import RobotModel

BLEND = 1e-3
"""What blending may take off a distance [m]."""
TINY = 1e-12
"""Squares of lengths below this [m^2] count as zero."""
FLAT = 1e-4
"""Gradients shorter than this [m/rad] are no row: no motion of the arm changes such a distance."""
HEAD = 3
"""Entries of a row before its gradient: need, lower, distance."""


class RowSettings:
    """Layout of the settings vector; see `optsc.ik.avoidance` for meaning and units."""

    SIZE = 6
    MARGIN, TABLE_HEIGHT, BRAKING, MOST_BRAKING, DELAY, PUSH = range(6)


class Box:
    """Layout of what describes one box: rotation (column by column), centre, half extents, twist, two flags."""

    SIZE = 23
    ROTATION, CENTRE, HALF = slice(0, 9), slice(9, 12), slice(12, 15)
    LINEAR, ANGULAR = slice(15, 18), slice(18, 21)
    ABSENT, HAND_MAY_TOUCH = 21, 22


def _norm(x: casadi.SX) -> casadi.SX:
    return casadi.sqrt(casadi.dot(x, x))


def _clip(x: casadi.SX) -> casadi.SX:
    return casadi.fmin(casadi.fmax(x, 0.0), 1.0)


class _Frame(NamedTuple):
    """The frame of a joint: rotation and position in W, the joint's axis in W, whether it slides."""

    R: casadi.SX
    p: casadi.SX
    axis: casadi.SX
    origin: casadi.SX
    slides: bool


def _joint_frames(robot: RobotModel, q: casadi.SX) -> list[_Frame]:
    """Return the frame that each joint moves, for a serial chain."""
    R, p = casadi.SX.eye(3), casadi.SX(3, 1)
    frames = []
    for i in range(robot.n):
        placement = robot.model.jointPlacements[i + 1]
        p, R = p + R @ _constant(placement.translation), R @ _constant(placement.rotation)
        local, slides = axis_of(robot, i)
        axis, origin = R @ _constant(local), p
        p, R = (p + axis * q[i], R) if slides else (p, R @ _rotation_about(local, q[i]))
        frames.append(_Frame(R, p, axis, origin, slides))
    return frames


class _Rows:
    """Expressions that turn a distance and its gradient into one row, for an arm of n joints."""

    CAPSULE = 8  # two ends, greatest speed of a point at this tick, number of the joint

    def __init__(self, robot: RobotModel) -> None:
        n = self.n = robot.n
        self.capsule = casadi.SX.sym("capsule", self.CAPSULE)
        self.other = casadi.SX.sym("other", self.CAPSULE)
        self.low, self.high = casadi.SX.sym("low", n), casadi.SX.sym("high", n)
        self.settings = casadi.SX.sym("settings", RowSettings.SIZE)
        self.axes = casadi.SX.sym("axes", 6, n)
        self.shared = [self.low, self.high, self.settings, self.axes]
        self.slides = [axis_of(robot, i)[1] for i in range(n)]
        self.acceleration = casadi.DM(robot.limits.acceleration)
        self.stop_rate = float(np.min(robot.limits.acceleration / robot.limits.velocity))

    def ends(self, capsule: casadi.SX) -> tuple[casadi.SX, casadi.SX]:
        """The ends of a capsule's segment."""
        return capsule[0:3], capsule[3:6]

    def along(self, capsule: casadi.SX, point: casadi.SX, direction: casadi.SX) -> casadi.SX:
        """How fast (n) a point of a capsule moves along a direction as each joint moves at unit speed."""
        moment = casadi.cross(point, direction)
        entries = []
        for i in range(self.n):
            axis, origin = self.axes[:3, i], self.axes[3:, i]
            arm = direction if self.slides[i] else moment - casadi.cross(origin, direction)
            entries.append((capsule[7] >= i) * casadi.dot(axis, arm))
        return casadi.vertcat(*entries)

    def row(
        self, distance: casadi.SX, gradient: casadi.SX, drift: casadi.SX | float, margin: casadi.SX
    ) -> casadi.SX:
        """(need, lower, distance, gradient (n)); a row can matter at this tick only where its need is below zero."""
        s, spare = self.settings, distance - margin
        able = s[RowSettings.BRAKING] * casadi.dot(casadi.fabs(gradient), self.acceleration)
        able = casadi.fmin(able, s[RowSettings.MOST_BRAKING])
        delay = s[RowSettings.DELAY]
        braking = casadi.sqrt((able * delay) ** 2 + 2.0 * able * casadi.fmax(spare, 0.0)) - able * delay
        outwards = casadi.fmax(spare / delay, -s[RowSettings.PUSH])
        lower = -casadi.if_else(spare > 0.0, braking, outwards) - drift
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        least = casadi.dot(gradient, middle) - casadi.dot(casadi.fabs(gradient), half)
        need = casadi.if_else(casadi.dot(gradient, gradient) < FLAT * FLAT, 1.0, least - lower)
        return casadi.densify(casadi.vertcat(need, lower, distance, gradient))

    def far(self, distance: casadi.SX) -> casadi.SX:
        """What stands for the row of a pair that cannot matter: the distance is a lower bound."""
        return casadi.densify(casadi.vertcat(1.0, 0.0, distance, casadi.SX(self.n, 1)))

    def pair(self, name: str, inputs: list[casadi.SX], bound: casadi.SX, row: casadi.SX) -> _Pair:
        """Return the functions of one pair: a lower bound of its distance, and its row, skipped on demand."""
        known = casadi.SX.sym("known")
        arguments = [known, *inputs, *self.shared]
        exact = casadi.Function(f"{name}_exact", arguments, [row])
        skipped = casadi.Function(f"{name}_skipped", arguments, [self.far(known)])
        chosen = casadi.Function.if_else(f"{name}_row", exact, skipped)
        return _Pair(casadi.Function(f"{name}_bound", inputs, [bound]), chosen, self.stop_rate)


class _Pair(NamedTuple):
    """Functions of one pair: inputs -> lower bound of the distance; (near, bound, inputs, shared inputs) -> row."""

    bound: casadi.Function
    row: casadi.Function
    stop_rate: float

    def each(
        self,
        inputs: Sequence[casadi.MX],
        speed: casadi.MX,
        margin: casadi.MX,
        shared: Sequence[casadi.MX],
        fixed: int = 0,
    ) -> casadi.MX:
        """Return the rows (3 + n, count) of pairs side by side; the last ``fixed`` inputs they have in common.

        Pairs that can still brake from the greatest ``speed`` (1, count) [m/s] that they can have are skipped.
        """
        count, settings = speed.shape[1], shared[2]
        common = list(range(len(inputs) - fixed, len(inputs) + len(shared)))
        bound = self.bound.map("bounds", "serial", count, common[:fixed], [])(*inputs)
        # With |g v| <= speed and deceleration share * sum |g_i| A_i, up to its cap, the way to rest is no longer than this.
        delay, share, most = (
            settings[k] for k in (RowSettings.DELAY, RowSettings.BRAKING, RowSettings.MOST_BRAKING)
        )
        time = delay + 0.5 * casadi.fmax(1.0 / (share * self.stop_rate), speed / most)
        near = bound - margin < speed * time
        rows = self.row.map("rows", "serial", count, [2 + k for k in common], [])
        return rows(near, bound, *inputs, *shared)


def _segments(a: Sequence[casadi.SX], b: Sequence[casadi.SX], c: casadi.SX) -> tuple[casadi.SX, ...]:
    """Return shares s, t of the points of two segments that are nearest after blending by ``c`` (2) [m^2], and phi."""
    u, w, between = a[1] - a[0], b[1] - b[0], a[0] - b[0]
    uu, ww, uw = casadi.dot(u, u), casadi.dot(w, w), casadi.dot(u, w)
    A, C = uu + 4.0 * c[0] + TINY, ww + 4.0 * c[1] + TINY
    p, r = casadi.dot(u, between) - 2.0 * c[0], -casadi.dot(w, between) - 2.0 * c[1]
    # minimise 1/2 A s^2 + p s - uw s t + 1/2 C t^2 + r t on the unit square
    s = _clip((uw * -r - p * C) / (A * C - uw * uw))
    t = _clip((uw * s - r) / C)
    s = _clip((uw * t - p) / A)
    t = _clip((uw * s - r) / C)
    blend = 4.0 * c[0] * (s - 0.5) ** 2 + 4.0 * c[1] * (t - 0.5) ** 2
    return s, t, blend


def _self_pair(rows: _Rows) -> _Pair:
    """Two capsules; constants (5): radii and blend, c of both, margin, radii and half lengths."""
    constants = casadi.SX.sym("constants", 5)
    reach, c, margin = constants[0], constants[1:3], constants[3]
    a, b = rows.ends(rows.capsule), rows.ends(rows.other)
    s, t, blend = _segments(a, b, c)
    gap = (a[0] + s * (a[1] - a[0])) - (b[0] + t * (b[1] - b[0]))
    # Segments that cross have no direction between them: their common normal takes its place.
    normal = casadi.cross(a[1] - a[0], b[1] - b[0]) + 1e-9
    gap = casadi.if_else(casadi.dot(gap, gap) < TINY, 1e-6 * normal / _norm(normal), gap)
    length = casadi.sqrt(casadi.dot(gap, gap) + blend)
    n, at_a, at_b = gap / length, a[0] + s * (a[1] - a[0]), b[0] + t * (b[1] - b[0])
    gradient = rows.along(rows.capsule, at_a, n) - rows.along(rows.other, at_b, n)
    bound = 0.5 * _norm(a[0] + a[1] - b[0] - b[1]) - constants[4]
    row = rows.row(length - reach, gradient, 0.0, margin)
    return rows.pair("self_pair", [rows.capsule, rows.other, constants], bound, row)


def _into_box(a: casadi.SX, b: casadi.SX, half: casadi.SX) -> tuple[casadi.SX, casadi.SX, casadi.SX]:
    """Return depth, direction out and share t of a segment in a box, in its axes; the depth is < 0 where they meet.

    The face normals of the difference of both bodies: those of the box, and those of its edges with the segment.
    """
    u = b - a
    best, normal, share = casadi.SX(-1e9), casadi.SX([0, 0, 1]), casadi.SX(0.5)
    for k in range(3):
        for sign in (1.0, -1.0):
            apart = casadi.fmin(sign * a[k], sign * b[k]) - half[k]
            better, axis = apart > best, casadi.SX(3, 1)
            axis[k] = sign
            normal = casadi.if_else(better, axis, normal)
            share = casadi.if_else(better, casadi.if_else(sign * a[k] < sign * b[k], 0.0, 1.0), share)
            best = casadi.if_else(better, apart, best)
        edge = casadi.SX(3, 1)
        edge[k] = 1.0
        m = casadi.cross(u, edge)
        size = _norm(m)
        m = m / (size + 1e-9)
        offset = casadi.dot(m, a)
        m = casadi.if_else(offset < 0.0, -m, m)
        apart = casadi.fabs(offset) - casadi.dot(casadi.fabs(m), half)
        better = casadi.logic_and(apart > best, size > 1e-3)
        normal = casadi.if_else(better, m, normal)
        share = casadi.if_else(better, _clip(-casadi.dot(u, a) / (casadi.dot(u, u) + TINY)), share)
        best = casadi.if_else(better, apart, best)
    return best, normal, share


def _nearest_to_box(a: casadi.SX, b: casadi.SX, half: casadi.SX, c: casadi.SX) -> casadi.SX:
    """Return the share t of a segment that is nearest to a box after blending by ``c``, in the box's axes.

    Half the derivative of the squared distance rises with t in straight pieces: between the two breaks where it
    changes its sign, the root is that of a line.
    """
    u = b - a

    def slope(t: casadi.SX) -> casadi.SX:
        p = a + t * u
        outside = p - casadi.fmin(casadi.fmax(p, -half), half)
        return casadi.dot(outside, u) + 4.0 * c * (t - 0.5)

    left, right = casadi.SX(0.0), casadi.SX(1.0)
    at_left, at_right = slope(left), slope(right)
    for k in range(3):
        for sign in (1.0, -1.0):
            safe = casadi.if_else(casadi.fabs(u[k]) < TINY, 1.0, u[k])
            t = _clip((sign * half[k] - a[k]) / safe)
            value = slope(t)
            lower, higher = (
                casadi.logic_and(value <= 0.0, t >= left),
                casadi.logic_and(value >= 0.0, t <= right),
            )
            left, at_left = casadi.if_else(lower, t, left), casadi.if_else(lower, value, at_left)
            right, at_right = casadi.if_else(higher, t, right), casadi.if_else(higher, value, at_right)
    return left + (right - left) * _clip(-at_left / casadi.fmax(at_right - at_left, 1e-15))


def _box_pair(rows: _Rows) -> _Pair:
    """A capsule; constants (4): radius and blend, c, hand, radius and half length; a box."""
    constants, box = casadi.SX.sym("constants", 4), casadi.SX.sym("box", Box.SIZE)
    R, centre, half = casadi.reshape(box[Box.ROTATION], 3, 3), box[Box.CENTRE], box[Box.HALF]
    reach, margin = constants[0], rows.settings[RowSettings.MARGIN]
    a, b = (R.T @ (end - centre) for end in rows.ends(rows.capsule))
    t = _nearest_to_box(a, b, half, constants[1])
    p = a + t * (b - a)
    out = p - casadi.fmin(casadi.fmax(p, -half), half)
    depth, normal, deepest = _into_box(a, b, half)
    inside = depth < 0.0
    length = casadi.sqrt(casadi.dot(out, out) + 4.0 * constants[1] * (t - 0.5) ** 2 + 1e-300)
    share = casadi.if_else(inside, deepest, t)
    n = R @ casadi.if_else(inside, normal, out / length)
    distance = casadi.if_else(inside, depth, length) - reach
    at_box = a + share * (b - a)
    gradient = rows.along(rows.capsule, centre + R @ at_box, n)
    lever = R @ casadi.fmin(casadi.fmax(at_box, -half), half)
    drift = -casadi.dot(n, box[Box.LINEAR] + casadi.cross(box[Box.ANGULAR], lever))
    excluded = box[Box.ABSENT] + box[Box.HAND_MAY_TOUCH] * constants[2]
    middle = R.T @ (0.5 * (rows.capsule[0:3] + rows.capsule[3:6]) - centre)
    outside = casadi.fmax(casadi.fabs(middle) - half, 0.0)
    bound = _norm(outside) - constants[3] + 1e9 * excluded
    row = rows.row(distance, gradient, drift, margin)
    return rows.pair("box_pair", [rows.capsule, constants, box], bound, row)


def _table_row(rows: _Rows) -> casadi.Function:
    """A capsule; constants (3): radius, which end, margin; its height comes from the settings."""
    constants = casadi.SX.sym("constants", 3)
    end = constants[1]
    a, b = rows.ends(rows.capsule)
    height = a[2] + end * (b[2] - a[2]) - constants[0] - rows.settings[RowSettings.TABLE_HEIGHT]
    gradient = rows.along(rows.capsule, a + end * (b - a), casadi.SX([0, 0, 1]))
    row = rows.row(height, gradient, 0.0, constants[2])
    return casadi.Function("table_row", [rows.capsule, constants, *rows.shared], [row])


def _placed_capsules(robot: RobotModel, capsules: LinkCapsules) -> casadi.Function:
    """(q, low, high) -> capsules (8, C) as `_Rows` has them, and axes and origins of the joints (6, n), in W."""
    n = robot.n
    q, low, high = (casadi.SX.sym(name, n) for name in ("q", "low", "high"))
    frames = _joint_frames(robot, q)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    columns = []
    for joint, ends in zip(capsules.joint.tolist(), capsules.ends, strict=True):
        points, speeds = [], []
        for end in ends:
            R, p = (casadi.SX.eye(3), casadi.SX(3, 1)) if joint < 0 else frames[joint][:2]
            point = p + R @ casadi.DM(end)
            velocity, more = casadi.SX(3, 1), casadi.SX(0.0)
            for i, frame in enumerate(frames[: joint + 1]):
                column = frame.axis if frame.slides else casadi.cross(frame.axis, point - frame.origin)
                velocity, more = velocity + column * middle[i], more + _norm(column) * half[i]
            points.append(point)
            speeds.append(_norm(velocity) + more)
        columns.append(casadi.vertcat(*points, casadi.fmax(*speeds), joint))
    axes = casadi.horzcat(*[casadi.vertcat(frame.axis, frame.origin) for frame in frames])
    outputs = [casadi.densify(casadi.horzcat(*columns)), casadi.densify(axes)]
    return casadi.Function("placed_capsules", [q, low, high], outputs)


def _blend(radius: Array, length: Array) -> Array:
    """Return what blending adds to a squared distance at most [m^2], so that it takes `BLEND` off at contact."""
    return np.where(length > 0.0, 2.0 * radius * BLEND + BLEND**2, 0.0)


def distance_rows(
    robot: RobotModel,
    capsules: LinkCapsules,
    self_pairs: Sequence[tuple[int, int, float]],
    table_ends: Sequence[tuple[int, int, float]],
    boxes: int,
) -> casadi.Function:
    """Return the function that gives one row for every pair.

    Inputs: q (n); lowest and highest velocity of the next tick (n); settings (6), see `RowSettings`; boxes (23, B), see
    `Box`. Output: (3 + n, P) with need, lower bound, distance and gradient in each column. First the ``self_pairs``
    of capsules with their margins, then the ``table_ends`` (capsule, end, margin), then the moving capsules with each box.
    """
    rows, n = _Rows(robot), robot.n
    q, low, high = (casadi.MX.sym(name, n) for name in ("q", "low", "high"))
    settings, box = (
        casadi.MX.sym("settings", RowSettings.SIZE),
        casadi.MX.sym("boxes", Box.SIZE, max(boxes, 1)),
    )
    placed, axes = _placed_capsules(robot, capsules)(q, low, high)
    shared = [low, high, settings, axes]
    length = np.linalg.norm(capsules.ends[:, 1] - capsules.ends[:, 0], axis=1)
    parts = []
    if self_pairs:
        first, second, margin = ([pair[k] for pair in self_pairs] for k in range(3))
        radius = capsules.radius[first] + capsules.radius[second]
        # Each of the two segments is blended by half.
        c = 0.5 * _blend(radius, np.maximum(length[first], length[second]))
        reach = radius + 0.5 * (length[first] + length[second]) + BLEND
        constants = casadi.DM(np.stack([radius + BLEND, c, c, margin, reach]))
        inputs, speed = [placed[:, first], placed[:, second], constants], placed[6, first] + placed[6, second]
        parts.append(_self_pair(rows).each(inputs, speed, casadi.DM(margin).T, shared))
    if table_ends:
        which, end, margin = ([one[k] for one in table_ends] for k in range(3))
        constants = casadi.DM(np.stack([capsules.radius[which], end, margin]))
        each = _table_row(rows).map("table_rows", "serial", len(table_ends), [2, 3, 4, 5], [])
        parts.append(each(placed[:, which], constants, *shared))
    if boxes:
        which = np.flatnonzero(capsules.joint >= 0).tolist()
        c, reach = _blend(capsules.radius, length)[which], (capsules.radius + 0.5 * length)[which] + BLEND
        radius = capsules.radius[which] + BLEND * (c > 0.0)
        constants = casadi.DM(np.stack([radius, c, capsules.hand[which], reach]))
        with_box = _with_one_box(rows, constants).map("with_boxes", "serial", boxes, [0, 2, 3, 4, 5], [])
        found = with_box(placed[:, which], box, *shared)
        parts.append(casadi.reshape(found, HEAD + n, len(which) * boxes))
    out = casadi.densify(casadi.horzcat(*parts)) if parts else casadi.MX(HEAD + n, 0)
    return casadi.Function("distance_rows", [q, low, high, settings, box], [out])


def _with_one_box(rows: _Rows, constants: casadi.DM) -> casadi.Function:
    """(capsules (8, m), box, shared ...) -> rows (3 + n, m), one after another."""
    count = constants.shape[1]
    capsules, box = casadi.MX.sym("capsules", rows.CAPSULE, count), casadi.MX.sym("box", Box.SIZE)
    shared = [casadi.MX.sym(f"shared{k}", *x.shape) for k, x in enumerate(rows.shared)]
    drift = casadi.norm_2(box[Box.LINEAR]) + casadi.norm_2(box[Box.ANGULAR]) * (casadi.norm_2(box[Box.HALF]))
    inputs, margin = [capsules, constants, box], shared[2][RowSettings.MARGIN]
    found = _box_pair(rows).each(inputs, capsules[6, :] + drift, margin, shared, fixed=1)
    return casadi.Function("with_box", [capsules, box, *shared], [casadi.vec(found)])
