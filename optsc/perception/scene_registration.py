"""Registration of all segments of one image: what does not fit as it is, is cut or joined until it does.

Two objects cannot be in one place: one that seems to be there twice was seen in pieces.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.geometry import DepthImage, Pose
from optsc.geometry.rotation import Array
from optsc.perception.occlusion import robot_depth, robot_mask, view_is_clear
from optsc.perception.registration import Registration, RegistrationSettings, register
from optsc.perception.segmentation import Segmentation, SegmentationSettings, segment_image
from optsc.perception.segments import Segment, joined_segments, segment_from_pixels, split_at_creases
from optsc.perception.templates import Template, templates_by_name
from optsc.robot import RobotModel

BELONGS = 0.9
"""A segment belongs to an object if this share of its points lies on it."""
WORTH_CUTTING = 0.15
"""A refused segment is cut along the template's edge if both sides are at least this share of it."""
CLOSEST = 0.5
"""The middles of two objects are at least this share of the sum of their smallest half extents apart [-]."""


class Observation(NamedTuple):
    """One depth image, with the arm left out and the objects apart.

    Attributes:
        image: what was measured.
        segmentation: the objects in it, and what was left out.
        robot_depth: of the arm (H, W) [m], infinite where it is not.
        table_height: where the table is expected in W [m].
    """

    image: DepthImage
    segmentation: Segmentation
    robot_depth: Array
    table_height: float

    @classmethod
    def of(
        cls,
        image: DepthImage,
        *,
        robot: RobotModel | None = None,
        q: ArrayLike | None = None,
        table_height: float = 0.0,
        settings: SegmentationSettings | None = None,
    ) -> Observation:
        """Return the segmented image.

        Args:
            robot: the arm that may be in it; without it, or without ``q``, all that stands out is an object.
            q: measured configuration of the arm at that time (n,) [rad].
            table_height: where the table is expected in W [m].
        """
        mask, hiding = None, np.full(image.depth.shape, np.inf)
        if robot is not None and q is not None:
            mask, hiding = robot_mask(robot, q, image), robot_depth(robot, q, image.camera, image.X_WC)
        found = segment_image(image, table_height=table_height, robot_mask=mask, settings=settings)
        return cls(image, found, hiding, table_height)

    @property
    def segments(self) -> tuple[Segment, ...]:
        """All objects in the image, the largest first."""
        return self.segmentation.segments

    def shows_clearly(self, segment: Segment) -> bool:
        """Tell whether the arm is neither in front of a segment nor close beside it."""
        return view_is_clear(segment.pixels, self.robot_depth, self.image).clear


class RegisteredSegment(NamedTuple):
    """An object that was found, or something that was not."""

    segment: Segment
    """All pieces of it together."""
    registration: Registration
    pieces: tuple[int, ...]
    """Which segments these were; numbers past those given are parts that were cut from refused ones."""


def register_scene(
    segments: Sequence[Segment],
    templates: Sequence[Template],
    image: DepthImage,
    *,
    robot_depth: Array | None = None,
    table_height: float = 0.0,
    settings: RegistrationSettings | None = None,
    seed: int = 0,
) -> tuple[RegisteredSegment, ...]:
    """Return what the segments are, one entry per object, in the order of each object's largest piece.

    Segments are registered from the largest to the smallest. One that is refused may be two objects that touch: it is
    cut at its creases, or along the edge of the template that explains part of it, if a part is then not refused.
    Segments that lie on a pose may be pieces of one object that something in front parts: they are joined if the
    joint points fit about as well as the one piece alone.

    Args:
        templates, robot_depth, table_height, settings, seed: as `register` takes them.

    Raises:
        InvalidValue: as `register`.
    """
    by_name, settings = templates_by_name(templates), settings or RegistrationSettings()
    scene = SceneRegistrar(by_name, image, robot_depth, table_height, settings, seed)
    return scene.register_all(segments)


def recognise(
    observation: Observation,
    segments: Sequence[Segment],
    templates: Mapping[str, Template],
    settings: RegistrationSettings | None = None,
    seed: int = 0,
) -> tuple[RegisteredSegment, ...]:
    """Return what some segments of an observation are: `register_scene`, and no two objects in one place.

    Without templates every segment is refused.
    """
    if not templates:
        unknown = Registration.refused("no templates were given")
        return tuple(RegisteredSegment(segment, unknown, (i,)) for i, segment in enumerate(segments))
    image, hiding, height = observation.image, observation.robot_depth, observation.table_height
    scene = SceneRegistrar(templates, image, hiding, height, settings or RegistrationSettings(), seed)
    return scene.without_overlaps(scene.register_all(segments))


