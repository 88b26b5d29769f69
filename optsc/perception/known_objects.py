"""From one segment to a known object with grasps: what it is, what is not seen of it, how to take hold of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from optsc.geometry import DepthImage, PointCloud, Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.grasps import GraspSet
from optsc.perception.completion import COMMON, complete_cloud
from optsc.perception.registration import Registration
from optsc.perception.scene_state import Explanation, KnownObject
from optsc.perception.segments import Segment
from optsc.perception.templates import Template
from optsc.robot import Gripper
from optsc.sampling.detection import detect_grasps
from optsc.sampling.settings import AntipodalSettings


class Observation(NamedTuple):
    """What one image offers.

    Attributes:
        image: what was measured.
        segments: all objects in it.
        robot_depth: of the arm (H, W) [m], infinite where it is not.
        table_height: of the table in W [m].
    """

    image: DepthImage
    segments: Sequence[Segment]
    robot_depth: Array
    table_height: float


class ObjectShape(NamedTuple):
    """What is taken to be there.

    Attributes:
        X_WO: its pose.
        cloud: in O, with what a template filled in.
        doubtful: points in O where there may be something, or not: the hand keeps away from them.
        explanations: everything that the view fits, the one that is taken first; empty for an unknown shape.
        words: what it was made from.
    """

    X_WO: Pose
    cloud: PointCloud
    doubtful: Array
    explanations: tuple[Explanation, ...]
    words: str


def known_object(
    name: str, shape: ObjectShape, template: Template | None, segment: Segment, image: DepthImage
) -> KnownObject:
    """Return the object that a segment shows."""
    return KnownObject(
        name=name,
        template=None if template is None else template.name,
        X_WO=shape.X_WO,
        explanations=shape.explanations,
        cloud=shape.cloud,
        doubtful=shape.doubtful,
        image=image,
        pixels=segment.pixels,
        parts=_parts(template, shape.cloud),
        stamp=image.stamp,
    )


def shape_of(
    segment: Segment, registration: Registration, templates: Mapping[str, Template], look: Observation
) -> ObjectShape:
    """Return what a segment is taken for: a placed template, what several have in common, or just the points.

    Of an ambiguous view, such as a mug whose handle is hidden, only that counts as surface which all explanations
    share; where only some have something, nothing is grasped and nothing bumped into.
    """
    nowhere = np.zeros((0, 3))
    if registration.template is None or registration.X_WO is None or registration.refusal:
        # An unknown shape has no frame of its own: one like W's, at its middle, on the table.
        X_WO = Pose.from_translation([*segment.cloud.points[:, :2].mean(axis=0), look.table_height])
        cloud = segment.cloud.transformed(X_WO.inverse())
        return ObjectShape(X_WO, cloud, nowhere, (), "the points that were seen")
    template, X_WO = templates[registration.template], registration.X_WO
    cloud = complete_cloud(segment.cloud, template, X_WO, image=look.image, robot_depth=look.robot_depth)
    explanations = (
        Explanation(template.name, X_WO),
        *(Explanation(other.template, other.X_WO) for other in registration.alternatives),
    )
    if not registration.ambiguous:
        return ObjectShape(X_WO, cloud, nowhere, explanations[:1], f"the template {template.name}")
    placed = [(templates[name], X) for name, X in explanations]
    shared = cloud.seen_mask | _common(cloud.points, X_WO, placed)
    doubtful = np.concatenate([_doubtful(one, X_WO.inverse() @ X, X_WO, placed) for one, X in placed])
    words = f"what {len(explanations)} explanations of the view share"
    return ObjectShape(X_WO, cloud.select(shared), doubtful, explanations, words)


def grasps_of(
    name: str,
    shape: ObjectShape,
    segment: Segment,
    look: Observation,
    gripper: Gripper,
    *,
    facts: Mapping[str, object],
    seed: int,
    settings: AntipodalSettings | None,
) -> GraspSet:
    """Return grasps of a shape among what else was seen, above the table; raise `InvalidValue` for too few points."""
    X_OW = shape.X_WO.inverse()
    # A segment may have been put together from several, or cut from one.
    others = [other.cloud.points[~segment.pixels[other.pixels]] for other in look.segments]
    around = np.concatenate([X_OW.apply(np.concatenate([np.zeros((0, 3)), *others])), shape.doubtful])
    return detect_grasps(
        shape.cloud,
        gripper,
        name=name,
        seed=seed,
        settings=settings,
        support=look.table_height - float(shape.X_WO.translation[2]),
        up=X_OW.rotation_matrix()[:, 2],
        neighbours=PointCloud(around) if len(around) else None,
        viewpoint=X_OW.apply(look.image.X_WC.translation),
        provenance={"made_from": shape.words, "stamp": look.image.stamp, **facts},
    )


def _common(points: Array, X_WO: Pose, explanations: Sequence[tuple[Template, Pose]]) -> np.ndarray:
    """Return which points (N, 3) in O lie on the surface of every explanation."""
    common = np.ones(len(points), dtype=bool)
    for template, X in explanations:
        distance, _ = template.field.lookup((X.inverse() @ X_WO).apply(points))
        common &= np.abs(distance) <= COMMON
    return common


def _doubtful(
    template: Template, X_ON: Pose, X_WO: Pose, explanations: Sequence[tuple[Template, Pose]]
) -> Array:
    """Return the points in O of one explanation, at X_ON, that not all the others have."""
    points = X_ON.apply(template.points)
    return points[~_common(points, X_WO, explanations)]


def _parts(template: Template | None, cloud: PointCloud) -> tuple[TriangleMesh, ...]:
    """Return convex pieces: those of a catalogue object, else the hull of everything that is known."""
    from optsc.sim import OBJECT_NAMES, object_model

    if template is not None and template.name in OBJECT_NAMES:
        model = object_model(template.name)
        if model.mesh.hash == template.mesh.hash:
            return model.parts
    points = cloud.points if template is None else template.mesh.vertices
    return (_hull(points),)


def _hull(points: Array) -> TriangleMesh:
    """Return the convex hull; a flat or a thin cloud is given a thickness, for collision checks need a volume."""
    import trimesh

    thickened = np.concatenate(
        [points, points + [0.0, 0.0, 1e-3], points + [1e-3, 0.0, 0.0], points + [0.0, 1e-3, 0.0]]
    )
    hull = trimesh.convex.convex_hull(thickened)
    return TriangleMesh(np.asarray(hull.vertices, dtype=float), np.asarray(hull.faces))
