"""What perception made of a scene, against the truth: numbers for a summary."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from optsc.demo.sight import Looks, Sight
from optsc.perception import KnownObject, add_s


def true_names(sight: Sight) -> dict[str, str]:
    """Return the true name of each object that the first look found: of what most of its pixels show."""
    view, names = sight.view, {}
    for name, known in sight.first.objects.items():
        shares = {one: float(view.pixels_of(one)[known.pixels].mean()) for one in sight.world.objects}
        best = max(shares, key=lambda one: shares[one])
        if shares[best] > 0.5:
            names[name] = best
    return names


def seen_facts(sight: Sight, looks: Iterable[Looks]) -> dict[str, Any]:
    """Return what was measured of perception: of each object, of the looks, and what happened; JSON values only.

    ``add_s_m`` is the error of the pose [m], see `optsc.perception.add_s`; None where the shape was not recognised.
    """
    looks = list(looks)
    seconds = [second for one in looks for second in one.seconds]
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in sight.world.objects}
    truth = true_names(sight)
    for name, known in sight.first.objects.items():
        if name in truth:
            found[truth[name]].append(_facts(sight, known, truth[name]))
    return {
        "objects": found,
        "not_objects": sorted(set(sight.first.objects) - truth.keys()),
        "first_look_s": sight.seconds,
        "looks": len(seconds),
        "look_p50_s": float(np.median(seconds)) if seconds else None,
        "look_longest_s": max(seconds, default=None),
        "events": [
            {
                "episode": index,
                "time_s": time,
                "news": event.kind.name,
                "name": event.name,
                "words": event.words,
            }
            for index, one in enumerate(looks)
            for time, event in one.events
        ],
    }


def _facts(sight: Sight, known: KnownObject, truth: str) -> dict[str, Any]:
    library = sight.first.library
    grasps = library.get(known.name)
    error = None
    if known.template == truth:
        points = sight.observer.templates[truth].points
        error = add_s(points, sight.world.X_WO[truth], known.X_WO)
    return {
        "name": known.name,
        "template": known.template,
        "add_s_m": error,
        "explanations": len(known.explanations),
        "visible_fraction": None if grasps is None else grasps.visible_fraction,
        "candidates": 0 if grasps is None else len(grasps),
    }