class SceneRegistrar(NamedTuple):
    """What all segments of one image are registered with."""

    templates: Mapping[str, Template]
    image: DepthImage
    robot_depth: Array | None
    table_height: float
    settings: RegistrationSettings
    seed: int

    def register_all(self, segments: Sequence[Segment]) -> tuple[RegisteredSegment, ...]:
        """Return what the segments are, see `register_scene`."""
        pieces = self._cut(segments)
        pieces.sort(key=lambda one: (-len(one.segment.cloud), one.pieces))
        order = [one.pieces[0] for one in pieces]
        found: list[RegisteredSegment] = []
        for one in pieces:
            taken = {i for other in found for i in other.pieces}
            if one.pieces[0] in taken:
                continue
            others = [other for other in pieces if other is not one and other.pieces[0] not in taken] + found
            whole = self._joined(one, others)
            found = [other for other in found if not set(other.pieces) & set(whole.pieces)] + [whole]
        return tuple(sorted(found, key=lambda other: min(map(order.index, other.pieces))))

    def without_overlaps(self, registered: Sequence[RegisteredSegment]) -> tuple[RegisteredSegment, ...]:
        """Return what was registered, the larger first, with what was placed inside another object joined to it.

        The joint points say what it is; where they fit nothing, the larger piece does.
        """
        kept: list[RegisteredSegment] = []
        for one in registered:
            at = next((i for i, other in enumerate(kept) if self._overlap(one, other)), None)
            if at is None:
                kept.append(one)
                continue
            joint = joined_segments(self.image, [kept[at].segment, one.segment])
            result = self.register(joint)
            best = kept[at].registration if result.refusal else result
            kept[at] = RegisteredSegment(joint, best, (*kept[at].pieces, *one.pieces))
        return tuple(kept)

    def register(self, segment: Segment) -> Registration:
        """Return what a segment is."""
        return register(
            segment,
            tuple(self.templates.values()),
            self.image,
            robot_depth=self.robot_depth,
            table_height=self.table_height,
            settings=self.settings,
            seed=self.seed,
        )

    def _cut(self, segments: Sequence[Segment]) -> list[RegisteredSegment]:
        """Return every segment, or the parts of a refused one of which more can be explained."""
        found: list[RegisteredSegment] = []
        number = len(segments)
        for index, segment in enumerate(segments):
            one = RegisteredSegment(segment, self.register(segment), (index,))
            parts: list[tuple[Segment, Registration]] = []
            if one.registration.refusal:
                parts = self._best_parts(one)
            if not parts:
                found.append(one)
            for part, result in parts:
                found.append(RegisteredSegment(part, result, (number,)))
                number += 1
        return found

    def _best_parts(self, one: RegisteredSegment) -> list[tuple[Segment, Registration]]:
        """Return the cut of a refused segment that explains most of its points; nothing if none explains any."""
        best: list[tuple[Segment, Registration]] = []
        most = 0
        for parts in (split_at_creases(self.image, one.segment), self._along_template(one)):
            results = [(part, self.register(part)) for part in parts]
            explained = sum(len(part.cloud) for part, result in results if not result.refusal)
            if explained > most:
                best, most = results, explained
        return best

    def _along_template(self, one: RegisteredSegment) -> tuple[Segment, ...]:
        """Return the part of a refused segment that lies on its best template, and the rest; () if one is small."""
        result, points = one.registration, one.segment.cloud.points
        rows, columns = np.nonzero(one.segment.pixels)
        if result.X_WO is None or result.template is None or len(rows) != len(points):
            return ()
        on_it = self._distances(points, result.template, result.X_WO) <= self.settings.search.tolerance
        parts = []
        for chosen in (on_it, ~on_it):
            if chosen.mean() < WORTH_CUTTING:
                return ()
            pixels = np.zeros_like(one.segment.pixels)
            pixels[rows[chosen], columns[chosen]] = True
            parts.append(segment_from_pixels(self.image, pixels))
        return tuple(parts)

    def _joined(self, one: RegisteredSegment, others: Sequence[RegisteredSegment]) -> RegisteredSegment:
        """Return ``one`` together with those of ``others`` that lie on its pose, if they fit together."""
        on_it = [other for other in others if self._lies_on(other.segment.cloud.points, one.registration)]
        if not on_it:
            return one
        every = (one, *on_it)
        joint = joined_segments(self.image, [other.segment for other in every])
        result = self.register(joint)
        if result.refusal or result.score <= one.registration.score - self.settings.margin:
            return one
        return RegisteredSegment(joint, result, tuple(i for other in every for i in other.pieces))

    def _lies_on(self, points: Array, result: Registration) -> bool:
        """Tell whether points (M, 3) in W lie on the registered pose or on one of its alternatives."""
        poses = [] if result.X_WO is None or result.template is None else [(result.template, result.X_WO)]
        poses += [(other.template, other.X_WO) for other in result.alternatives]
        near = 2.0 * self.settings.search.tolerance
        return len(points) > 0 and any(
            np.mean(self._distances(points, name, X_WO) <= near) >= BELONGS for name, X_WO in poses
        )

    def _distances(self, points: Array, name: str, X_WO: Pose) -> Array:
        """Return how far points (M, 3) in W are from a template's surface [m]."""
        return np.asarray(np.abs(self.templates[name].field.lookup(X_WO.inverse().apply(points))[0]))

    def _overlap(self, one: RegisteredSegment, other: RegisteredSegment) -> bool:
        if one.registration.refusal or other.registration.refusal:
            return False
        (middle, half), (other_middle, other_half) = (self._ball(r.registration) for r in (one, other))
        return float(np.linalg.norm(middle - other_middle)) < CLOSEST * (half + other_half)

    def _ball(self, registration: Registration) -> tuple[Array, float]:
        """Return the middle of a placed template's box (3,) in W and half of the box's smallest extent [m]."""
        if registration.template is None or registration.X_WO is None:
            return np.full(3, np.inf), 0.0
        points = self.templates[registration.template].points
        low, high = points.min(axis=0), points.max(axis=0)
        return registration.X_WO.apply(0.5 * (low + high)), 0.5 * float((high - low).min())
