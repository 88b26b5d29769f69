"""The observer: looks at the table again and again, and keeps what is known of it up to date.

Three rules keep the stored grasps worth having. An object that the arm hides is left as it was, to the last bit. What
is clearly seen where it was is left as it was, too. Only what is seen somewhere else, differently, or not at all
although nothing hides its place, changes anything. What was between the jaws when its place was last seen full, and
is empty now, is in the hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from math import acos, degrees
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, Pose, rotation
from optsc.perception.known_objects import ObjectShape, Observation, grasps_of, known_object, shape_of
from optsc.perception.occlusion import robot_depth, robot_mask, view_is_clear
from optsc.perception.registration import Registration, RegistrationSettings, register
from optsc.perception.scene_registration import RegisteredSegment, register_scene, without_overlaps
from optsc.perception.scene_state import KnownObject, SceneEvent, SceneEventKind, SceneState
from optsc.perception.segmentation import SegmentationSettings, segment_image
from optsc.perception.segments import Segment
from optsc.perception.templates import Template
from optsc.perception.tracking import (
    ExpectedVisibility,
    TrackingResult,
    hand,
    presence,
    share_shown,
    with_grips,
)
from optsc.robot import RobotModel
from optsc.sampling.settings import AntipodalSettings

SAME_PLACE = (0.001, 0.001)
"""A camera counts as standing still if it is this close to where it was [m, rad]."""


@dataclass(frozen=True)
class ObserverSettings:
    """How a scene is watched.

    Attributes:
        segmentation, registration, grasps: of the steps; grasps by default as `AntipodalSettings.for_clouds`.
        table_height: of the table top in W [m].
        unknown: whether shapes that fit no template are grasped as they are seen.
        tilt: an object whose up has turned by more than this has toppled, and is grasped anew [rad].
        explained: a segment of which more than this share shows known objects is one of them [-].
    """

    segmentation: SegmentationSettings = field(default_factory=SegmentationSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    grasps: AntipodalSettings | None = None
    table_height: float = 0.0
    unknown: bool = True
    tilt: float = 0.2
    explained: float = 0.5

    def __post_init__(self) -> None:
        if not 0.0 < self.tilt < np.pi:
            raise InvalidValue("tilt", self.tilt, "above 0, below pi rad")
        if not 0.0 < self.explained <= 1.0:
            raise InvalidValue("explained", self.explained, "above 0, up to 1")


class SceneObserver:
    """Turns images into memory: objects, poses, and libraries of grasps.

    Args:
        robot: the arm, with a gripper; it is left out of the images and hides what is behind it.
        templates: shapes that are known beforehand; may be empty.
        settings: how a scene is watched.
        seed: same images and seed, same memory.

    Raises:
        InvalidValue: the robot has no gripper, or two templates have one name.
    """

    def __init__(
        self,
        robot: RobotModel,
        templates: Sequence[Template] = (),
        settings: ObserverSettings | None = None,
        *,
        seed: int = 0,
    ) -> None:
        if robot.gripper is None:
            raise InvalidValue("robot.gripper", None, "a gripper")
        self.templates: Mapping[str, Template] = {template.name: template for template in templates}
        if len(self.templates) < len(templates):
            raise InvalidValue("templates", [template.name for template in templates], "each name once")
        self.robot, self.gripper = robot, robot.gripper
        self.settings, self.seed = settings or ObserverSettings(), seed

    def observe(
        self, memory: SceneState, image: DepthImage, q: ArrayLike
    ) -> tuple[SceneState, tuple[SceneEvent, ...]]:
        """Return what is known after one more look, and what has changed.

        Where nothing has changed, the memory's library is the very same object.

        Args:
            memory: what was known before, ``SceneState()`` at first.
            image: what is measured, by the camera and from the place of the images before.
            q: measured posture of the arm at that time (n,) [rad].

        Raises:
            InvalidValue: a posture that is none, or an image of another camera or from another place.
        """
        _check_same_view(memory, image)
        hiding = robot_depth(self.robot, q, image.camera, image.X_WC)
        look = Observation(image, self._segments(image, q), hiding, self.settings.table_height)
        return self._with_new(self._compared(memory, look, self.robot.forward(q)), look)

    def _compared(self, memory: SceneState, look: Observation, X_WT: Pose) -> TrackingResult:
        """Return what is left of the memory where it is compared with an image, and what the hand has taken."""
        standing = [known for name, known in memory.objects.items() if name not in memory.held]
        found = {known.name: presence(known, look.image, look.robot_depth) for known in standing}
        memory = with_grips(_refreshed(memory, found, look.image.stamp), found, X_WT, self.gripper)
        gone = frozenset(name for name, state in found.items() if state is ExpectedVisibility.GONE)
        return hand(memory, gone, X_WT, look.image)

    def _with_new(
        self, known: TrackingResult, look: Observation
    ) -> tuple[SceneState, tuple[SceneEvent, ...]]:
        """Return the memory with what an image shows beyond it, and without what is lost for good."""
        memory, events = known.memory, list(known.events)
        left, unsure, found = set(known.lost), set(known.unsure), set[str]()
        for recognised in self._recognised(self._unexplained(memory, known.lost, look), look):
            if self._explained(recognised.segment, memory, found, look):
                continue  # a piece that something parts from the rest: two things cannot be in one place
            # What is seen to have left its place comes first; what the hand had may have been put down.
            memory, event = self._take_in(memory, (left, unsure), recognised, look)
            left.discard(event.name)
            unsure.discard(event.name)
            found.add(event.name)
            events.append(event)
        for name in sorted(left):
            memory = memory.without(name)
            events.append(SceneEvent(SceneEventKind.RETIRED, name, "its place is seen to be empty"))
        return memory, tuple(events)

    def _segments(self, image: DepthImage, q: ArrayLike) -> tuple[Segment, ...]:
        return segment_image(
            image,
            table_height=self.settings.table_height,
            robot_mask=robot_mask(self.robot, q, image),
            settings=self.settings.segmentation,
        ).segments

    def _unexplained(self, memory: SceneState, lost: AbstractSet[str], look: Observation) -> list[Segment]:
        """Return the segments that nothing hides and that show nothing that is known to be there."""
        names = memory.objects.keys() - lost
        return [
            segment
            for segment in look.segments
            if view_is_clear(segment.pixels, look.robot_depth, look.image).clear
            and not self._explained(segment, memory, names, look)
        ]

    def _explained(
        self, segment: Segment, memory: SceneState, names: AbstractSet[str], look: Observation
    ) -> bool:
        """Tell whether a segment shows one of these objects."""
        shares = (
            share_shown(
                segment,
                look.image,
                memory.objects[name],
                self.templates.get(memory.objects[name].template or ""),
                moved=name in memory.held,
            )
            for name in names
        )
        return any(share > self.settings.explained for share in shares)

    def _recognised(self, segments: Sequence[Segment], look: Observation) -> tuple[RegisteredSegment, ...]:
        if not self.templates:
            unknown = Registration.refused("no templates are known")
            return tuple(RegisteredSegment(segment, unknown, (i,)) for i, segment in enumerate(segments))
        how = dict[str, Any](
            robot_depth=look.robot_depth,
            table_height=look.table_height,
            settings=self.settings.registration,
            seed=self.seed,
        )
        templates = tuple(self.templates.values())
        found = register_scene(segments, templates, look.image, **how)
        return without_overlaps(
            found, self.templates, look.image, lambda one: register(one, templates, look.image, **how)
        )

    def _take_in(
        self,
        memory: SceneState,
        missing: Sequence[AbstractSet[str]],
        recognised: RegisteredSegment,
        look: Observation,
    ) -> tuple[SceneState, SceneEvent]:
        """Return the memory with what unexplained segments show."""
        segment, registration, _ = recognised
        template = None if registration.refusal else self.templates.get(registration.template or "")
        before = _same_kind(memory, missing, template)
        if template is not None and registration.X_WO is not None:
            like = (
                Pose.identity() if before is None else before.X_WO
            )  # what looks the same either way stands upright
            registration = replace(registration, X_WO=template.nearest_equivalent(registration.X_WO, like))
        shape = shape_of(segment, registration, self.templates, look)
        name = before.name if before is not None else _new_name(memory, template)
        known = known_object(name, shape, template, segment, look.image)
        if template is None and not self.settings.unknown:
            return memory.with_object(known), SceneEvent(SceneEventKind.REFUSED, name, registration.refusal)
        event = _event(before, known, shape.words, self.settings.tilt)
        sure = before is not None and before.certain and known.certain
        if event.kind is SceneEventKind.MOVED and sure and name in memory.library:
            return memory.with_object(known), event
        return self._stored(memory, known, shape, segment, registration, look, event)

    def _stored(
        self,
        memory: SceneState,
        known: KnownObject,
        shape: ObjectShape,
        segment: Segment,
        registration: Registration,
        look: Observation,
        event: SceneEvent,
    ) -> tuple[SceneState, SceneEvent]:
        """Return the memory with an object and grasps made for it now, or with the object alone."""
        facts: dict[str, object] = {"template": known.template, "explanations": len(known.explanations)}
        if known.template is not None:
            facts["visible_fraction"] = registration.visible_fraction
        try:
            grasps = grasps_of(
                known.name,
                shape,
                segment,
                look,
                self.gripper,
                facts=facts,
                seed=self.seed,
                settings=self.settings.grasps,
            )
        except InvalidValue as error:
            # It is there all the same, and can be bumped into.
            refused = SceneEvent(SceneEventKind.REFUSED, known.name, str(error))
            return memory.without(known.name).with_object(known), refused
        memory = replace(memory, library=memory.library.with_set(grasps)).with_object(known)
        return memory, event._replace(words=f"{event.words}; {len(grasps)} grasps")


def _check_same_view(memory: SceneState, image: DepthImage) -> None:
    for known in memory.objects.values():
        if known.image.camera != image.camera:
            raise InvalidValue(
                "image.camera", image.camera, f"that of the looks before, {known.image.camera}"
            )
        distance = float(np.linalg.norm(known.image.X_WC.translation - image.X_WC.translation))
        turn = float(rotation.angle(known.image.X_WC.quaternion, image.X_WC.quaternion))
        if distance > SAME_PLACE[0] or turn > SAME_PLACE[1]:
            moved = f"{1e3 * distance:.1f} mm and {turn:.4f} rad away"
            raise InvalidValue("image.X_WC", moved, "the camera's place in the looks before")


def _refreshed(memory: SceneState, found: Mapping[str, ExpectedVisibility], stamp: float) -> SceneState:
    """Return the memory in which the objects that are still there have been seen now.

    Only the time changes: pose, points and grasps stay those of the look that they were made from.
    """
    objects = {
        name: replace(known, stamp=stamp) if found.get(name) is ExpectedVisibility.THERE else known
        for name, known in memory.objects.items()
    }
    return replace(memory, objects=objects)


def _same_kind(
    memory: SceneState, missing: Sequence[AbstractSet[str]], template: Template | None
) -> KnownObject | None:
    """Return a missing object of this kind, from the first group that has one, the first by name; else None."""
    if template is None:
        return None
    names = [name for group in missing for name in sorted(group)]
    return next(
        (memory.objects[name] for name in names if memory.objects[name].template == template.name), None
    )


def _new_name(memory: SceneState, template: Template | None) -> str:
    name, number = "unknown" if template is None else template.name, 2
    if name not in memory.objects:
        return name
    while f"{name}-{number}" in memory.objects:
        number += 1
    return f"{name}-{number}"


def _event(before: KnownObject | None, known: KnownObject, words: str, tilt: float) -> SceneEvent:
    """Return what has happened to an object that was known before, or was not."""
    if before is None:
        return SceneEvent(SceneEventKind.STORED, known.name, words)
    z, z_now = (X.rotation_matrix()[:, 2] for X in (before.X_WO, known.X_WO))
    turned = acos(min(1.0, max(-1.0, float(z @ z_now))))
    if turned > tilt:
        return SceneEvent(
            SceneEventKind.TOPPLED, known.name, f"its up turned by {degrees(turned):.0f} degrees"
        )
    distance = float(np.linalg.norm(known.X_WO.translation - before.X_WO.translation))
    return SceneEvent(SceneEventKind.MOVED, known.name, f"moved by {1e3 * distance:.0f} mm")
