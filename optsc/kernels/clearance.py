"""How far an arm's capsules are from each other, from a table and from boxes, as one CasADi function of the posture.

Distances only, without gradients, for many postures at once. What is further away than a horizon is not looked at
closely: two spheres around two bodies tell that, and the result says the horizon.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi
import numpy as np

from optsc.kernels.capsules import LinkCapsules, capsule_ends
from optsc.kernels.chain import Chain
from optsc.kernels.segments import TINY, clip, nearest_shares, nearest_to_box, norm

BOX = 15
"""Numbers of a box: rotation (column by column), centre, half extents."""


def _either(name: str, inputs: list[casadi.MX], near: casadi.MX, close: casadi.Function) -> casadi.MX:
    """Return the value of ``close`` where ``near``, else the last of the inputs, the horizon."""
    arguments = [casadi.MX.sym(f"x{i}", *x.shape) for i, x in enumerate(inputs)]
    far = casadi.Function(f"{name}_far", arguments, [arguments[-1]])
    return casadi.Function.if_else(name, close, far)(near, *inputs)


def between_capsules() -> casadi.Function:
    """Return the function (ends, other ends, sum of the radii) -> distance of two capsules [m]."""
    first, second, radii = (casadi.SX.sym(name, n) for name, n in (("first", 6), ("second", 6), ("radii", 1)))
    a, b = (first[:3], first[3:]), (second[:3], second[3:])
    s, t, _ = nearest_shares(a, b, casadi.SX(2, 1))
    gap = a[0] + s * (a[1] - a[0]) - b[0] - t * (b[1] - b[0])
    return casadi.Function("between_capsules", [first, second, radii], [norm(gap) - radii])


def _if_near(name: str, distance: casadi.Function, sizes: dict[str, int]) -> casadi.Function:
    """Return (near, inputs, horizon) -> distance where it is near, and the horizon at most, else the horizon."""
    symbols = [casadi.MX.sym(label, size) for label, size in sizes.items()]
    close = casadi.Function(f"{name}_close", symbols, [casadi.fmin(distance(*symbols[:-1]), symbols[-1])])
    near = casadi.MX.sym("near")
    return casadi.Function(name, [near, *symbols], [_either(f"{name}_choice", symbols, near, close)])


def to_box() -> casadi.Function:
    """Return the function (ends, radius, box) -> distance of a capsule from a box [m].

    Where the segment meets the box it is minus the radius: how deep it is in is not asked.
    """
    ends, radius, box = casadi.SX.sym("ends", 6), casadi.SX.sym("radius"), casadi.SX.sym("box", BOX)
    R, centre, half = casadi.reshape(box[:9], 3, 3), box[9:12], box[12:15]
    a, b = R.T @ (ends[:3] - centre), R.T @ (ends[3:] - centre)
    p = a + nearest_to_box(a, b, half, casadi.SX(0.0)) * (b - a)
    outside = p - casadi.fmin(casadi.fmax(p, -half), half)
    return casadi.Function("to_box", [ends, radius, box], [norm(outside) - radius])


def _near(count: int) -> casadi.Function:
    """(ends (6, count), sizes (2, count), box, horizon) -> which capsules may be nearer to the box than the horizon."""
    ends, size = casadi.SX.sym("ends", 6, count), casadi.SX.sym("size", 2, count)
    box, horizon = casadi.SX.sym("box", BOX), casadi.SX.sym("horizon")
    R, flags = casadi.reshape(box[:9], 3, 3), []
    for k in range(count):
        local = R.T @ (0.5 * (ends[:3, k] + ends[3:, k]) - box[9:12])
        outside = casadi.fmax(casadi.fabs(local) - box[12:15], 0.0)
        flags.append(casadi.dot(outside, outside) < (size[1, k] + horizon) ** 2)
    return casadi.Function("near", [ends, size, box, horizon], [casadi.densify(casadi.horzcat(*flags))])


def _self_clearance(
    chain: Chain, links: LinkCapsules, pairs: Sequence[tuple[int, int]], q: casadi.MX, horizon: casadi.MX
) -> casadi.MX:
    if not pairs:
        return horizon
    ends = capsule_ends(chain, links)(q)
    first, second = [a for a, _ in pairs], [b for _, b in pairs]
    radii = casadi.MX(casadi.DM(links.radius[first] + links.radius[second]).T)
    near = _near_pairs(links, pairs)(ends, horizon)
    sizes = {"first": 6, "second": 6, "radii": 1, "horizon": 1}
    each = _if_near("between", between_capsules(), sizes).map("self_pairs", "serial", len(pairs), [4], [])
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

    The second capsule is looked at together with all that is fixed to it, as one ball.
    """
    ends, horizon = casadi.SX.sym("ends", 6, len(capsules.link)), casadi.SX.sym("horizon")
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
    return casadi.Function("near_pairs", [ends, horizon], [casadi.densify(casadi.horzcat(*flags))])


def _over_capsules(count: int) -> casadi.Function:
    """(ends, sizes, box, horizon) -> least distance of the capsules from a box."""
    ends, size = casadi.MX.sym("ends", 6, count), casadi.MX.sym("size", 2, count)
    box, horizon = casadi.MX.sym("box", BOX), casadi.MX.sym("horizon")
    inputs = [ends, size, box, horizon]
    near = _near(count)(*inputs)
    sizes = {"ends": 6, "radius": 1, "box": BOX, "horizon": 1}
    each = _if_near("to_box", to_box(), sizes).map("capsules", "serial", count, [3, 4], [])
    least = casadi.mmin(each(near, ends, size[0, :], box, horizon))
    # Most boxes are far from all capsules.
    close = casadi.Function("over_capsules_close", inputs, [least])
    found = _either("over_capsules_choice", inputs, casadi.mmax(near), close)
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
    q, horizon, height = casadi.MX.sym("q", chain.n), casadi.MX.sym("horizon"), casadi.MX.sym("height")
    box = casadi.MX.sym("boxes", BOX, boxes)
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
    return casadi.Function("clearance", [q, horizon, height, box], [out])
