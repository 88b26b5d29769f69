"""Scene observer: keeps what is known of a table up to date, image after image.

Three rules protect the stored grasps. An object that the arm hides is left as it was, to the last bit. What is clearly
seen where it was is left as it was, too. Only what is seen somewhere else, differently, or not at all although nothing
hides its place, changes anything. What was between the jaws when its place was last seen full, and is empty now, is in
the hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from math import acos, degrees, pi
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from optsc.checks import Above, AtMost, Below, Checked, Finite
from optsc.errors import InvalidValue
from optsc.geometry import DepthImage, rotation
from optsc.perception.known_objects import (
    KnownObject,
    ObjectEstimate,
    estimate_object,
    grasps_of,
    unused_name,
)
from optsc.perception.registration import RegistrationSettings
from optsc.perception.scene_registration import Observation, RegisteredSegment, recognise
from optsc.perception.scene_state import SceneEvent, SceneEventKind, SceneState
from optsc.perception.segmentation import SegmentationSettings
from optsc.perception.segments import Segment
from optsc.perception.templates import Template, templates_by_name
from optsc.perception.tracking import TrackingResult, explained_share, track
from optsc.robot import RobotModel
from optsc.sampling.settings import AntipodalSettings

SAME_PLACE = (0.001, 0.001)
"""A camera counts as standing still if it is this close to where it was [m, rad]."""


@dataclass(frozen=True)
class ObserverSettings(Checked):
    """How a scene is observed.

    Attributes:
        segmentation, registration, grasps: of the steps; grasps by default as `AntipodalSettings.for_clouds`.
        table_height: of the table top in W [m].
        unknown: whether shapes that fit no template are grasped as they are seen.
        tilt: an object whose up has turned by more than this has toppled, and gets new grasps [rad].
        explained: a segment of which more than this share shows known objects is one of them [-].
    """

    segmentation: SegmentationSettings = field(default_factory=SegmentationSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    grasps: AntipodalSettings | None = None
    table_height: Annotated[float, Finite] = 0.0
    unknown: bool = True
    tilt: Annotated[float, Above(0.0), Below(pi)] = 0.2
    explained: Annotated[float, Above(0.0), AtMost(1.0)] = 0.5


class SceneObserver:
    """Turns images into a scene state: objects, poses, and libraries of grasps.

    Args:
        robot: the arm, with a gripper; it is left out of the images and hides what is behind it.
        templates: shapes that are known beforehand; may be empty.
        seed: same images and seed, same state.

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
        self.templates: Mapping[str, Template] = templates_by_name(templates)
        self.robot, self.gripper = robot, robot.gripper
        self.settings, self.seed = settings or ObserverSettings(), seed

    def observe(self, state: SceneState, image: DepthImage, q: ArrayLike) -> tuple[SceneState, tuple[SceneEvent, ...]]:
        """Return what is known after one more image, and what has changed.

        Where nothing has changed, the state's library is the very same object.

        Args:
            state: what was known before, ``SceneState()`` at first.
            image: what is measured, by the camera and from the place of the images before.
            q: measured configuration of the arm at that time (n,) [rad].

        Raises:
            InvalidValue: no valid configuration, or an image of another camera or from another place.
        """
        _check_same_view(state, image)
        observation = Observation.of(
            image,
            robot=self.robot,
            q=q,
            table_height=self.settings.table_height,
            settings=self.settings.segmentation,
        )
        return self._with_new(track(state, observation, self.robot.forward(q), self.gripper), observation)

    def _with_new(self, tracked: TrackingResult, observation: Observation) -> tuple[SceneState, tuple[SceneEvent, ...]]:
        """Return the state with what an image shows beyond it, and without what is lost for good."""
        state, events = tracked.state, list(tracked.events)
        lost, unsure, found = set(tracked.lost), set(tracked.unsure), set[str]()
        for registered in recognise(
            observation,
            self._unexplained(state, tracked.lost, observation),
            self.templates,
            self.settings.registration,
            self.seed,
        ):
            if self._explained(registered.segment, state, found, observation):
                continue  # a piece that something parts from the rest: two objects cannot be in one place
            # What is seen to have left its place comes first; what the hand had may have been put down.
            state, event = self._with_object(state, (lost, unsure), registered, observation)
            lost.discard(event.name)
            unsure.discard(event.name)
            found.add(event.name)
            events.append(event)
        for name in sorted(lost):
            state = state.without(name)
            events.append(SceneEvent(SceneEventKind.RETIRED, name, "its place is seen to be empty"))
        return state, tuple(events)

    def _unexplained(self, state: SceneState, lost: AbstractSet[str], observation: Observation) -> list[Segment]:
        """Return the segments that nothing hides and that show nothing that is known to be there."""
        names = state.objects.keys() - lost
        return [
            segment
            for segment in observation.segments
            if observation.shows_clearly(segment) and not self._explained(segment, state, names, observation)
        ]

    def _explained(
        self, segment: Segment, state: SceneState, names: AbstractSet[str], observation: Observation
    ) -> bool:
        """Tell whether a segment shows one of these objects."""
        shares = (
            explained_share(
                segment,
                observation.image,
                state.objects[name],
                self.templates.get(state.objects[name].template or ""),
                moved=name in state.held,
            )
            for name in names
        )
        return any(share > self.settings.explained for share in shares)

    def _with_object(
        self,
        state: SceneState,
        missing: Sequence[AbstractSet[str]],
        registered: RegisteredSegment,
        observation: Observation,
    ) -> tuple[SceneState, SceneEvent]:
        """Return the state with what an unexplained segment shows."""
        segment, registration, _ = registered
        before = _same_kind(state, missing, registration.recognised_as)
        name = unused_name(registration.recognised_as, state.objects) if before is None else before.name
        X_before = None if before is None else before.X_WO
        estimate = estimate_object(name, segment, registration, self.templates, observation, X_before)
        known = estimate.known
        if known.template is None and not self.settings.unknown:
            return state.with_object(known), SceneEvent(SceneEventKind.REFUSED, name, registration.refusal)
        event = _event(before, known, estimate.made_from, self.settings.tilt)
        certain = before is not None and before.certain and known.certain
        if event.kind is SceneEventKind.MOVED and certain and name in state.library:
            return state.with_object(known), event
        return self._with_grasps(state, estimate, observation, event)

    def _with_grasps(
        self, state: SceneState, estimate: ObjectEstimate, observation: Observation, event: SceneEvent
    ) -> tuple[SceneState, SceneEvent]:
        """Return the state with an object and grasps made for it now, or with the object alone."""
        known = estimate.known
        facts: dict[str, object] = {"template": known.template, "explanations": len(known.explanations)}
        if known.template is not None:
            facts["visible_fraction"] = estimate.registration.visible_fraction
        try:
            grasps = grasps_of(
                estimate,
                observation,
                self.gripper,
                facts=facts,
                seed=self.seed,
                settings=self.settings.grasps,
            )
        except InvalidValue as error:
            # It is there all the same, and can be bumped into.
            refused = SceneEvent(SceneEventKind.REFUSED, known.name, str(error))
            return state.without(known.name).with_object(known), refused
        state = replace(state, library=state.library.with_set(grasps)).with_object(known)
        return state, event._replace(words=f"{event.words}; {len(grasps)} grasps")


