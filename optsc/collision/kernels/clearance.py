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
    """Return (near, *inputs, horizon) -> distance where it is near, and the horizon at most, else the horizon."""
    inputs = symbols(casadi.MX, **sizes, horizon=1)
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
    """(ends (6, count), sizes (2, count), box, horizon) -> which capsules may be nearer to the box than the horizon."""
    inputs = symbols(casadi.SX, ends=(6, count), size=(2, count), box=BOX, horizon=1)
    ends, size, box, horizon = inputs
    R, flags = casadi.reshape(box[:9], 3, 3), []
    for k in range(count):
        local = R.T @ (0.5 * (ends[:3, k] + ends[3:, k]) - box[9:12])
        outside = casadi.fmax(casadi.fabs(local) - box[12:15], 0.0)
        flags.append(casadi.dot(outside, outside) < (size[1, k] + horizon) ** 2)
    return casadi.Function("near", inputs, [casadi.densify(casadi.horzcat(*flags))])


def _self_clearance(
    chain: Chain, links: LinkCapsules, pairs: Sequence[tuple[int, int]], q: casadi.MX, horizon: casadi.MX
) -> casadi.MX:
    if not pairs:
        return horizon
    ends = capsule_ends(chain, links)(q)
    first, second = [a for a, _ in pairs], [b for _, b in pairs]
    radii = casadi.MX(casadi.DM(links.radius[first] + links.radius[second]).T)
    near = _near_pairs(links, pairs)(ends, horizon)
    each = _if_near(between_capsules(), first=6, second=6, radii=1).map("self_pairs", "serial", len(pairs), [4], [])
    return casadi.mmin(each(near, ends[:, first], ends[:, second], radii, horizon))


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
    """(ends (6, C), horizon) -> which of the pairs may be nearer than the horizon (1, P).

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
    return casadi.Function("near_pairs", inputs, [casadi.densify(casadi.horzcat(*flags))])


def _over_capsules(count: int) -> casadi.Function:
    """(ends, sizes, box, horizon) -> least distance of the capsules from a box."""
    inputs = symbols(casadi.MX, ends=(6, count), size=(2, count), box=BOX, horizon=1)
    ends, size, box, horizon = inputs
    near = _near(count)(*inputs)
    each = _if_near(to_box(), ends=6, radius=1, box=BOX).map("capsules", "serial", count, [3, 4], [])
    least = casadi.mmin(each(near, ends, size[0, :], box, horizon))
    # Most boxes are far from all capsules.
    found = only_if(casadi.Function("least", inputs, [least]), inputs, [horizon])(casadi.mmax(near), *inputs)
    return casadi.Function("over_capsules", inputs, [found])


def _to_boxes(ends: casadi.MX, size: casadi.DM, boxes: casadi.MX, horizon: casadi.MX) -> casadi.MX:
    """Return the least distance (1, B) of capsules from each box."""
    over = _over_capsules(ends.shape[1])
    return over.map("boxes", "serial", boxes.shape[1], [0, 1, 3], [])(ends, casadi.MX(size), boxes, horizon)


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
    placed = capsule_ends(chain, hulls)(q)
    size = np.stack([hulls.radius, hulls.radius + 0.5 * hulls.length])
    moving = hulls.moving
    table = horizon
    if over_table:
        lowest = [placed[2 + 3 * end, k] - float(hulls.radius[k]) for k, end in over_table]
        table = casadi.fmin(casadi.mmin(casadi.vertcat(*lowest)) - height, horizon)
    parts = [_self_clearance(chain, links, some, q, horizon) for some in (pairs, close_pairs)]
    parts.append(table)
    for wanted in (False, True):
        some = [k for k in moving if bool(hulls.hand[k]) is wanted]
        far = casadi.repmat(horizon, 1, boxes)
        parts.append((_to_boxes(placed[:, some], casadi.DM(size[:, some]), box, horizon) if some else far).T)
    out = casadi.densify(casadi.vertcat(*parts))
    return casadi.Function("clearance", inputs, [out])
