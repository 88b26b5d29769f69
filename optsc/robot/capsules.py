"""Capsules around the links of an arm: few round bodies that hold every point of the collision shapes.

A capsule is the set of points within a radius of a segment. Distances between capsules have closed forms and turn
smoothly with the posture, which distances between polyhedra do not. A capsule holds a triangle when it holds the
corners, so a link is covered by giving each of its triangles to one capsule.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio

from optsc.cache import cache_directory, write_atomically
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry.rotation import Array
from optsc.kernels.capsules import LinkCapsules
from optsc.robot.model import RobotModel

MOST_CAPSULES = 3
"""Capsules that a link gets at most."""
WORTH = 0.9
"""One more capsule has to bring the volume of a link down to this share."""
GRID = 24
"""Points along each side of the grid that volumes of unions are counted on."""
FORMAT = 1
"""Changed whenever stored capsules have to be fitted anew."""
ROUNDS = 4
"""Times that triangles are dealt out anew among the capsules of a link."""
FIT_STEPS = 200
"""Trials in fitting one capsule."""
LONGEST_EDGE = 0.03
"""Triangles are cut until their edges are no longer [m], so that they fit into one of several capsules."""
ROUNDING = 1e-9
"""Added to a radius [m], so that rounding cannot leave a point outside."""
_BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    + [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)


class Capsule(NamedTuple):
    """The points within ``radius`` [m] of the segment from ``a`` to ``b``, (3,) [m]."""

    a: Array
    b: Array
    radius: float

    @property
    def volume(self) -> float:
        """[m^3]."""
        length = float(np.linalg.norm(self.b - self.a))
        return np.pi * self.radius**2 * (length + 4.0 / 3.0 * self.radius)


def distance_to_segment(points: Array, a: Array, b: Array) -> Array:
    """Return the distances (N,) of points (N, 3) from the segment a to b."""
    along = b - a
    t = np.clip((points - a) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
    return np.linalg.norm(points - a - t[:, None] * along, axis=1)


def _around(points: Array, axis: Array, shift: Array, spare: float) -> Capsule:
    """Return the shortest capsule about the line through ``shift`` along ``axis`` that holds the points.

    Its radius is the greatest distance from the line, and ``spare`` more, which makes it shorter.
    """
    axis = axis / np.linalg.norm(axis)
    relative = points - shift
    z = relative @ axis
    square = np.maximum(np.einsum("ij,ij->i", relative, relative) - z * z, 0.0)
    radius = float(np.sqrt(square.max())) * (1.0 + abs(spare)) + ROUNDING
    cap = np.sqrt(radius * radius - square)
    low, high = float((z + cap).min()), float((z - cap).max())
    if low > high:
        low = high = 0.5 * (low + high)
        radius = float(np.linalg.norm(relative - low * axis, axis=1).max()) + ROUNDING
    return Capsule(shift + low * axis, shift + high * axis, radius)


def _rough_capsule(points: Array) -> tuple[Capsule, Array]:
    """Return the least of the capsules along the three main directions of the points, and its frame (3, 3)."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    frame = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    capsules = [_around(points, axis, centre, 0.0) for axis in frame]
    best = int(np.argmin([c.volume for c in capsules]))
    return capsules[best], np.roll(frame, -best, axis=0)


def fit_capsule(points: Array) -> Capsule:
    """Return a capsule of (locally) least volume that holds points (N, 3) [m]."""
    from scipy.optimize import minimize

    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    scale = max(float(np.ptp(points, axis=0).max()), 1e-6)
    rough, (axis, u, v) = _rough_capsule(points)

    def candidate(x: Array) -> Capsule:
        return _around(points, axis + x[0] * u + x[1] * v, centre + scale * (x[2] * u + x[3] * v), x[4])

    start = np.vstack([np.zeros(5), 0.1 * np.eye(5)])
    options = {"maxfev": FIT_STEPS, "initial_simplex": start, "xatol": 1e-4, "fatol": 1e-12}
    found = minimize(lambda x: candidate(x).volume, start[0], method="Nelder-Mead", options=options)
    return min(candidate(found.x), rough, key=lambda capsule: capsule.volume)


def _corner_points(triangles: Array) -> Array:
    """Return the extreme points among the corners of triangles (F, 3, 3)."""
    from scipy.spatial import ConvexHull, QhullError

    points = np.unique(triangles.reshape(-1, 3), axis=0)
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points


def _dealt(triangles: Array, capsules: Sequence[Capsule]) -> np.ndarray:
    """Return for each triangle the capsule that it sticks out of least."""
    out = [
        (distance_to_segment(triangles.reshape(-1, 3), c.a, c.b) / c.radius).reshape(-1, 3).max(axis=1)
        for c in capsules
    ]
    return np.argmin(out, axis=0)


