"""Known objects: from a segment to a pose, a completed shape and grasps.

What is not seen of an object comes from its template. Of an ambiguous view, such as a mug whose handle is hidden, only
that counts as surface which all explanations share; where only some have something, nothing is grasped and nothing
bumped into.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from optsc.geometry import DepthImage, PointCloud, Pose, TriangleMesh
from optsc.geometry.rotation import Array
from optsc.grasps import GraspSet
from optsc.perception.completion import COMMON, complete_cloud
from optsc.perception.registration import Registration
from optsc.perception.scene_registration import Observation
from optsc.perception.segments import Segment
from optsc.perception.templates import Template
from optsc.robot import Gripper
from optsc.sampling.detection import detect_grasps
from optsc.sampling.settings import AntipodalSettings


class Explanation(NamedTuple):
    """A template at a pose that the view of an object fits."""

    template: str
    X_WO: Pose


@dataclass(frozen=True, eq=False)
class KnownObject:
    """An object as it was when it was last modelled from an image.

    Attributes:
        name: what it is called.
        template: name of the template that it is taken for; None for an unknown shape.
        X_WO: its pose.
        explanations: everything that its view fits, the one that is taken first; empty for an unknown shape.
        cloud: its points in O, the seen ones marked.
        doubtful: places in O where there may be something of it or not (M, 3) [m].
        image: where it was seen.
        pixels: (H, W) bool, its silhouette there.
        parts: convex pieces of it in O, for collision checks.
        stamp: when it was last seen unhidden [s].
    """

    name: str
    template: str | None
    X_WO: Pose
    explanations: tuple[Explanation, ...]
    cloud: PointCloud
    doubtful: Array
    image: DepthImage
    pixels: np.ndarray
    parts: tuple[TriangleMesh, ...]
    stamp: float

    @property
    def seen(self) -> Array:
        """What was seen of it (N, 3) in W [m]."""
        return self.X_WO.apply(self.cloud.points[self.cloud.seen_mask])

    @property
    def certain(self) -> bool:
        """Whether its view had a single explanation."""
        return len(self.explanations) == 1

    def moved_to(self, X_WO: Pose) -> KnownObject:
        """Return the object at another pose."""
        X_WW = X_WO @ self.X_WO.inverse()
        moved = tuple(Explanation(name, X_WW @ X) for name, X in self.explanations)
        return replace(self, X_WO=X_WO, explanations=moved)


class ObjectEstimate(NamedTuple):
    """What a segment is taken for.

    Attributes:
        known: the object.
        registration: of the segment; of equivalent poses, that which is turned least.
        template: its shape; None for an unknown one.
        made_from: what its cloud was made from, in words.
    """

    known: KnownObject
    registration: Registration
    template: Template | None
    made_from: str


def estimate_object(
    name: str,
    segment: Segment,
    registration: Registration,
    templates: Mapping[str, Template],
    observation: Observation,
    X_before: Pose | None = None,
) -> ObjectEstimate:
    """Return what a segment is taken for: a placed template, what several have in common, or just the seen points.

    Args:
        name: of the object.
        X_before: of the poses in which the shape looks the same, that is taken which is turned least from this one:
            from upright by default.
    """
    explanations: tuple[Explanation, ...] = ()
    doubtful, template = np.zeros((0, 3)), None
    if registration.template is None or registration.X_WO is None or registration.refusal:
        # An unknown shape has no frame of its own: one like W's, at its middle, on the table.
        X_WO = Pose.from_translation([*segment.cloud.points[:, :2].mean(axis=0), observation.table_height])
        cloud, made_from = segment.cloud.transformed(X_WO.inverse()), "the points that were seen"
    else:
        template = templates[registration.template]
        X_before = Pose.identity() if X_before is None else X_before
        X_WO = template.nearest_equivalent(registration.X_WO, X_before)
        registration = replace(registration, X_WO=X_WO)
        image, robot_depth = observation.image, observation.robot_depth
        cloud = complete_cloud(segment.cloud, template, X_WO, image=image, robot_depth=robot_depth)
        explanations, made_from = (Explanation(template.name, X_WO),), f"the template {template.name}"
        if registration.ambiguous:
            explanations += tuple(Explanation(o.template, o.X_WO) for o in registration.alternatives)
            placed = [(templates[kind], X) for kind, X in explanations]
            shared = cloud.seen_mask | _common(cloud.points, X_WO, placed)
            doubtful = np.concatenate([_doubtful(one, X_WO.inverse() @ X, X_WO, placed) for one, X in placed])
            cloud, made_from = (
                cloud.select(shared),
                f"what {len(explanations)} explanations of the view share",
            )
    known = KnownObject(
        name=name,
        template=None if template is None else template.name,
        X_WO=X_WO,
        explanations=explanations,
        cloud=cloud,
        doubtful=doubtful,
        image=observation.image,
        pixels=segment.pixels,
        parts=_parts(template, cloud),
        stamp=observation.image.stamp,
    )
    return ObjectEstimate(known, registration, template, made_from)


def grasps_of(
    estimate: ObjectEstimate,
    observation: Observation,
    gripper: Gripper,
    *,
    facts: Mapping[str, object],
    seed: int,
    settings: AntipodalSettings | None,
) -> GraspSet:
    """Return grasps of an object among what else was seen, above the table.

    Args:
        observation: what else was seen.
        facts: kept in the set's provenance, beside what it was made from and when.
        seed: same arguments and seed, same grasps.
        settings: by default `AntipodalSettings.for_clouds`.

    Raises:
        InvalidValue: too few points.
    """
    known, image = estimate.known, observation.image
    X_OW = known.X_WO.inverse()
    # A segment may have been put together from several, or cut from one.
    others = [other.cloud.points[~known.pixels[other.pixels]] for other in observation.segments]
    around = np.concatenate([X_OW.apply(np.concatenate([np.zeros((0, 3)), *others])), known.doubtful])
    return detect_grasps(
        known.cloud,
        gripper,
        name=known.name,
        seed=seed,
        settings=settings,
        support=observation.table_height - float(known.X_WO.translation[2]),
        up=X_OW.rotation_matrix()[:, 2],
        neighbours=PointCloud(around) if len(around) else None,
        viewpoint=X_OW.apply(image.X_WC.translation),
        provenance={"made_from": estimate.made_from, "stamp": image.stamp, **facts},
    )


def unused_name(template: str | None, taken: Collection[str]) -> str:
    """Return a name for an object of that template, ``unknown`` without one, numbered from the second one on."""
    name, number = template or "unknown", 2
    if name not in taken:
        return name
    while f"{name}-{number}" in taken:
        number += 1
    return f"{name}-{number}"


def _common(points: Array, X_WO: Pose, explanations: Sequence[tuple[Template, Pose]]) -> np.ndarray:
    """Return which points (N, 3) in O lie on the surface of every explanation."""
    common = np.ones(len(points), dtype=bool)
    for template, X in explanations:
        distance, _ = template.field.lookup((X.inverse() @ X_WO).apply(points))
        common &= np.abs(distance) <= COMMON
    return common


def _doubtful(template: Template, X_ON: Pose, X_WO: Pose, explanations: Sequence[tuple[Template, Pose]]) -> Array:
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
