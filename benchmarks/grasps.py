"""How many grasps lift: after each filter, from exact surfaces and from single views, of known and unknown objects.

    python -m benchmarks.grasps filters --workers 2 --output benchmarks/results
    python -m benchmarks.grasps unknown --objects 50 --workers 2 --output benchmarks/results
    python -m benchmarks.grasps time --workers 2 --output benchmarks/results

Every trial is one of `optsc.sim.validation`: a floating hand approaches, closes, lifts and shakes. The camera is
the one of `optsc.sim.camera` with its noise; the object stands alone on the table; no truth about it is used.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from benchmarks.grasp_scenes import View, procedural_object, single_view
from benchmarks.machine import markdown_table, save
from optsc.geometry import Pose
from optsc.grasps import GraspSet
from optsc.perception.completion import complete_cloud
from optsc.perception.registration import register
from optsc.perception.templates import template_from_mesh
from optsc.robot import PANDA_HAND, RobotModel, load_robot
from optsc.sampling.antipodal import sample_grasps
from optsc.sampling.checks import Tally
from optsc.sampling.detection import detect_grasps
from optsc.sim import OBJECT_NAMES, ObjectModel, object_model
from optsc.sim.grasp_trial import TrialSettings
from optsc.sim.validation import try_grasps

STAGES = (  # the last check of each row of the table
    ("antipodal", "antipodal"),
    ("+ from above, clear of the table", "clear of the table"),
    ("+ swept approach, every 8th point", "no obvious collision"),
    ("+ opening, both contacts met first", "fits between the jaws"),
    ("+ pads loaded, flat, near the middle", "load near the pads' middle"),
    ("+ swept approach and closing, all points", "closing is free"),
    ("+ robust to errors of the pose", "robust to errors of the pose"),
    ("+ resists every wrench", "resists every wrench"),
    ("150 spread out", "kept"),
)
SOURCES = ("mesh", "completed cloud", "raw cloud")


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (E. B. Wilson, 1927)."""
    if trials == 0:
        return 0.0, 1.0
    z, p = 1.96, successes / trials
    middle = (p + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials)) / (1 + z * z / trials)
    return max(0.0, middle - half), min(1.0, middle + half)


def share(successes: int, trials: int) -> str:
    """Return a share with its interval, for a table."""
    if trials == 0:
        return "none"
    low, high = wilson(successes, trials)
    return f"{successes / trials:.2f} ({low:.2f}-{high:.2f}, n={trials})"


class Stopwatch:
    """Elapsed and processor time since it was made [s]."""

    def __init__(self) -> None:
        self._start, self._cpu = perf_counter(), process_time()

    @property
    def read(self) -> tuple[float, float]:
        """Elapsed time, processor time."""
        return perf_counter() - self._start, process_time() - self._cpu


def sources(
    model: ObjectModel, view: View | None, seed: int
) -> Iterator[tuple[str, GraspSet, Tally, Pose, tuple[float, float]]]:
    """Yield for each source: its name, the grasps, what was left after each check, X_OU, elapsed and processor s."""
    name, tally, watch = model.name, Tally(keep=True), Stopwatch()
    grasps = sample_grasps(model.mesh, PANDA_HAND, name=name, seed=seed, tally=tally)
    yield "mesh", grasps, tally, Pose.identity(), watch.read
    if view is None:
        return
    template = template_from_mesh(name, model.mesh, keep=True)
    found = register(view.segment, [template], view.image, seed=seed)
    if found.X_WO is not None:
        tally, watch = Tally(keep=True), Stopwatch()
        cloud = complete_cloud(view.segment.cloud, template, found.X_WO)
        # A box is the same upside down: the pose that was found says where up is, and the table.
        up, height = found.X_WO.inverse().rotation_matrix()[:, 2], -float(found.X_WO.translation[2])
        grasps = detect_grasps(cloud, PANDA_HAND, name=name, seed=seed, support=height, up=up, tally=tally)
        yield "completed cloud", grasps, tally, view.X_WO.inverse() @ found.X_WO, watch.read
    cloud, eye, X_WU = view.raw()
    tally, watch = Tally(keep=True), Stopwatch()
    grasps = detect_grasps(cloud, PANDA_HAND, name=name, seed=seed, support=0.0, viewpoint=eye, tally=tally)
    yield "raw cloud", grasps, tally, view.X_WO.inverse() @ X_WU, watch.read