def _cut(triangles: Array, count: int, direction: Array) -> np.ndarray:
    """Return the slice of ``count`` equal ones across a direction that each triangle's centre is in."""
    z = triangles.mean(axis=1) @ direction
    share = (z - z.min()) / max(float(np.ptp(z)), 1e-12)
    return np.minimum((share * count).astype(int), count - 1)


def _split(triangles: Array, longest: float) -> Array:
    """Return the triangles (F, 3, 3) with every edge longer than ``longest`` halved, again and again."""
    while True:
        edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        long = edges.max(axis=1) > longest
        if not long.any():
            return triangles
        rows, k = np.flatnonzero(long), edges[long].argmax(axis=1)
        a, b, c = (triangles[rows, (k + shift) % 3] for shift in range(3))
        middle = 0.5 * (a + b)
        halves = (np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1))
        triangles = np.concatenate([triangles[~long], *halves])


def _covered_by(triangles: Array, count: int) -> list[Capsule]:
    """Return ``count`` capsules of little volume that hold all triangles."""
    best, best_group = np.inf, np.zeros(len(triangles), dtype=int)
    axes = np.linalg.svd(triangles.reshape(-1, 3) - triangles.mean(axis=(0, 1)), full_matrices=False)[2]
    for direction in axes if count > 1 else axes[:1]:
        group = _cut(triangles, count, direction)
        for _ in range(ROUNDS):
            parts = [triangles[group == k] for k in range(count)]
            capsules = [_rough_capsule(_corner_points(part))[0] for part in parts if len(part)]
            if _volume(capsules) < best:
                best, best_group = _volume(capsules), group
            dealt = _dealt(triangles, capsules)
            if len(capsules) < count or np.array_equal(dealt, group):
                break
            group = dealt
    groups = [triangles[best_group == k] for k in range(count)]
    return [fit_capsule(_corner_points(group)) for group in groups if len(group)]


def _volume(capsules: Sequence[Capsule]) -> float:
    return sum(c.volume for c in capsules)


def cover(triangles: Array, most: int = MOST_CAPSULES) -> list[Capsule]:
    """Return up to ``most`` capsules that together hold all triangles (F, 3, 3) [m].

    More than one only where that saves much of the volume.
    """
    fine = _split(triangles, LONGEST_EDGE)
    covers = [_covered_by(fine, count) for count in range(1, most + 1)]
    return min(covers, key=lambda capsules: _union_volume(capsules) / WORTH ** len(capsules))


def _union_volume(capsules: Sequence[Capsule]) -> float:
    """Return the volume [m^3] of a union, counted on a grid."""
    reach = np.array([[c.a - c.radius, c.a + c.radius, c.b - c.radius, c.b + c.radius] for c in capsules])
    low, high = reach.min(axis=(0, 1)), reach.max(axis=(0, 1))
    sides = [np.linspace(low[k], high[k], GRID) for k in range(3)]
    points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.any([distance_to_segment(points, c.a, c.b) <= c.radius for c in capsules], axis=0)
    return float(inside.mean() * np.prod(high - low))


def _corners(shape: Any, name: str) -> Array:
    """Return the surface of a collision shape as triangles (F, 3, 3) [m]; a round one as its bounding box."""
    if isinstance(shape, coal.BVHModelBase):
        vertices = np.asarray(shape.vertices())
        faces = [shape.tri_indices(i) for i in range(shape.num_tris)]
        return vertices[np.array([[face[0], face[1], face[2]] for face in faces])]
    shape.computeLocalAABB()
    box = shape.aabb_local
    signs = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    corners = np.where(signs, np.asarray(box.max_).ravel(), np.asarray(box.min_).ravel())
    if not np.all(np.isfinite(corners)):
        raise InvalidValue(f"collision shape {name}", type(shape).__name__, "of finite size")
    return corners[_BOX_FACES]


def _hull_triangles(points: Array) -> Array:
    from scipy.spatial import ConvexHull

    return points[ConvexHull(points).simplices]


class _Body(NamedTuple):
    link: str
    joint: int
    hand: bool
    triangles: Array


