"""Whether objects on cluttered tables are recognised from depth alone, and what happens to those that are not.

    python -m benchmarks.perception --scenes 100 --seed 0 --workers 2 --output results

Each scene has three to five objects, upright and lying, and an arm that hovers above them. They are segmented and
registered from one depth image; the simulator's labels and poses only judge. An object counts if at least 40 % of the
pixels that it would fill alone are left. Then every object is registered again without its own template: whatever is
found is wrong and has to be refused or called ambiguous.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.machine import markdown_table, save
from benchmarks.pose_errors import surface_distance, surface_tail
from optsc.errors import InvalidValue
from optsc.geometry import PointCloud, Pose
from optsc.perception import (
    RegisteredSegment,
    Registration,
    RegistrationSettings,
    SearchSettings,
    Segment,
    add_s,
    catalogue_template,
    catalogue_templates,
    register,
    register_scene,
    robot_depth,
    robot_mask,
    segment_image,
)
from optsc.robot import RobotModel, load_robot
from optsc.sim.camera import CameraView, DepthCamera
from optsc.sim.clutter import ClutteredScene, cluttered_tabletop

VISIBLE, GOOD, EXACT = 0.4, 0.005, 0.006
"""Least visible share of what counts [-]; largest ADD-S of a good pose and `surface_tail` of an exact one [m]."""
LEAST_PIXELS = 60


class SceneView(NamedTuple):
    """A scene, what the camera saw of it, and how much of each object was left to see."""

    scene: ClutteredScene
    view: CameraView
    visible: dict[str, float]


def seen(robot: RobotModel, seed: int, objects: tuple[str, ...] | None = None) -> SceneView:
    """Return a random scene as the camera sees it."""
    scene = cluttered_tabletop(robot, seed, objects=objects)
    with DepthCamera(scene.world) as camera:
        view = camera.capture(scene.q, rng=np.random.default_rng([seed, 1]))
        return SceneView(scene, view, camera.unhidden_shares(view))


def true_segments(view: CameraView) -> tuple[Segment, ...]:
    """Return what a perfect segmentation would give."""
    points, found = view.image.points(), []
    for name in view.names[3:]:
        mask = view.pixels_of(name) & view.image.measured & (points[..., 2] > 0.008)
        if mask.sum() >= LEAST_PIXELS:
            found.append(Segment(PointCloud(points[mask]), mask, False))
    return tuple(sorted(found, key=lambda s: -len(s.cloud)))


def shown(view: CameraView, one: Segment) -> str:
    """Return which object most pixels of a segment show."""
    labels, counts = np.unique(view.labels[one.pixels], return_counts=True)
    return view.names[labels[np.argmax(counts)]]


def errors(name: str, X_WO: Pose | None, result: Registration) -> dict[str, float | None]:
    """Return ADD-S and the mean distance to the surface [m] of a registration of the object ``name``."""
    if result.template != name or X_WO is None or result.X_WO is None:
        return {"add_s": None, "surface": None, "tail": None}
    template = catalogue_template(name)
    return {
        "add_s": add_s(template.points, X_WO, result.X_WO),
        "surface": surface_distance(template, X_WO, result.X_WO),
        "tail": surface_tail(template, X_WO, result.X_WO),
    }


def described(name: str, seed: int, view: SceneView, result: Registration, pixels: int) -> dict[str, Any]:
    """Return one line of the results."""
    return {
        "seed": seed,
        "object": name,
        "lying": name in view.scene.lying,
        "visible": view.visible.get(name, 0.0),
        "template": result.template,
        "ambiguous": result.ambiguous,
        "refusal": result.refusal,
        "score": None if result.template is None else result.score,
        "visible fraction": result.visible_fraction,
        "pixels": pixels,
        **errors(name, view.scene.world.X_WO.get(name), result),
    }


def is_good(row: dict[str, Any] | None) -> bool:
    return row is not None and row["add_s"] is not None and row["add_s"] <= GOOD


def one_scene(
    seed: int,
    robot_name: str,
    segments: str,
    settings: RegistrationSettings,
    names: tuple[str, ...] | None,
) -> dict[str, Any]:
    """Return everything that is known of one scene."""
    robot = load_robot(robot_name)
    view, templates = seen(robot, seed, names), catalogue_templates(names)
    image = view.view.image
    start = time.perf_counter(), time.process_time()
    arm = robot_depth(robot, view.scene.q, image.camera, image.X_WC)
    if segments == "found":
        pieces = segment_image(image, robot_mask=robot_mask(robot, view.scene.q, image)).segments
    else:
        pieces = true_segments(view.view)
    found = register_scene(pieces, templates, image, robot_depth=arm, settings=settings, seed=seed)
    seconds = time.perf_counter() - start[0], time.process_time() - start[1]
    rows = [described(shown(view.view, r.segment), seed, view, r.registration, len(r.segment.cloud)) for r in found]
    largest: dict[str, tuple[int, RegisteredSegment]] = {}
    for row, one in zip(rows, found, strict=True):
        count = int((one.segment.pixels & view.view.pixels_of(row["object"])).sum())
        if row["object"] in view.visible and count > largest.get(row["object"], (0, one))[0]:
            largest[row["object"]] = (count, one)
    objects = []
    for name in view.visible:
        result = largest[name][1].registration if name in largest else Registration.refused("no segment of its own")
        objects.append(described(name, seed, view, result, largest[name][0] if name in largest else 0))
    unknown = []
    for name, (_, one) in largest.items():
        others = [t for t in templates if t.name != name]
        result = register(one.segment, others, image, robot_depth=arm, settings=settings, seed=seed)
        unknown.append(described(name, seed, view, result, len(one.segment.cloud)))
    return {
        "seed": seed,
        "objects": objects,
        "found": rows,
        "unknown": unknown,
        "seconds": seconds[0],
        "processor seconds": seconds[1],
    }


def wilson(good: int, total: int, z: float = 1.96) -> tuple[float, float]:
    """Return the 95 % confidence interval of a share (E. B. Wilson, 1927)."""
    if total == 0:
        return 0.0, 1.0
    p, n = good / total, float(total)
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return float((middle - half) / (1 + z * z / n)), float((middle + half) / (1 + z * z / n))


def share(rows: list[dict[str, Any]], good: list[dict[str, Any]]) -> dict[str, Any]:
    low, high = wilson(len(good), len(rows))
    value = len(good) / len(rows) if rows else None
    return {"good": len(good), "of": len(rows), "share": value, "interval": [low, high]}


def summary(scenes: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures that the bars are about."""
    objects = [row for scene in scenes for row in scene["objects"]]
    counted = [row for row in objects if row["visible"] >= VISIBLE]
    good = [row for row in counted if is_good(row)]
    certain = [row for row in good if not row["ambiguous"] and not row["refusal"]]
    wrong = [row for scene in scenes for row in scene["found"] if not is_good(row)]
    unknown = [row for scene in scenes for row in scene["unknown"]]
    add_s_mm = [1e3 * row["add_s"] for row in good]
    surface_mm = [1e3 * row["surface"] for row in good]
    kinds = {}
    for name in sorted({row["object"] for row in counted}):
        of = [row for row in counted if row["object"] == name]
        kinds[name] = share(of, [row for row in of if is_good(row)])
    return {
        "within 5 mm": share(counted, good),
        "within 5 mm, neither refused nor ambiguous": share(counted, certain),
        "accepted with every part within 6 mm": share(certain, [r for r in certain if r["tail"] <= EXACT]),
        "ambiguous, best pose within 5 mm": sum(row["ambiguous"] for row in good),
        "upright within 5 mm": share(*_split(counted, False)),
        "lying within 5 mm": share(*_split(counted, True)),
        "by object": kinds,
        "wrong, refused or ambiguous": share(wrong, _held_back(wrong)),
        "own template withheld, refused or ambiguous": share(unknown, _held_back(unknown)),
        "add_s mm, median and 95th": np.percentile(add_s_mm, [50, 95]).tolist() if good else None,
        "surface mm, median and 95th": np.percentile(surface_mm, [50, 95]).tolist() if good else None,
        "seconds per scene, median and largest": _extent([scene["seconds"] for scene in scenes]),
        "processor seconds per scene, median and largest": _extent([s["processor seconds"] for s in scenes]),
        "failures": [row for row in counted if not is_good(row)],
        "wrong and accepted": [row for row in wrong if not row["ambiguous"] and not row["refusal"]],
    }