def at_poses(grasps: GraspSet, X_OG: Pose) -> GraspSet:
    """Return a set with other poses; a trial needs nothing else of it."""
    number = len(X_OG)
    return replace(grasps, X_OG=X_OG, opening=np.zeros(number), quality=np.zeros(number))


def filters(options: argparse.Namespace, robot: RobotModel) -> tuple[dict[str, Any], str]:
    """Try poses that are left after each check; return the numbers and the table."""
    settings, rng = TrialSettings(), np.random.default_rng(options.seed)
    counts: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    left: dict[tuple[str, str], int] = Counter()
    numbers: dict[str, list[int]] = defaultdict(list)
    for name in OBJECT_NAMES:
        model = object_model(name)
        for source, grasps, tally, X_OU, _ in sources(model, single_view(robot, model, options.seed), options.seed):
            numbers[source].append(len(grasps))
            samples = []
            for label, check in STAGES:
                poses = Pose.concatenate([Pose.identity((0,)), *(tally.poses or {}).get(check, [])])
                left[source, label] += len(poses)
                samples.append(poses[rng.permutation(len(poses))[: options.per_filter]])
            together = at_poses(grasps, Pose.concatenate(samples)).moved(X_OU)
            reasons = try_grasps(model, together, settings, workers=options.workers).reasons(settings)
            ends = np.cumsum([len(sample) for sample in samples]).tolist()
            for (label, _), start, end in zip(STAGES, [0, *ends], ends, strict=False):
                counts[source, label].update(reasons[start:end])
                print(f"{name}, {source}, {label}: {dict(Counter(reasons[start:end]))}", flush=True)
    rows = []
    for label, _ in STAGES:
        row = [label]
        for source in SOURCES:
            count = counts[source, label]
            row += [share(count["held"], count.total()), str(count["bumped"]), str(left[source, label])]
        rows.append(row)
    header = ["poses left after"] + [word for s in SOURCES for word in (f"{s}: held", "bumped", "poses")]
    facts = {
        "stages": {f"{source} | {label}": dict(c) for (source, label), c in counts.items()},
        "poses_left": {f"{source} | {label}": n for (source, label), n in left.items()},
        "grasps_per_object": {source: dict(zip(OBJECT_NAMES, n, strict=False)) for source, n in numbers.items()},
    }
    return facts, markdown_table(header, rows)


def unknown(options: argparse.Namespace, robot: RobotModel) -> tuple[dict[str, Any], str]:
    """Grasp procedural objects from one raw view each; return the numbers and the table."""
    settings, rng = TrialSettings(), np.random.default_rng(options.seed)
    objects: list[dict[str, Any]] = []
    totals: Counter[str] = Counter()
    for number in rng.permutation(1000).tolist():
        model = procedural_object(number, np.random.default_rng([options.seed, number]))
        if model is None:
            continue
        if len(objects) == options.objects:
            break
        view = single_view(robot, model, options.seed + number)
        facts: dict[str, Any] = {
            "name": model.name,
            "extents_mm": (1e3 * model.mesh.extents).round().tolist(),
        }
        objects.append(facts)
        if view is None:
            facts["grasps"], facts["why"] = 0, "not found in the image"
            continue
        cloud, eye, X_WU = view.raw()
        start = perf_counter()
        grasps = detect_grasps(cloud, PANDA_HAND, name=model.name, seed=options.seed, support=0.0, viewpoint=eye)
        facts["seconds"], facts["grasps"] = round(perf_counter() - start, 2), len(grasps)
        if len(grasps) == 0:
            facts["why"] = grasps.provenance["reason"]
            continue
        best = np.argsort(-grasps.quality, kind="stable")[:1]
        others = rng.permutation(np.setdiff1d(np.arange(len(grasps)), best))[: options.per_object - 1]
        tried = grasps.select(np.concatenate([best, others])).moved(view.X_WO.inverse() @ X_WU)
        outcome = try_grasps(model, tried, settings, workers=options.workers)
        totals.update(outcome.reasons(settings))
        facts["held"], facts["tried"] = int(outcome.lifted.sum()), len(tried)
        facts["best_held"] = bool(outcome.lifted[0])
        print(f"{model.name}: {len(grasps)} grasps, {facts['held']} of {len(tried)} held", flush=True)
    return {"objects": objects, "reasons": dict(totals)}, _unknown_table(objects, totals)


