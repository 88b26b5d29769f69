"""Clearance of an arm's capsules from each other, from a table and from boxes, as one CasADi function.

Distances only, without gradients, for many configurations at once. What is further away than a horizon is not worked
out: two spheres around two bodies are enough to know that, and the result is the horizon.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi
import numpy as np

from optsc.collision.kernels.capsules import (
    TINY,
    LinkCapsules,
    capsule_ends,
    clip,
    nearest_shares,
    nearest_to_box,
    norm,
)
from optsc.kernels.chain import Chain
from optsc.kernels.symbols import only_if, symbols

BOX = 15
"""Numbers of a box: rotation (column by column), centre, half extents."""


def between_capsules() -> casadi.Function:
    """Return the function (ends, other ends, sum of the radii) -> distance of two capsules [m]."""
    inputs = symbols(casadi.SX, first=6, second=6, radii=1)
    first, second, radii = inputs
    a, b = (first[:3], first[3:]), (second[:3], second[3:])
    s, t, _ = nearest_shares(a, b, casadi.SX(2, 1))
    gap = a[0] + s * (a[1] - a[0]) - b[0] - t * (b[1] - b[0])
    return casadi.Function("between_capsules", inputs, [norm(gap) - radii])


def _if_near(distance: casadi.Function, **sizes: int) -> casadi.Function:
    """Return (near, *inputs, least) -> the distance where it is near and less than ``least``, else ``least``."""
    inputs = symbols(casadi.MX, **sizes, least=1)
    least = casadi.fmin(distance(*inputs[:-1]), inputs[-1])
    return only_if(casadi.Function(distance.name(), inputs, [least]), inputs, inputs[-1:])


def to_box() -> casadi.Function:
    """Return the function (ends, radius, box) -> distance of a capsule from a box [m].

    Where the segment meets the box it is minus the radius: how deep it is in is not asked.
    """
    inputs = symbols(casadi.SX, ends=6, radius=1, box=BOX)
    ends, radius, box = inputs
    R, centre, half = casadi.reshape(box[:9], 3, 3), box[9:12], box[12:15]
    a, b = R.T @ (ends[:3] - centre), R.T @ (ends[3:] - centre)
    p = a + nearest_to_box(a, b, half, casadi.SX(0.0)) * (b - a)
    outside = p - casadi.fmin(casadi.fmax(p, -half), half)
    return casadi.Function("to_box", inputs, [norm(outside) - radius])


def _near(count: int) -> casadi.Function:
    """(ends (6, count), radii (1, count), box, horizon) -> which capsules may be nearer than the horizon, whether any.

    In the box's axes a segment lies in the box of its two ends.
    """
    inputs = symbols(casadi.SX, ends=(6, count), radius=(1, count), box=BOX, horizon=1)
    ends, radius, box, horizon = inputs
    R, flags = casadi.reshape(box[:9], 3, 3), []
    for k in range(count):
        middle = R.T @ (0.5 * (ends[:3, k] + ends[3:, k]) - box[9:12])
        half = casadi.fabs(R.T @ (0.5 * (ends[3:, k] - ends[:3, k])))
        outside = casadi.fmax(casadi.fabs(middle) - half - box[12:15], 0.0)
        flags.append(casadi.dot(outside, outside) < (radius[k] + horizon) ** 2)
    return casadi.Function("near", inputs, _flags(flags))


def _flags(flags: Sequence[casadi.SX]) -> list[casadi.SX]:
    """Return flags (1, count) side by side, and whether any is set."""
    some = casadi.SX(0)
    for flag in flags:
        some = casadi.logic_or(some, flag)
    return [casadi.densify(casadi.horzcat(*flags)), some]


def _self_clearance(links: LinkCapsules, pairs: Sequence[tuple[int, int]]) -> casadi.Function:
    """(ends (6, C), horizon) -> least distance of the pairs, and the horizon at most."""
    inputs = symbols(casadi.MX, ends=(6, len(links.link)), horizon=1)
    ends, horizon = inputs
    if not pairs:
        return casadi.Function("no_pairs", inputs, [horizon])
    near, any_near = _near_pairs(links, pairs)(ends, horizon)
    flags, least = casadi.MX.sym("near", 1, len(pairs)), horizon
    each = _if_near(between_capsules(), first=6, second=6, radii=1)
    # One call after another: a map would copy what its calls have in common.
    for k, (a, b) in enumerate(pairs):
        least = each(flags[k], ends[:, a], ends[:, b], float(links.radius[a] + links.radius[b]), least)
    exact = casadi.Function("least_of_pairs", [ends, horizon, flags], [least])
    found = only_if(exact, [ends, horizon, flags], [horizon])(any_near, ends, horizon, near)
    return casadi.Function("self_clearance", inputs, [found])


def _balls(capsules: LinkCapsules) -> list[tuple[list[int], float]]:
    """Return for each capsule all that are fixed together with it, and the radius of a ball around their middle."""
    found = []
    for joint in capsules.joint.tolist():
        fixed = np.flatnonzero(capsules.joint == joint)
        points = capsules.ends[fixed].reshape(-1, 3)
        distance = np.linalg.norm(points - points.mean(axis=0), axis=1)
        found.append((fixed.tolist(), float(np.max(distance + np.repeat(capsules.radius[fixed], 2)))))
    return found


def _near_pairs(capsules: LinkCapsules, pairs: Sequence[tuple[int, int]]) -> casadi.Function:
    """(ends (6, C), horizon) -> which of the pairs may be nearer than the horizon (1, P), whether any is.

    The second capsule is taken together with all that is fixed to it, as one ball.
    """
    inputs = symbols(casadi.SX, ends=(6, len(capsules.link)), horizon=1)
    ends, horizon = inputs
    balls, known, flags = _balls(capsules), {}, []
    for a, b in pairs:
        fixed, radius = balls[b]
        if (a, fixed[0]) not in known:
            centre = casadi.sum2(ends[:3, fixed] + ends[3:, fixed]) / (2 * len(fixed))
            along, offset = ends[3:, a] - ends[:3, a], centre - ends[:3, a]
            offset -= clip(casadi.dot(along, offset) / (casadi.dot(along, along) + TINY)) * along
            reach = radius + capsules.radius[a] + horizon
            known[a, fixed[0]] = casadi.dot(offset, offset) < reach * reach
        flags.append(known[a, fixed[0]])
    return casadi.Function("near_pairs", inputs, _flags(flags))


def _over_capsules(count: int) -> casadi.Function:
    """(ends, radii, box, horizon) -> least distance of the capsules from a box."""
    inputs = symbols(casadi.MX, ends=(6, count), radius=(1, count), box=BOX, horizon=1)
    ends, radius, box, horizon = inputs
    near, any_near = _near(count)(*inputs)
    flags, least = casadi.MX.sym("near", 1, count), horizon
    each = _if_near(to_box(), ends=6, radius=1, box=BOX)
    for k in range(count):
        least = each(flags[k], ends[:, k], radius[k], box, least)
    exact = casadi.Function("least", [*inputs, flags], [least])
    # Most boxes are far from all capsules.
    found = only_if(exact, [*inputs, flags], [horizon])(any_near, *inputs, near)
    return casadi.Function("over_capsules", inputs, [found])


def _to_boxes(ends: casadi.MX, radius: casadi.DM, boxes: casadi.MX, horizon: casadi.MX) -> casadi.MX:
    """Return the least distance (1, B) of capsules from each box."""
    over = _over_capsules(ends.shape[1])
    return casadi.horzcat(*(over(ends, radius, boxes[:, k], horizon) for k in range(boxes.shape[1])))


def clearance(
    chain: Chain,
    links: LinkCapsules,
    hulls: LinkCapsules,
    pairs: Sequence[tuple[int, int]],
    close_pairs: Sequence[tuple[int, int]],
    over_table: Sequence[tuple[int, int]],
    boxes: int,
) -> casadi.Function:
    """Return the function (q, horizon, table height, boxes) -> clearances [m], none above the horizon.

    Args:
        chain: the arm.
        links: what is compared with each other: the ``pairs`` of them.
        hulls: what is compared with the world; those that no joint moves are left out.
        pairs: numbers of the links' capsules.
        close_pairs: more of them, which are built close to each other.
        over_table: what is compared with the table: numbers of the hulls' capsules, each with that of an end, 0 or 1.
        boxes: B, how many boxes there are, at least one.

    The output is one column (3 + 2 B): clearance to itself; the same of the close pairs; to the table; of all but the
    hand to each box; of the hand to each box. They are lower bounds of the distances of what the capsules hold.
    """
    inputs = symbols(casadi.MX, q=chain.n, horizon=1, height=1, boxes=(BOX, boxes))
    q, horizon, height, box = inputs
    own, placed = capsule_ends(chain, links, hulls)(q)
    moving = hulls.moving
    table = horizon
    if over_table:
        lowest = [placed[2 + 3 * end, k] - float(hulls.radius[k]) for k, end in over_table]
        table = casadi.fmin(casadi.mmin(casadi.vertcat(*lowest)) - height, horizon)
    parts = [_self_clearance(links, some)(own, horizon) for some in (pairs, close_pairs)]
    parts.append(table)
    for wanted in (False, True):
        some = [k for k in moving if bool(hulls.hand[k]) is wanted]
        far = casadi.repmat(horizon, 1, boxes)
        parts.append((_to_boxes(placed[:, some], casadi.DM(hulls.radius[some]).T, box, horizon) if some else far).T)
    out = casadi.densify(casadi.vertcat(*parts))
    return casadi.Function("clearance", inputs, [out])
