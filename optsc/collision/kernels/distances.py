"""Distances of an arm's capsules to a table, to boxes and to each other, with their gradients, as CasADi functions.

Distances of segments are blended: phi = min |p(t) - c|^2 + e (t - 1/2)^2 with a small e instead of the plain minimum,
so that the nearest point runs along a segment which lies parallel to something, where it would jump otherwise. The
gradient stays exact (the minimiser's motion does not enter, as at any minimum), and taking `BLEND` off the result
keeps it below the true distance wherever two bodies do not touch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi
import numpy as np

from optsc.collision.kernels.capsules import TINY, LinkCapsules, clip, nearest_shares, nearest_to_box, norm
from optsc.collision.kernels.rows import HEAD, Box, Pair, PairFunctions, RowBuilder, RowSettings
from optsc.geometry.rotation import Array
from optsc.kernels.chain import Chain, JointFrame, Rates, joint_frames
from optsc.kernels.symbols import symbols

BLEND = 1e-3
"""What blending may take off a distance [m]."""


class SelfPair(NamedTuple):
    """Two capsules of the arm, by number, and the distance they keep [m]."""

    first: int
    second: int
    margin: float


class TableEnd(NamedTuple):
    """One end (0 or 1) of a capsule, and the height over the table it keeps [m]."""

    capsule: int
    end: int
    margin: float


def _self_pair(rows: RowBuilder) -> PairFunctions:
    """Two capsules; constants (6): radii and blend, c of both, margin, is the first longer, half the shorter."""
    constants = casadi.SX.sym("constants", 6)
    reach, c, margin = constants[0], constants[1:3], constants[3]
    a, b = rows.ends(rows.capsule), rows.ends(rows.other)
    s, t, blend = nearest_shares(a, b, c)
    gap = (a[0] + s * (a[1] - a[0])) - (b[0] + t * (b[1] - b[0]))
    # Segments that cross have no direction between them: their common normal takes its place.
    normal = casadi.cross(a[1] - a[0], b[1] - b[0]) + 1e-9
    gap = casadi.if_else(casadi.dot(gap, gap) < TINY, 1e-6 * normal / norm(normal), gap)
    length = casadi.sqrt(casadi.dot(gap, gap) + blend)
    n, at_a, at_b = gap / length, a[0] + s * (a[1] - a[0]), b[0] + t * (b[1] - b[0])
    gradient = rows.along(rows.capsule, at_a, n) - rows.along(rows.other, at_b, n)
    # The longer segment to the middle of the shorter one. Where it is a constant which it is, only one is worked out.
    nearest = casadi.if_else(constants[4], _to_middle(a, b), _to_middle(b, a))
    bound = nearest - constants[5] - reach
    row = rows.row(length - reach, gradient, margin, scale=norm(gap) / length)
    return rows.pair("self_pair", [rows.capsule, rows.other, constants], bound, row)


def _to_middle(a: Sequence[casadi.SX], b: Sequence[casadi.SX]) -> casadi.SX:
    """Return the distance of a segment from the middle of another one."""
    along, offset = a[1] - a[0], 0.5 * (b[0] + b[1]) - a[0]
    return norm(offset - clip(casadi.dot(along, offset) / (casadi.dot(along, along) + TINY)) * along)


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
        size = norm(m)
        m = m / (size + 1e-9)
        offset = casadi.dot(m, a)
        m = casadi.if_else(offset < 0.0, -m, m)
        apart = casadi.fabs(offset) - casadi.dot(casadi.fabs(m), half)
        better = casadi.logic_and(apart > best, size > 1e-3)
        normal = casadi.if_else(better, m, normal)
        share = casadi.if_else(better, clip(-casadi.dot(u, a) / (casadi.dot(u, u) + TINY)), share)
        best = casadi.if_else(better, apart, best)
    return best, normal, share


def _box_pair(rows: RowBuilder) -> PairFunctions:
    """A capsule; constants (4): radius and blend, c, hand, radius and half length; a box."""
    constants, box = casadi.SX.sym("constants", 4), casadi.SX.sym("box", Box.SIZE)
    R, centre, half = casadi.reshape(box[Box.ROTATION], 3, 3), box[Box.CENTRE], box[Box.HALF]
    reach, margin = constants[0], rows.settings[RowSettings.MARGIN]
    a, b = (R.T @ (end - centre) for end in rows.ends(rows.capsule))
    t = nearest_to_box(a, b, half, constants[1])
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
    bound = norm(outside) - constants[3] + 1e9 * excluded
    row = rows.row(distance, gradient, margin, drift, norm(n))
    return rows.pair("box_pair", [rows.capsule, constants, box], bound, row)


def _table_end(rows: RowBuilder) -> PairFunctions:
    """A capsule; constants (3): radius, which end, margin; the height of the table."""
    constants, table = casadi.SX.sym("constants", 3), casadi.SX.sym("table")
    end = constants[1]
    a, b = rows.ends(rows.capsule)
    height = a[2] + end * (b[2] - a[2]) - constants[0] - table
    gradient = rows.along(rows.capsule, a + end * (b - a), casadi.SX([0, 0, 1]))
    row = rows.row(height, gradient, constants[2])
    return rows.pair("table_end", [rows.capsule, constants, table], height, row)


def _placed_capsules(chain: Chain, capsules: LinkCapsules) -> casadi.Function:
    """(q, low, high) -> capsules (8, C) as `RowBuilder` has them, axes and origins of the joints (6, n), in W; speeds.

    The speeds (2 n, n + 1) are how fast each joint's frame can move at its origin, then how fast it can turn, as seen
    from each frame before it; in the last column as seen from the world.
    """
    n = chain.n
    inputs = symbols(casadi.SX, q=n, low=n, high=n)
    q, low, high = inputs
    frames = joint_frames(chain, q)
    speeds = _greatest_speeds(frames, 0.5 * (low + high), 0.5 * (high - low))
    columns = []
    for joint, ends in zip(capsules.joint.tolist(), capsules.ends, strict=True):
        R, p = (casadi.SX.eye(3), casadi.SX(3, 1)) if joint < 0 else frames[joint][:2]
        linear, angular = speeds[joint] if joint >= 0 else (0.0, 0.0)
        lever = float(np.linalg.norm(ends, axis=1).max())
        points = [p + R @ casadi.DM(end) for end in ends]
        columns.append(casadi.vertcat(*points, linear + angular * lever, joint))
    axes = casadi.horzcat(*[casadi.vertcat(frame.axis, frame.origin) for frame in frames])
    relative = _relative_speeds(frames, casadi.fmax(casadi.fabs(low), casadi.fabs(high)))
    outputs = [casadi.densify(x) for x in (casadi.horzcat(*columns), axes, relative)]
    return casadi.Function("placed_capsules", inputs, outputs)


def _greatest_speeds(
    frames: Sequence[JointFrame], middle: casadi.SX, half: casadi.SX
) -> list[tuple[casadi.SX, casadi.SX]]:
    """Return how fast each joint's frame can move at its origin, and turn [m/s, rad/s], with velocities middle ± half.

    Bounds: what a joint does to the frames before it is added up without regard to directions.
    """
    found, turning, spread = [], casadi.SX(3, 1), casadi.SX(0.0)
    for j, frame in enumerate(frames):
        velocity, more = casadi.SX(3, 1), casadi.SX(0.0)
        for i, before in enumerate(frames[: j + 1]):
            column = before.axis if before.slides else casadi.cross(before.axis, frame.p - before.origin)
            velocity, more = velocity + column * middle[i], more + norm(column) * half[i]
        if not frame.slides:
            turning, spread = turning + frame.axis * middle[j], spread + half[j]
        found.append((norm(velocity) + more, norm(turning) + spread))
    return found


def _relative_speeds(frames: Sequence[JointFrame], most: casadi.SX) -> casadi.SX:
    """Return how fast frames can move and turn as seen from those before them (2 n, n + 1), see `_placed_capsules`.

    Only the joints between two frames move them against each other; ``most`` (n,) is how fast each can be.
    """
    n = len(frames)
    speeds = casadi.SX(2 * n, n + 1)
    for j, frame in enumerate(frames):
        linear, angular = casadi.SX(0.0), casadi.SX(0.0)
        for i in range(j, -1, -1):
            before = frames[i]
            column = before.axis if before.slides else casadi.cross(before.axis, frame.p - before.origin)
            linear = linear + norm(column) * most[i]
            angular = angular if before.slides else angular + most[i]
            seen_from = i - 1 if i else n
            speeds[j, seen_from], speeds[n + j, seen_from] = linear, angular
    return speeds


def _blend(radius: Array, length: Array) -> Array:
    """Return what blending adds to a squared distance at most [m^2], so that it takes `BLEND` off at contact."""
    return np.where(length > 0.0, 2.0 * radius * BLEND + BLEND**2, 0.0)


def distance_rows(
    chain: Chain,
    rates: Rates,
    capsules: LinkCapsules,
    self_pairs: Sequence[SelfPair],
    table_ends: Sequence[TableEnd],
    boxes: int,
) -> casadi.Function:
    """Return the function that gives one row for every pair.

    Inputs: q (n); lowest and highest velocity of the next tick (n); settings (6), see `RowSettings`; boxes (23, B),
    see `Box`. Output: (3 + n, P) with need, lower bound, distance and gradient in each column: first the
    ``self_pairs``, then the ``table_ends``, then each of the ``boxes`` with all capsules that move; and the least need.
    """
    rows, n = RowBuilder(chain, rates), chain.n
    inputs = symbols(casadi.MX, q=n, low=n, high=n, settings=RowSettings.SIZE, boxes=(Box.SIZE, max(boxes, 1)))
    q, low, high, settings, box = inputs
    placed, axes, speeds = _placed_capsules(chain, capsules)(q, low, high)
    shared = [low, high, settings, axes]
    length = capsules.length
    parts = []
    if self_pairs:
        parts.append(_self_rows(rows, capsules, length, self_pairs)(placed, speeds, *shared))
    if table_ends:
        parts.append(_table_rows(rows, capsules, table_ends)(placed, *shared))
    if boxes:
        with_box = _with_one_box(rows, capsules, length)
        parts += [with_box(placed, box[:, k], *shared) for k in range(boxes)]
    out = casadi.densify(casadi.horzcat(casadi.MX(HEAD + n, 0), *(found for found, _ in parts)))
    least = casadi.mmin(casadi.vertcat(1.0, *(least for _, least in parts)))
    return casadi.Function("distance_rows", inputs, [out, least])


def _self_rows(rows: RowBuilder, capsules: LinkCapsules, length: Array, pairs: Sequence[SelfPair]) -> casadi.Function:
    """(capsules (8, C), speeds, shared ...) -> rows (3 + n, P), least need."""
    radius, n = capsules.radius, rows.n
    lever = np.linalg.norm(capsules.ends, axis=2).max(axis=1)

    def found(inputs: Sequence[Any], _settings: Any) -> list[Pair]:
        placed, speeds = inputs
        result = []
        for a, b, margin in pairs:
            # Each of the two segments is blended by half.
            both = radius[a] + radius[b]
            c = 0.5 * float(_blend(both, np.maximum(length[a], length[b])))
            shorter = 0.5 * min(length[a], length[b])
            constants = casadi.DM([both + BLEND, c, c, margin, float(length[a] >= length[b]), shorter])
            inner, outer = sorted((a, b), key=lambda k: int(capsules.joint[k]))
            seen_from, joint = int(capsules.joint[inner]) % (n + 1), int(capsules.joint[outer])
            speed = speeds[joint, seen_from] + speeds[n + joint, seen_from] * float(lever[outer])
            speed = casadi.fmin(speed, placed[6, a] + placed[6, b])
            result.append(Pair([placed[:, a], placed[:, b], constants], speed, margin))
        return result

    sizes = {"capsules": (rows.CAPSULE, len(radius)), "speeds": (2 * n, n + 1)}
    return _self_pair(rows).together("self_rows", sizes, found)


def _table_rows(rows: RowBuilder, capsules: LinkCapsules, ends: Sequence[TableEnd]) -> casadi.Function:
    """(capsules (8, C), shared ...) -> rows (3 + n, E), least need."""

    def found(inputs: Sequence[Any], settings: Any) -> list[Pair]:
        (placed,), table = inputs, settings[RowSettings.TABLE_HEIGHT]
        result = []
        for k, end, margin in ends:
            constants = casadi.DM([capsules.radius[k], end, margin])
            result.append(Pair([placed[:, k], constants, table], placed[6, k], margin))
        return result

    return _table_end(rows).together("table_rows", {"capsules": (rows.CAPSULE, len(capsules.link))}, found)


def _box_constants(capsules: LinkCapsules, length: Array) -> Array:
    """The constants (4, C) of `_box_pair` for all capsules."""
    c = _blend(capsules.radius, length)
    reach = capsules.radius + 0.5 * length + BLEND
    return np.stack([capsules.radius + BLEND * (c > 0.0), c, capsules.hand, reach])


def _with_one_box(rows: RowBuilder, capsules: LinkCapsules, length: Array) -> casadi.Function:
    """(capsules (8, C), box, shared ...) -> rows (3 + n, m) of those that move, least need."""
    constants = _box_constants(capsules, length)

    def found(inputs: Sequence[Any], settings: Any) -> list[Pair]:
        placed, box = inputs
        linear, angular, half = (box[part] for part in (Box.LINEAR, Box.ANGULAR, Box.HALF))
        drift = casadi.norm_2(linear) + casadi.norm_2(angular) * casadi.norm_2(half)
        margin = settings[RowSettings.MARGIN]
        return [
            Pair([placed[:, k], casadi.DM(constants[:, k]), box], placed[6, k] + drift, margin) for k in capsules.moving
        ]

    sizes: dict[str, int | tuple[int, int]] = {"capsules": (rows.CAPSULE, len(capsules.link)), "box": Box.SIZE}
    return _box_pair(rows).together("with_box", sizes, found)
