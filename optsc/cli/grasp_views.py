"""``optsc grasps build --image``: from a recorded depth image to stored grasps of what it shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import DepthImage
from optsc.grasps import GraspSet
from optsc.perception import Registration, Segment, Template, catalogue_template, template_from_file
from optsc.perception.known_objects import ObjectEstimate, estimate_object, grasps_of, unused_name
from optsc.perception.scene_registration import Observation, recognise
from optsc.perception.table import find_table
from optsc.perception.templates import templates_by_name
from optsc.robot import Gripper, load_robot
from optsc.sampling.settings import AntipodalSettings
from optsc.sim import OBJECT_NAMES


class Wanted(NamedTuple):
    """What is asked of a view."""

    templates: Sequence[Template]
    unknown: bool
    """Whether what is not recognised is grasped by the points that were seen of it."""
    gripper: Gripper
    settings: AntipodalSettings
    seed: int


class ObservedObject(NamedTuple):
    """One object in a view."""

    name: str
    words: str
    """What it was taken for, how much of it was seen, and why there are no grasps if there are none."""
    facts: dict[str, Any]
    """The same for machines."""
    grasps: GraspSet | None
    template: Template | None


def templates_of(words: Sequence[str], unit: float) -> tuple[Template, ...]:
    """Return templates by names of the catalogue or mesh files; ``unit`` is that of the files [m].

    Raises:
        UnknownName: neither.
        DamagedFile, InvalidValue: as `template_from_file`.
    """
    found = []
    for word in words:
        if word in OBJECT_NAMES:
            found.append(catalogue_template(word))
        elif Path(word).suffix or Path(word).exists():
            found.append(template_from_file(word, unit=unit))
        else:
            raise UnknownName("template (a name of the catalogue, or a mesh file)", word, OBJECT_NAMES)
    names = [template.name for template in found]
    if len(set(names)) < len(names):
        raise InvalidValue("--templates", names, "each name once; a file is called by its name without ending")
    return tuple(found)


def observation_of(image: DepthImage, robot: str | None, q: Sequence[float] | None, table_height: float) -> Observation:
    """Return what an image shows; the arm in it is left out where its name and configuration are given.

    Raises:
        InvalidValue: a robot without its configuration or the reverse; nothing measured, or nothing on the table.
    """
    if (robot is None) != (q is None):
        raise InvalidValue("--robot and --posture", "one of them alone", "both, or neither")
    model = None if robot is None else load_robot(robot)
    observation = Observation.of(image, robot=model, q=q, table_height=table_height)
    _check_anything(observation)
    return observation


def objects_in(observation: Observation, wanted: Wanted) -> list[ObservedObject]:
    """Return what is seen, with grasps where they were found."""
    templates = templates_by_name(wanted.templates)
    seen: list[ObservedObject] = []
    for one in recognise(observation, observation.segments, templates, seed=wanted.seed):
        name = unused_name(one.registration.recognised_as, [other.name for other in seen])
        estimate = estimate_object(name, one.segment, one.registration, templates, observation)
        seen.append(_seen(one.segment, estimate, observation, wanted))
    return seen


def _check_anything(observation: Observation) -> None:
    image, found = observation.image, observation.segmentation
    if not image.measured.any():
        raise InvalidValue("measured pixels", 0, "at least one: nothing was measured in the whole image")
    if found.segments:
        return
    where = f"above the table, which is expected at {observation.table_height:g} m"
    if not found.table.measured:
        where += f", and no plane is there{_level_plane(image)}"
    left_out = "; ".join(f"{dropped.pixels} pixels: {dropped.reason}" for dropped in found.dropped)
    raise InvalidValue("number of objects", 0, f"at least one {where}{'; left out: ' if left_out else ''}{left_out}")


def _level_plane(image: DepthImage) -> str:
    try:
        height = find_table(image, None).offset
    except InvalidValue:
        return " (--table-height)"
    return f"; the image shows a level plane at {height:.3f} m (--table-height {height:.3f})"


def _seen(segment: Segment, estimate: ObjectEstimate, observation: Observation, wanted: Wanted) -> ObservedObject:
    name, template = estimate.known.name, estimate.template
    words, facts = _words(estimate.registration, segment), _facts(estimate.registration, segment)
    if not observation.shows_clearly(segment):
        words += "; no grasps: the arm is in front of it, or too near"
        return ObservedObject(name, words, facts, None, template)
    if template is None and not wanted.unknown:
        return ObservedObject(name, f"{words}; no grasps: --unknown has them looked for", facts, None, None)
    facts = {**facts, "made_from": estimate.made_from}
    try:
        grasps = grasps_of(
            estimate,
            observation,
            wanted.gripper,
            facts={k: fact for k, fact in {**facts, **_origin(estimate)}.items() if fact is not None},
            seed=wanted.seed,
            settings=wanted.settings,
        )
    except InvalidValue as error:
        return ObservedObject(name, f"{words}; no grasps: {error}", facts, None, template)
    return ObservedObject(name, words, facts, grasps, template)


def _origin(estimate: ObjectEstimate) -> dict[str, Any]:
    """Return what a trial has to know: of which surface the grasps are, and which way is up in O."""
    if estimate.template is None:
        return {}
    up = estimate.known.X_WO.rotation_matrix()[2].tolist()
    return {"surface_hash": estimate.template.mesh.hash, "up": up}


def _words(registration: Registration, segment: Segment) -> str:
    seen = f"{len(segment.cloud)} points"
    if registration.refusal:
        return f"{seen}, not recognised ({registration.refusal})"
    words = (
        f"{seen}, recognised as {registration.template}: {registration.visible_fraction:.0%} of what this camera "
        f"could see of it, residual {1e3 * registration.residual:.1f} mm"
    )
    if registration.ambiguous:
        others = sorted({other.template for other in registration.alternatives})
        words += f"; ambiguous, {len(registration.alternatives)} other poses fit as well ({', '.join(others)})"
    return words


def _facts(registration: Registration, segment: Segment) -> dict[str, Any]:
    facts: dict[str, Any] = {"points": len(segment.cloud), "refusal": registration.refusal or None}
    if registration.refusal or registration.X_WO is None:
        return facts
    X_WO = {
        "quaternion": registration.X_WO.quaternion.tolist(),
        "translation": registration.X_WO.translation.tolist(),
    }
    return {
        **facts,
        "template": registration.template,
        "visible_fraction": registration.visible_fraction,
        "residual": registration.residual,
        "explanations": 1 + len(registration.alternatives),
        "X_WO": X_WO,
    }
