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
        segment: the pixels and points of it.
        registration: what it was registered as; of equivalent poses, that which is turned least.
        template: the shape; None for an unknown one.
        X_WO: its pose.
        cloud: in O, with what a template filled in.
        doubtful: points in O where there may be something or not (M, 3) [m]: the hand keeps away from them.
        explanations: everything that the view fits, the one that is taken first; empty for an unknown shape.
        made_from: what the cloud was made from, in words.
    """

    segment: Segment
    registration: Registration
    template: Template | None
    X_WO: Pose
    cloud: PointCloud
    doubtful: Array
    explanations: tuple[Explanation, ...]
    made_from: str

    def known_object(self, name: str, image: DepthImage) -> KnownObject:
        """Return it as an object of that name, seen in ``image``."""
        return KnownObject(
            name=name,
            template=None if self.template is None else self.template.name,
            X_WO=self.X_WO,
            explanations=self.explanations,
            cloud=self.cloud,
            doubtful=self.doubtful,
            image=image,
            pixels=self.segment.pixels,
            parts=_parts(self.template, self.cloud),
            stamp=image.stamp,
        )


def estimate_object(
    segment: Segment,
    registration: Registration,
    templates: Mapping[str, Template],
    observation: Observation,
    X_before: Pose | None = None,
) -> ObjectEstimate:
    """Return what a segment is taken for: a placed template, what several have in common, or just the seen points.

    Args:
        X_before: of the poses in which the shape looks the same, that is taken which is turned least from this one:
            from upright by default.
    """
    nowhere = np.zeros((0, 3))
    if registration.template is None or registration.X_WO is None or registration.refusal:
        # An unknown shape has no frame of its own: one like W's, at its middle, on the table.
        X_WO = Pose.from_translation([*segment.cloud.points[:, :2].mean(axis=0), observation.table_height])
        cloud = segment.cloud.transformed(X_WO.inverse())
        return ObjectEstimate(
            segment, registration, None, X_WO, cloud, nowhere, (), "the points that were seen"
        )
    template = templates[registration.template]
    X_WO = template.nearest_equivalent(registration.X_WO, Pose.identity() if X_before is None else X_before)
    registration = replace(registration, X_WO=X_WO)
    cloud = complete_cloud(
        segment.cloud, template, X_WO, image=observation.image, robot_depth=observation.robot_depth
    )
    explanations = (
        Explanation(template.name, X_WO),
        *(Explanation(other.template, other.X_WO) for other in registration.alternatives),
    )
    doubtful, made_from = nowhere, f"the template {template.name}"
    if registration.ambiguous:
        placed = [(templates[name], X) for name, X in explanations]
        shared = cloud.seen_mask | _common(cloud.points, X_WO, placed)
        doubtful = np.concatenate([_doubtful(one, X_WO.inverse() @ X, X_WO, placed) for one, X in placed])
        cloud, made_from = cloud.select(shared), f"what {len(explanations)} explanations of the view share"
    else:
        explanations = explanations[:1]
    return ObjectEstimate(segment, registration, template, X_WO, cloud, doubtful, explanations, made_from)


def grasps_of(
    name: str,
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
    X_OW, image = estimate.X_WO.inverse(), observation.image
    # A segment may have been put together from several, or cut from one.
    others = [o.cloud.points[~estimate.segment.pixels[o.pixels]] for o in observation.segments]
    around = np.concatenate([X_OW.apply(np.concatenate([np.zeros((0, 3)), *others])), estimate.doubtful])
    return detect_grasps(
        estimate.cloud,
        gripper,
        name=name,
        seed=seed,
        settings=settings,
        support=observation.table_height - float(estimate.X_WO.translation[2]),
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