def _check_same_view(state: SceneState, image: DepthImage) -> None:
    for known in state.objects.values():
        if known.image.camera != image.camera:
            valid = f"that of the images before, {known.image.camera}"
            raise InvalidValue("image.camera", image.camera, valid)
        distance = float(np.linalg.norm(known.image.X_WC.translation - image.X_WC.translation))
        turn = float(rotation.angle(known.image.X_WC.quaternion, image.X_WC.quaternion))
        if distance > SAME_PLACE[0] or turn > SAME_PLACE[1]:
            moved = f"{1e3 * distance:.1f} mm and {turn:.4f} rad away"
            raise InvalidValue("image.X_WC", moved, "the camera's place in the images before")


def _same_kind(state: SceneState, missing: Sequence[AbstractSet[str]], template: str | None) -> KnownObject | None:
    """Return a missing object of this kind, from the first group that has one, the first by name; else None."""
    every = [state.objects[name] for group in missing for name in sorted(group)]
    return next((known for known in every if template is not None and known.template == template), None)


def _event(before: KnownObject | None, known: KnownObject, made_from: str, tilt: float) -> SceneEvent:
    """Return what has happened to an object that was known before, or was not."""
    if before is None:
        return SceneEvent(SceneEventKind.STORED, known.name, made_from)
    z, z_now = (X.rotation_matrix()[:, 2] for X in (before.X_WO, known.X_WO))
    turned = acos(min(1.0, max(-1.0, float(z @ z_now))))
    if turned > tilt:
        words = f"its up turned by {degrees(turned):.0f} degrees"
        return SceneEvent(SceneEventKind.TOPPLED, known.name, words)
    distance = float(np.linalg.norm(known.X_WO.translation - before.X_WO.translation))
    return SceneEvent(SceneEventKind.MOVED, known.name, f"moved by {1e3 * distance:.0f} mm")
