"""Link capsules: few round bodies that hold the collision shapes of every link of an arm and its hand."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import coal
import numpy as np

from optsc.cache import computed_once, content_key
from optsc.collision.capsule_fit import FIT_STEPS, GRID, LONGEST_EDGE, MOST_CAPSULES, WORTH, cover
from optsc.collision.kernels.capsules import LinkCapsules
from optsc.collision.link_shapes import LinkShapes
from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.robot.model import RobotModel

FORMAT = 2
"""Changed whenever stored capsules have to be fitted again."""
_BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    + [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)


def surface(shape: Any, name: str) -> Array:
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


class _Body(NamedTuple):
    """The surface of a link in the frame of the joint of the arm that carries it; -1 for none."""

    link: str
    joint: int
    hand: bool
    triangles: Array

    def hull(self) -> _Body:
        from scipy.spatial import ConvexHull

        points = self.triangles.reshape(-1, 3)
        return self._replace(triangles=points[ConvexHull(points).simplices])


def _joined(parts: Sequence[_Body]) -> _Body:
    return parts[0]._replace(triangles=np.concatenate([part.triangles for part in parts]))


def _bodies(robot: RobotModel) -> list[_Body]:
    """Return every link; the two fingers are one body: all that they sweep between shut and open."""
    all_shapes = LinkShapes(robot)
    stroke = 0.0 if robot.gripper is None else robot.gripper.max_opening
    shut, open_ = (_placements(all_shapes, opening) for opening in (0.0, stroke))
    found: dict[str, list[_Body]] = {}
    fingers: list[_Body] = []
    for k, shape in enumerate(all_shapes.shapes):
        link, triangles = all_shapes.links[k], surface(shape.geometry, shape.name)
        if k in all_shapes.jaws:
            swept = np.concatenate([shut[k].of(triangles), open_[k].of(triangles)])
            fingers.append(_Body(link, shut[k].joint, True, swept))
        else:
            body = _Body(link, shut[k].joint, k in all_shapes.hand, shut[k].of(triangles))
            found.setdefault(link, []).append(body)
    bodies = [_joined(parts) for parts in found.values()]
    return [*bodies, _joined(fingers).hull()] if fingers else bodies


class _Placement(NamedTuple):
    """A joint of the arm, and a shape's rotation and position in its frame."""

    joint: int
    R: Array
    p: Array

    def of(self, triangles: Array) -> Array:
        return triangles @ self.R.T + self.p


def _placements(all_shapes: LinkShapes, opening: float) -> list[_Placement]:
    """Return for each shape where it is fixed to the arm, at a distance ``opening`` [m] between the pads."""
    model = all_shapes.model
    arm = {model.getJointId(name): k for k, name in enumerate(all_shapes.robot.joint_names)}
    data, placed = all_shapes.placements(all_shapes.geometry, all_shapes.neutral(opening))
    result = []
    for k, shape in enumerate(all_shapes.shapes):
        joint = shape.parentJoint
        while joint and joint not in arm:
            joint = model.parents[joint]
        X = data.oMi[joint].inverse() * placed.oMg[k]
        result.append(_Placement(arm.get(joint, -1), X.rotation.copy(), X.translation.copy()))
    return result


def _key(bodies: Sequence[_Body]) -> str:
    parts: list[np.ndarray | float | str] = [repr((FORMAT, MOST_CAPSULES, WORTH, GRID, LONGEST_EDGE, FIT_STEPS))]
    for body in bodies:
        parts += [repr(body[:3]), np.round(body.triangles * 1e7).astype(np.int64)]
    return content_key(*parts)


def _fitted(bodies: Sequence[_Body]) -> dict[str, np.ndarray]:
    covers = [cover(body.triangles) for body in bodies]
    return {
        "body": np.repeat(np.arange(len(bodies)), [len(capsules) for capsules in covers]),
        "ends": np.array([[c.a, c.b] for capsules in covers for c in capsules]),
        "radius": np.array([c.radius for capsules in covers for c in capsules]),
    }


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
        bodies = [body.hull() for body in bodies]
    names = frozenset({"body", "ends", "radius"})
    fitted = computed_once("capsules", _key(bodies), names, lambda: _fitted(bodies))
    owner = [bodies[k] for k in fitted["body"]]
    return LinkCapsules(
        link=tuple(body.link for body in owner),
        joint=np.array([body.joint for body in owner]),
        ends=fitted["ends"],
        radius=fitted["radius"],
        hand=np.array([body.hand for body in owner]),
    )
