"""Two things cannot be in one place: what seems to be there twice was seen in pieces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from optsc.geometry import DepthImage
from optsc.geometry.rotation import Array
from optsc.perception.registration import Registration
from optsc.perception.scene import Recognised
from optsc.perception.segments import Segment, joined_segments
from optsc.perception.templates import Template

CLOSEST = 0.5
"""The middles of two things are at least this share of the sum of their smallest half extents apart [-]."""


def without_overlaps(
    recognised: Sequence[Recognised],
    templates: Mapping[str, Template],
    image: DepthImage,
    register_one: Callable[[Segment], Registration],
) -> tuple[Recognised, ...]:
    """Return what was recognised, with what was placed inside something else joined to it.

    The joint points say what it is; where they fit nothing, the larger piece does.

    Args:
        recognised: the larger pieces first.
        templates: by name.
        image: of the segments.
        register_one: returns what a segment is.
    """
    kept: list[Recognised] = []
    for one in recognised:
        at = next((i for i, other in enumerate(kept) if _overlap(one, other, templates)), None)
        if at is None:
            kept.append(one)
            continue
        joint = joined_segments(image, [kept[at].segment, one.segment])
        result = register_one(joint)
        best = kept[at].registration if result.refusal else result
        kept[at] = Recognised(joint, best, (*kept[at].pieces, *one.pieces))
    return tuple(kept)


def _overlap(one: Recognised, other: Recognised, templates: Mapping[str, Template]) -> bool:
    if one.registration.refusal or other.registration.refusal:
        return False
    (middle, half), (other_middle, other_half) = (_ball(r.registration, templates) for r in (one, other))
    return float(np.linalg.norm(middle - other_middle)) < CLOSEST * (half + other_half)


def _ball(registration: Registration, templates: Mapping[str, Template]) -> tuple[Array, float]:
    """Return the middle of a placed template's box (3,) in W and half of the box's smallest extent [m]."""
    if registration.template is None or registration.X_WO is None:
        return np.full(3, np.inf), 0.0
    points = templates[registration.template].points
    low, high = points.min(axis=0), points.max(axis=0)
    return registration.X_WO.apply(0.5 * (low + high)), 0.5 * float((high - low).min())
