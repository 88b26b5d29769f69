"""Grasps on what a camera saw: of a known object with its unseen side filled in, or of an unknown one as it is."""

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
from optsc.sampling.checks import Tally, Workpiece
from optsc.sampling.gathering import Progress, check_request, gather, grasp_set
from optsc.sampling.hidden_side import with_hidden_side
from optsc.sampling.measured import FEWEST, measured_surface, with_normals
from optsc.sampling.proposals import propose_on_points
from optsc.sampling.settings import AntipodalSettings

_REACH = 0.30  # [m] around the object within which neighbours can be in the way of a hand
_COARSE = 0.004  # [m] between the points that stand for neighbours


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
    known, a guess at that side takes part, see `optsc.sampling.hidden_side`.

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
        progress: called with the object's name, the grasps found and the grasps that are looked for.
        tally: notes the poses that are left after each check, where they are of interest.

    Raises:
        InvalidValue: too few points, a size that cannot have been meant in metres, a negative seed.
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