def _bodies(robot: RobotModel) -> list[_Body]:
    """Return the surface of every link in the frame of the joint of the arm that carries it.

    The two fingers are one body: all that they sweep between shut and open.
    """
    path = str(robot.urdf)
    try:
        model = pinocchio.buildModelFromUrdf(path)
        shapes = pinocchio.buildGeomFromUrdf(model, path, pinocchio.GeometryType.COLLISION)
    except (ValueError, RuntimeError) as error:
        raise DamagedFile(robot.urdf, f"collision geometry cannot be loaded ({error})") from None
    names = () if robot.gripper is None else robot.gripper.finger_joints
    jaws = {model.getJointId(name) for name in names if model.existJointName(name)}
    carriers = {model.frames[model.getFrameId(model.names[jaw])].parentFrame for jaw in jaws}
    shut, open_ = (_placements(robot, model, shapes, jaws, opening) for opening in (0.0, _stroke(robot)))
    found: dict[str, list[_Body]] = {}
    fingers: list[_Body] = []
    for k, shape in enumerate(shapes.geometryObjects):
        link = model.frames[shape.parentFrame].name
        triangles = _corners(shape.geometry, shape.name)
        if shape.parentJoint in jaws:
            swept = np.concatenate([shut[k].of(triangles), open_[k].of(triangles)])
            fingers.append(_Body(link, shut[k].joint, True, swept))
        else:
            body = _Body(link, shut[k].joint, shape.parentFrame in carriers, shut[k].of(triangles))
            found.setdefault(link, []).append(body)
    bodies = [_joined(parts) for parts in found.values()]
    if fingers:
        both = _joined(fingers)
        bodies.append(both._replace(triangles=_hull_triangles(both.triangles.reshape(-1, 3))))
    return bodies


def _joined(parts: Sequence[_Body]) -> _Body:
    return parts[0]._replace(triangles=np.concatenate([part.triangles for part in parts]))


def _stroke(robot: RobotModel) -> float:
    return 0.0 if robot.gripper is None else robot.gripper.max_opening


class _Placement(NamedTuple):
    """A joint of the arm, and a shape's rotation and position in its frame."""

    joint: int
    R: Array
    p: Array

    def of(self, triangles: Array) -> Array:
        return triangles @ self.R.T + self.p


def _placements(
    robot: RobotModel, model: Any, shapes: Any, jaws: set[int], opening: float
) -> list[_Placement]:
    """Return for each shape where it is fixed to the arm, at a distance ``opening`` [m] between the pads."""
    arm = {model.getJointId(name): k for k, name in enumerate(robot.joint_names)}
    q = np.clip(pinocchio.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)
    for jaw in jaws:
        q[model.joints[jaw].idx_q] = 0.5 * opening
    data, placed = model.createData(), shapes.createData()
    pinocchio.updateGeometryPlacements(model, data, shapes, placed, q)
    result = []
    for k, shape in enumerate(shapes.geometryObjects):
        joint = shape.parentJoint
        while joint and joint not in arm:
            joint = model.parents[joint]
        X = data.oMi[joint].inverse() * placed.oMg[k]
        result.append(_Placement(arm.get(joint, -1), X.rotation.copy(), X.translation.copy()))
    return result


def _key(bodies: Sequence[_Body]) -> str:
    digest = hashlib.sha256(repr((FORMAT, MOST_CAPSULES, WORTH, GRID, LONGEST_EDGE, FIT_STEPS)).encode())
    for body in bodies:
        digest.update(repr((body.link, body.joint, body.hand, body.triangles.shape)).encode())
        digest.update(np.round(body.triangles * 1e7).astype("<i8").tobytes())
    return digest.hexdigest()[:32]


def _stored(path: Path) -> list[list[list[float]]] | None:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return None


@lru_cache(maxsize=32)
def link_capsules(robot: RobotModel, hulls: bool = False) -> LinkCapsules:
    """Return capsules that hold every link of an arm and its hand, the fingers in every position of the jaws.

    With ``hulls`` they hold the convex hull of every link instead of its surface. They hold its inside as well: from
    a point outside three convex bodies some ray misses all of them, so no more than three (`MOST_CAPSULES`) cannot
    surround a hole.

    Fitting takes some seconds; the result is kept in the per-user cache.

    Raises:
        DamagedFile: the description or one of its collision meshes cannot be read.
        InvalidValue: a collision shape is unbounded.
    """
    bodies = _bodies(robot)
    if hulls:
        bodies = [body._replace(triangles=_hull_triangles(body.triangles.reshape(-1, 3))) for body in bodies]
    path = cache_directory("capsules") / f"{robot.name}-{_key(bodies)}.json"
    rows = _stored(path)
    if rows is None:
        covers = [cover(body.triangles) for body in bodies]
        rows = [[[*c.a.tolist(), *c.b.tolist(), c.radius] for c in capsules] for capsules in covers]
        write_atomically(path, json.dumps(rows).encode())
    owner = [body for body, own in zip(bodies, rows, strict=True) for _ in own]
    flat = np.array([row for own in rows for row in own])
    return LinkCapsules(
        link=tuple(body.link for body in owner),
        joint=np.array([body.joint for body in owner]),
        ends=flat[:, :6].reshape(-1, 2, 3),
        radius=flat[:, 6],
        hand=np.array([body.hand for body in owner]),
    )