def _extent(values: list[float]) -> list[float]:
    return [float(np.median(values)), float(np.max(values))]


def _split(rows: list[dict[str, Any]], lying: bool) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    of = [row for row in rows if row["lying"] == lying]
    return of, [row for row in of if is_good(row)]


def _held_back(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [row for row in rows if row["ambiguous"] or row["refusal"]]


def table(facts: dict[str, Any]) -> str:
    """Return the figures as markdown, with every failure."""

    def line(name: str, s: dict[str, Any]) -> list[str]:
        if not s["of"]:
            return [name, "none", "", ""]
        low, high = s["interval"]
        return [
            name,
            f"{s['good']} of {s['of']}",
            f"{100 * s['share']:.1f} %",
            f"{100 * low:.1f} to {100 * high:.1f} %",
        ]

    rows = [line(name, s) for name, s in facts.items() if isinstance(s, dict) and "of" in s]
    rows += [line(f"{name} within 5 mm", s) for name, s in facts["by object"].items()]
    text = markdown_table(["what", "how many", "share", "95 % interval"], rows)
    figures = []
    for name in ("add_s mm", "surface mm"):
        if facts[f"{name}, median and 95th"]:
            middle, high = facts[f"{name}, median and 95th"]
            figures.append([f"{name}: median, 95th percentile", f"{middle:.2f}, {high:.2f}"])
    for name in ("seconds per scene", "processor seconds per scene"):
        middle, high = facts[f"{name}, median and largest"]
        figures.append([f"{name}: median, largest", f"{middle:.2f}, {high:.2f}"])
    text += "\n\n" + markdown_table(["what", "value"], figures)
    for title in ("failures", "wrong and accepted"):
        lines = [_failure(row) for row in facts[title]]
        text += f"\n\n{title.capitalize()}:\n\n" + ("\n".join(lines) if lines else "none")
    return text


def compact(scenes: list[dict[str, Any]]) -> dict[str, Any]:
    """Return one short line per object and question, so that the file can be kept."""
    columns = [
        "seed",
        "object",
        "visible",
        "lying",
        "template",
        "ambiguous",
        "refusal",
        "add_s",
        "surface",
        "tail",
    ]
    lines = {
        question: [
            [round(row[c], 5) if isinstance(row[c], float) else row[c] for c in columns]
            for scene in scenes
            for row in scene[question]
        ]
        for question in ("objects", "unknown")
    }
    return {"columns": columns, **lines}


def _failure(row: dict[str, Any]) -> str:
    error = "" if row["add_s"] is None else f", {1e3 * row['add_s']:.1f} mm off"
    what = row["refusal"] or ("ambiguous" if row["ambiguous"] else "accepted")
    seen_as = row["template"] or "nothing"
    return f"- scene {row['seed']}, {row['object']}, {100 * row['visible']:.0f} % visible: {seen_as}{error}: {what}"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the first scene")
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--objects", nargs="+", help="these in every scene, and no other templates; all by default")
    parser.add_argument("--segments", choices=("found", "true"), default="found", help="true: as the labels have them")
    parser.add_argument("--method", default=SearchSettings().method, help="of the refinement: gicp, plane or field")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--output", type=Path)
    given = parser.parse_args(arguments)
    if given.scenes < 1 or given.workers < 1:
        raise InvalidValue("scenes and workers", (given.scenes, given.workers), "at least 1")
    settings = RegistrationSettings(search=SearchSettings(method=given.method))
    names = tuple(given.objects) if given.objects else None
    work = partial(one_scene, robot_name=given.robot, segments=given.segments, settings=settings, names=names)
    seeds = range(given.seed, given.seed + given.scenes)
    scenes = []
    with ProcessPoolExecutor(given.workers) as pool:
        for scene in pool.map(work, seeds):
            scenes.append(scene)
            print(f"\r{len(scenes)} of {given.scenes} scenes", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    facts = summary(scenes)
    command = "python -m benchmarks.perception " + " ".join(sys.argv[1:] if arguments is None else arguments)
    title = f"{given.scenes} scenes from seed {given.seed}, {given.robot}, segments: {given.segments}, {given.method}"
    save(
        given.output,
        "perception",
        {**facts, "objects": compact(scenes)},
        f"{title}\n\n{table(facts)}",
        command,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
