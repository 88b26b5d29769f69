"""Grasp detection on point clouds: of a known object with its unseen side filled in, or of an unknown one.

Of an unknown object the side that the camera does not see is guessed as a half turn about an upright axis: many
everyday objects look the same after one. Where the axis lies is told by what the camera saw through: turned points must
not lie where it looked past the object or in front of it. The idea of judging symmetries by free space is from J. Bohg
et al., "Mind the gap", 2011, who mirror at planes. A half turn takes each face to one that faces it, which is what two
jaws need.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry import PointCloud, Pose, rotation
from optsc.geometry.rotation import Array
from optsc.grasps.grasp_set import GraspSet
from optsc.robot.gripper import Gripper
from optsc.sampling.antipodal import Progress, check_request, gather, grasp_set
from optsc.sampling.checks import Tally, Workpiece
from optsc.sampling.proposals import propose_on_points
from optsc.sampling.settings import AntipodalSettings
from optsc.sampling.surface import FEWEST, measured_surface, with_normals

_REACH = 0.30  # [m] around the object within which neighbours can be in a hand's path
_COARSE = 0.004  # [m] between the points that stand for neighbours
_CELL = 0.006  # [m] on the object, side of the cells in which the camera's view is kept
_DEEP = 0.08  # [m], the axis lies at most so far behind the middle of what was seen
_STEP = 0.004  # [m] between the axes that are tried
_ASIDE = 0.024  # [m], and at most so far beside it
_SAME = 0.005  # [m] between a turned point and a seen one that count as the same surface
_TOLERANCE = 0.004  # [m] by which a turned point may lie in front of what was seen
_HIDDEN, _SEEN_THROUGH = 0.5, -2.0  # marks of a turned point; one on a seen surface gets up to 1
_WORST = 0.25  # share of turned points where the camera looked through, above which the guess is not made
_FEW = 400  # points that the axes are judged by


def detect_grasps(
    cloud: PointCloud,
    gripper: Gripper,
    *,
    name: str,
    seed: int,
    settings: AntipodalSettings | None = None,
    support: float | None = None,
    up: ArrayLike = (0.0, 0.0, 1.0),
    neighbours: PointCloud | None = None,
    viewpoint: ArrayLike | None = None,
    provenance: Mapping[str, object] | None = None,
    progress: Progress | None = None,
    tally: Tally | None = None,
) -> GraspSet:
    """Return ``settings.count`` grasps of an object of which only points are known, or fewer with the reason.

    They promise what those of `optsc.sampling.sample_grasps` do, as far as the points show it. Normals are
    estimated where the cloud has none. Where no template filled in the unseen side and the camera's place is
    known, a guess at that side takes part, see `with_hidden_side`.

    The provenance gets ``source`` (``cloud``), ``visible_fraction`` (share of the points that were seen, as long
    as ``provenance`` names no other), ``noise`` [m], ``guessed`` (points of the unseen side) and what
    ``provenance`` holds, such as ``template`` and ``stamp``. The same input gives the same grasps.

    Args:
        cloud: in the object's frame O [m].
        gripper: the jaws.
        name: what the object is called.
        seed: of the sampling.
        settings: `AntipodalSettings.for_clouds` by default. Its ``noise`` is what is allowed for at least.
        support: height of the table above O's origin along ``up`` [m]; None where there is none.
        up: direction of up in O (3,).
        neighbours: what else was seen, in O, such as other objects; the hand keeps away from it.
        viewpoint: place of the camera in O (3,) [m], where it is known.
        provenance: facts to store with the grasps; anything that JSON can hold.
        progress: called with the object's name, the grasps found and the grasps that are wanted.
        tally: notes the poses that are left after each check, where they are of interest.

    Raises:
        InvalidValue: too few points, a size that is implausible in metres, a negative seed.
    """
    settings = settings or AntipodalSettings.for_clouds()
    if len(cloud) < FEWEST:
        raise InvalidValue(f"points of {name}", len(cloud), f"at least {FEWEST}")
    check_request(name, np.ptp(cloud.points, axis=0), seed)
    X_UO = _upright(up)
    around = None if neighbours is None else neighbours.transformed(X_UO)
    eye = None if viewpoint is None else X_UO.apply(np.asarray(viewpoint, dtype=float))
    whole = cloud.transformed(X_UO)
    if eye is not None and whole.seen_mask.all():
        whole = with_hidden_side(with_normals(whole, settings.spacing, name, eye), eye, around)
    surface, noise = measured_surface(whole, settings.spacing, name, eye)
    settings = replace(settings, noise=max(settings.noise, noise))
    centre = np.average(surface.points, axis=0, weights=surface.areas)
    work = Workpiece(surface, centre, gripper, settings, support, _obstacles(around, surface.points))
    rng = np.random.default_rng(seed)
    noted = Tally(keep=tally is not None and tally.poses is not None)
    kept = gather(work, partial(propose_on_points, surface, gripper, settings), rng, name, progress, noted)
    kept = kept._replace(X_OG=X_UO.inverse() @ kept.X_OG)
    if tally is not None:
        tally.add(noted.moved(X_UO.inverse()))
    facts = {
        "source": "cloud",
        "visible_fraction": cloud.visible_share,
        "noise": noise,
        "guessed": len(whole) - len(cloud),
        **(provenance or {}),
    }
    return grasp_set(work, kept, name=name, object_hash=cloud_hash(cloud), seed=seed, facts=facts)


def cloud_hash(cloud: PointCloud) -> str:
    """Return ``cloud:`` and the SHA-256 of the points rounded to a micrometre."""
    return "cloud:" + hashlib.sha256(np.round(cloud.points * 1e6).astype("<i8").tobytes()).hexdigest()


def _upright(up: ArrayLike) -> Pose:
    """Return X_UO of a frame U with O's origin whose z axis points along ``up`` (3,) in O."""
    direction = np.asarray(up, dtype=float)
    length = float(np.linalg.norm(direction)) if direction.shape == (3,) else 0.0
    if not (np.isfinite(length) and length > 1e-9):
        raise InvalidValue("up", direction.tolist(), "finite, shape (3,), not zero")
    z = direction / length
    if z[2] > 1.0 - 1e-12:
        return Pose.identity()
    helper = np.eye(3)[np.argmin(np.abs(z))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return Pose(rotation.from_matrix(np.stack([x, np.cross(z, x), z])), np.zeros(3))


def _obstacles(neighbours: PointCloud | None, points: Array) -> Array:
    """Return the points of the neighbours that a hand could meet, thinned out."""
    if neighbours is None or len(neighbours) == 0:
        return np.zeros((0, 3))
    low, high = points.min(axis=0) - _REACH, points.max(axis=0) + _REACH
    near = neighbours.points[np.all((neighbours.points > low) & (neighbours.points < high), axis=1)]
    if len(near) == 0:
        return near
    _, first = np.unique(np.floor(near / _COARSE).astype(np.int64), axis=0, return_index=True)
    return near[first]


def with_hidden_side(cloud: PointCloud, viewpoint: Array, neighbours: PointCloud | None = None) -> PointCloud:
    """Return a cloud with guessed points added, marked as not seen; the cloud itself where no guess is plausible.

    Args:
        cloud: what was seen of one object, in a frame with z up.
        viewpoint: place of the camera (3,) [m].
        neighbours: what else was seen: something may be hidden behind it.

    Raises:
        InvalidValue: a viewpoint that is not finite or lies inside the cloud.
    """
    from scipy.spatial import cKDTree

    eye = np.asarray(viewpoint, dtype=float)
    if eye.shape != (3,) or not np.isfinite(eye).all():
        raise InvalidValue("viewpoint", eye.tolist(), "finite, shape (3,) [m]")
    points = cloud.points
    if np.linalg.norm(points - eye, axis=1).min() < 0.02:
        raise InvalidValue("viewpoint", eye.tolist(), "at least 20 mm away from the object")
    view = _SeenDistances(eye, points if neighbours is None else np.concatenate([points, neighbours.points]))
    tree, few = cKDTree(points), points[:: max(1, len(points) // _FEW)]
    axes = _axes(points, eye)
    best, mark = None, -np.inf
    for axis in axes:
        turned = _half_turn(few, axis)
        off = tree.query(turned)[0]
        # A point near the axis stays where it is, which says nothing.
        same = (off < _SAME) & (np.linalg.norm((turned - few)[:, :2], axis=1) > 2 * _SAME)
        hidden = view.hides(turned)
        if np.mean(~hidden & ~same) > _WORST:
            continue
        score = float(np.mean(np.where(same, 1.0 - 0.5 * off / _SAME, np.where(hidden, _HIDDEN, _SEEN_THROUGH))))
        if score > mark:
            best, mark = axis, score
    if best is None:
        return cloud
    turned = _half_turn(points, best)
    new = view.hides(turned) & (tree.query(turned)[0] > _SAME)
    normals = None
    if cloud.normals is not None:
        normals = (cloud.normals * [-1.0, -1.0, 1.0])[new]
    guessed = PointCloud(turned[new], normals, np.zeros(int(new.sum()), dtype=bool))
    return PointCloud.joined(cloud, guessed)


class _SeenDistances:
    """What the camera saw, as the nearest distance in each cell of its directions."""

    def __init__(self, viewpoint: Array, points: Array) -> None:
        self._eye = viewpoint
        self._axis = points.mean(axis=0) - viewpoint
        distance = float(np.linalg.norm(self._axis))
        self._axis = self._axis / distance
        helper = np.eye(3)[np.argmin(np.abs(self._axis))]
        self._right = np.cross(self._axis, helper)
        self._right /= np.linalg.norm(self._right)
        self._down = np.cross(self._axis, self._right)
        self._per_cell = distance / _CELL
        cells, ranges = self._project(points)
        self._low = cells.min(axis=0) - 2
        shape = cells.max(axis=0) - self._low + 3
        self._nearest = np.full(shape, np.inf)
        at = cells - self._low
        # Cells around a seen one count as seen: the points have gaps between them.
        for step in np.ndindex(3, 3):
            np.minimum.at(self._nearest, tuple((at + np.array(step) - 1).T), ranges)

    def _project(self, points: Array) -> tuple[np.ndarray, Array]:
        ray = points - self._eye
        depth = np.maximum(ray @ self._axis, 1e-6)
        plane = np.stack([ray @ self._right, ray @ self._down], axis=-1) / depth[:, None]
        return np.floor(plane * self._per_cell).astype(np.int64), np.linalg.norm(ray, axis=1)

    def hides(self, points: Array) -> np.ndarray:
        """Tell of which points (N, 3) the camera could not see that they are not there."""
        cells, ranges = self._project(points)
        at = cells - self._low
        inside = np.all((at >= 0) & (at < self._nearest.shape), axis=1)
        nearest = self._nearest[tuple(np.where(inside[:, None], at, 0).T)]
        return inside & (ranges > nearest - _TOLERANCE)


def _axes(points: Array, eye: Array) -> Array:
    """Return where upright axes are tried (A, 2): behind the middle of what was seen and beside it, nearest first."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)[:2]
    away = middle - eye[:2]
    length = float(np.linalg.norm(away))
    away = away / length if length > 1e-6 else np.array([1.0, 0.0])
    aside = np.array([-away[1], away[0]])
    deep = np.arange(-0.5 * _ASIDE, _DEEP + 1e-9, _STEP)
    beside = np.arange(-_ASIDE, _ASIDE + 1e-9, _STEP)
    beside = beside[np.argsort(np.abs(beside), kind="stable")]
    return np.array([middle + d * away + b * aside for d in deep for b in beside])


def _half_turn(points: Array, axis: Array) -> Array:
    return np.stack([2.0 * axis[0] - points[:, 0], 2.0 * axis[1] - points[:, 1], points[:, 2]], axis=-1)