def _unknown_table(objects: list[dict[str, Any]], totals: Counter[str]) -> str:
    count, some = len(objects), [o for o in objects if o["grasps"]]
    rows = [
        ["objects for which any grasp was found", share(len(some), count)],
        ["objects with 150 grasps", share(sum(o["grasps"] >= 150 for o in objects), count)],
        ["best grasp holds, of all objects", share(sum(o.get("best_held", False) for o in objects), count)],
        ["best grasp holds, of objects with grasps", share(sum(o["best_held"] for o in some), len(some))],
        ["grasps that hold, of those tried", share(totals["held"], totals.total())],
        ["bumped / lost / slipped", " / ".join(str(totals[r]) for r in ("bumped", "lost", "slipped"))],
        ["seconds for detection, median / most", _seconds([o["seconds"] for o in objects if "seconds" in o])],
    ]
    return markdown_table([f"{count} unknown objects, one raw view each", ""], rows)


def _seconds(values: list[float]) -> str:
    return f"{np.median(values):.2f} / {max(values):.2f}" if values else "none"


def timing(options: argparse.Namespace, robot: RobotModel) -> tuple[dict[str, Any], str]:
    """Time building 150 grasps and trying them; return the numbers and the table."""
    rows, facts = [], {}
    for name in options.names:
        model = object_model(name)
        row = {}
        for source, grasps, _, X_OU, (seconds, cpu) in sources(
            model, single_view(robot, model, options.seed), options.seed
        ):
            row[source] = {"grasps": len(grasps), "seconds": seconds, "cpu_s": cpu}
            if not options.untried:
                start = perf_counter()
                outcome = try_grasps(model, grasps.moved(X_OU), workers=options.workers)
                row[source] |= {"held": int(outcome.lifted.sum()), "trial_seconds": perf_counter() - start}
            print(f"{name}, {source}: {row[source]}", flush=True)
        facts[name] = row
        rows.append([name, *(_built(row[source]) if source in row else "-" for source in SOURCES)])
    header = ["object", *(f"{source}: grasps" for source in SOURCES)]
    return {"workers": options.workers, "objects": facts}, markdown_table(header, rows)


def _built(row: dict[str, Any]) -> str:
    words = f"{row['grasps']} in {row['seconds']:.2f} s (processor {row['cpu_s']:.2f} s)"
    return words if "held" not in row else f"{words}; {row['held']} hold; tried in {row['trial_seconds']:.1f} s"


PARTS = {"filters": filters, "unknown": unknown, "time": timing}


def main() -> None:
    """Run one part of the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--per-filter", type=int, default=25, help="poses tried per object, source and filter")
    parser.add_argument("--objects", type=int, default=50, help="how many unknown objects, at most 1000")
    parser.add_argument("--per-object", type=int, default=10, help="grasps tried per unknown object")
    parser.add_argument("--names", nargs="+", default=OBJECT_NAMES, choices=OBJECT_NAMES, help="to be timed")
    parser.add_argument("--untried", action="store_true", help="time building alone")
    parser.add_argument("--robot", default="panda", help="the arm that stands in the image")
    parser.add_argument("--output", type=Path, help="where numbers and table go")
    options = parser.parse_args()
    start = perf_counter()
    facts, text = PARTS[options.part](options, load_robot(options.robot))
    facts |= {"seed": options.seed, "seconds": perf_counter() - start}
    command = f"python -m benchmarks.grasps {options.part} --seed {options.seed} --workers {options.workers}"
    command += {
        "filters": f" --per-filter {options.per_filter}",
        "unknown": f" --objects {options.objects}",
        "time": f" --names {' '.join(options.names)}" + " --untried" * options.untried,
    }.get(options.part, "")
    save(options.output, f"grasps_{options.part}", facts, text, command)


if __name__ == "__main__":
    main()
