"""Distances of an arm's capsules to a table, to boxes and to each other, with their gradients, as CasADi functions.

Distances of segments are blended: phi = min |p(t) - c|^2 + e (t - 1/2)^2 with a small e instead of the plain minimum,
so that the nearest point runs along a segment which lies parallel to something, where it would jump otherwise. The
gradient stays exact (the minimiser's motion does not enter, as at any minimum), and taking `BLEND` off the result
keeps it below the true distance wherever two bodies do not touch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi
import numpy as np

from optsc.collision.kernels.capsules import TINY, LinkCapsules, clip, nearest_shares, nearest_to_box, norm
from optsc.collision.kernels.rows import HEAD, Box, PairFunctions, RowBuilder, RowSettings
from optsc.geometry.rotation import Array
from optsc.kernels.chain import Chain, Rates, joint_frames
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
    """Two capsules; constants (5): radii and blend, c of both, margin, radii and half lengths."""
    constants = casadi.SX.sym("constants", 5)
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
    bound = 0.5 * norm(a[0] + a[1] - b[0] - b[1]) - constants[4]
    row = rows.row(length - reach, gradient, margin, scale=norm(gap) / length)
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


def _table_row(rows: RowBuilder) -> casadi.Function:
    """A capsule; constants (3): radius, which end, margin; its height comes from the settings."""
    constants = casadi.SX.sym("constants", 3)
    end = constants[1]
    a, b = rows.ends(rows.capsule)
    height = a[2] + end * (b[2] - a[2]) - constants[0] - rows.settings[RowSettings.TABLE_HEIGHT]
    gradient = rows.along(rows.capsule, a + end * (b - a), casadi.SX([0, 0, 1]))
    row = rows.row(height, gradient, constants[2])
    return casadi.Function("table_row", [rows.capsule, constants, *rows.shared], [row])


def _placed_capsules(chain: Chain, capsules: LinkCapsules) -> casadi.Function:
    """(q, low, high) -> capsules (8, C) as `RowBuilder` has them, and axes and origins of the joints (6, n), in W."""
    n = chain.n
    inputs = symbols(casadi.SX, q=n, low=n, high=n)
    q, low, high = inputs
    frames = joint_frames(chain, q)
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
                velocity, more = velocity + column * middle[i], more + norm(column) * half[i]
            points.append(point)
            speeds.append(norm(velocity) + more)
        columns.append(casadi.vertcat(*points, casadi.fmax(*speeds), joint))
    axes = casadi.horzcat(*[casadi.vertcat(frame.axis, frame.origin) for frame in frames])
    outputs = [casadi.densify(casadi.horzcat(*columns)), casadi.densify(axes)]
    return casadi.Function("placed_capsules", inputs, outputs)


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
    ``self_pairs``, then the ``table_ends``, then each of the ``boxes`` with all capsules that move.
    """
    rows, n = RowBuilder(chain, rates), chain.n
    inputs = symbols(casadi.MX, q=n, low=n, high=n, settings=RowSettings.SIZE, boxes=(Box.SIZE, max(boxes, 1)))
    q, low, high, settings, box = inputs
    placed, axes = _placed_capsules(chain, capsules)(q, low, high)
    shared = [low, high, settings, axes]
    length = capsules.length
    parts = [casadi.MX(HEAD + n, 0)]
    if self_pairs:
        parts.append(_self_rows(rows, capsules.radius, length, self_pairs, placed, shared))
    if table_ends:
        which = [end.capsule for end in table_ends]
        constants = np.array([[capsules.radius[end.capsule], end.end, end.margin] for end in table_ends])
        each = _table_row(rows).map("table_rows", "serial", len(table_ends), [2, 3, 4, 5], [])
        parts.append(each(placed[:, which], casadi.DM(constants.T), *shared))
    if boxes:
        which = capsules.moving
        constants = _box_constants(capsules, length)[:, which]
        with_box = _with_one_box(rows, casadi.DM(constants)).map("boxes", "serial", boxes, [0, 2, 3, 4, 5], [])
        found = with_box(placed[:, which], box, *shared)
        parts.append(casadi.reshape(found, HEAD + n, len(which) * boxes))
    out = casadi.densify(casadi.horzcat(*parts))
    return casadi.Function("distance_rows", inputs, [out])


def _self_rows(
    rows: RowBuilder,
    radius: Array,
    length: Array,
    pairs: Sequence[SelfPair],
    placed: casadi.MX,
    shared: Sequence[casadi.MX],
) -> casadi.MX:
    first, second = [pair.first for pair in pairs], [pair.second for pair in pairs]
    margin = np.array([pair.margin for pair in pairs])
    both = radius[first] + radius[second]
    # Each of the two segments is blended by half.
    c = 0.5 * _blend(both, np.maximum(length[first], length[second]))
    reach = both + 0.5 * (length[first] + length[second]) + BLEND
    constants = casadi.MX(casadi.DM(np.stack([both + BLEND, c, c, margin, reach])))
    inputs: list[casadi.MX] = [placed[:, first], placed[:, second], constants]
    speed = placed[6, first] + placed[6, second]
    return _self_pair(rows).each(inputs, speed, casadi.MX(casadi.DM(margin).T), shared)


def _box_constants(capsules: LinkCapsules, length: Array) -> Array:
    """The constants (4, C) of `_box_pair` for all capsules."""
    c = _blend(capsules.radius, length)
    reach = capsules.radius + 0.5 * length + BLEND
    return np.stack([capsules.radius + BLEND * (c > 0.0), c, capsules.hand, reach])


def _with_one_box(rows: RowBuilder, constants: casadi.DM) -> casadi.Function:
    """(capsules (8, m), box, shared ...) -> rows (3 + n, m), one after another."""
    count = constants.shape[1]
    capsules, box = casadi.MX.sym("capsules", rows.CAPSULE, count), casadi.MX.sym("box", Box.SIZE)
    shared = [casadi.MX.sym(f"shared{k}", *x.shape) for k, x in enumerate(rows.shared)]
    drift = casadi.norm_2(box[Box.LINEAR]) + casadi.norm_2(box[Box.ANGULAR]) * (casadi.norm_2(box[Box.HALF]))
    inputs: list[casadi.MX] = [capsules, casadi.MX(constants), box]
    margin = shared[2][RowSettings.MARGIN]
    found = _box_pair(rows).each(inputs, capsules[6, :] + drift, margin, shared, fixed=1)
    return casadi.Function("with_box", [capsules, box, *shared], [casadi.vec(found)])
