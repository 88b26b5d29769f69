"""The paper's claim over many scenes: lifts, and paired differences between the two strategies.

    python benchmarks/scenes.py --seeds 20 --output benchmarks/results/scenes.json

Every seed is one run of ``optsc demo``: its own scene and operator, each object once per strategy. Differences are
paired by seed and object, where both strategies reached a grasp of the object that was wanted.

With ``--perception`` the grasps come from a simulated depth camera alone; ``--against`` names the report of a run
without, and the loss in lifts is what the camera costs.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from concurrent.futures import ProcessPoolExecutor
from importlib.metadata import version
from pathlib import Path

import numpy as np

MEASURES = ("path_length_m", "rotation_rad", "duration_s", "sparc", "ldlj")


def one_scene(job):
    """Run one scene and return its summary."""
    from optsc.demo.demonstration import run_demo
    from optsc.demo.summary import save
    from optsc.robot import load_robot

    robot, objects, seed, output, perception = job
    begun = time.process_time()
    demo = run_demo(load_robot(robot), objects=objects, seed=seed, say=lambda text: None, perception=perception)
    return {**save(demo, output / f"seed_{seed}"), "cpu_s": time.process_time() - begun}


def seen(summaries):
    """What perception measured over all scenes: found objects, errors of their poses, time, and what happened."""
    facts = [summary["perception"] for summary in summaries]
    objects = [found for one in facts for found in one["objects"].values()]
    known = [row for found in objects for row in found if row["add_s_m"] is not None]
    errors = np.array([row["add_s_m"] for row in known])
    kinds = [event["news"] for one in facts for event in one["events"]]
    return {
        "objects": len(objects),
        "recognised": sum(any(row["add_s_m"] is not None for row in found) for found in objects),
        "found_twice": sum(len(found) > 1 for found in objects),
        "not_objects": sum(len(one["not_objects"]) for one in facts),
        "ambiguous": sum(row["explanations"] > 1 for row in known),
        "add_s_mm_median_p95_max": (1e3 * np.percentile(errors, [50, 95, 100])).tolist(),
        "within_5_mm": float(np.mean(errors < 0.005)),
        "candidates_least_median": [
            float(f([sum(row["candidates"] for row in found) for found in objects])) for f in (np.min, np.median)
        ],
        "first_look_s": float(np.median([one["first_look_s"] for one in facts])),
        "look_p50_s": float(np.median([one["look_p50_s"] for one in facts])),
        "looks": sum(one["looks"] for one in facts),
        "events": {name: kinds.count(name) for name in sorted(set(kinds))},
    }


def against(report, path):
    """The loss in lifts against another report: of all objects, per strategy."""
    other = json.loads(path.read_text())["lifted_share"]
    return {s: other[s] - share for s, share in report["lifted_share"].items()}


def interval(differences, rng, resamples=10_000):
    """Mean, and the 95 % interval of the mean by the bootstrap over pairs."""
    means = rng.choice(differences, size=(resamples, len(differences))).mean(axis=1)
    return [float(np.mean(differences)), *np.percentile(means, [2.5, 97.5]).tolist()]


def paired(summaries):
    """Differences paper minus manipulability only, per measure: mean and interval, and the number of pairs."""
    rng = np.random.default_rng(0)
    result = {}
    for measure in MEASURES:
        pairs = [
            (row["paper"][measure], row["manipulability"][measure])
            for summary in summaries
            for name, row in summary["objects"].items()
            if row["paper"]["target"] == row["manipulability"]["target"] == name
            and row["paper"][measure] is not None
            and row["manipulability"][measure] is not None
        ]
        if not pairs:  # a few scenes may have none
            result[measure] = {"pairs": 0}
            continue
        a, b = np.array(pairs).T
        result[measure] = {
            "pairs": len(pairs),
            "paper_mean": float(a.mean()),
            "manipulability_mean": float(b.mean()),
            "difference_mean_low_high": interval(a - b, rng),
            "paper_less": float(np.mean(a < b)),
        }
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--objects", nargs="+", default=["mug", "can", "box"])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--runs", type=Path, default=Path("demo-output/scenes"))
    parser.add_argument("--output", type=Path)
    parser.add_argument("--perception", action="store_true", help="grasps from a simulated camera alone")
    parser.add_argument("--against", type=Path, metavar="REPORT", help="of known poses, to name the loss")
    options = parser.parse_args()
    jobs = [
        (options.robot, tuple(options.objects), seed, options.runs, options.perception) for seed in range(options.seeds)
    ]
    summaries = []
    with ProcessPoolExecutor(options.workers) as pool:
        for summary in pool.map(one_scene, jobs):
            summaries.append(summary)
            lifts = {s: [row[s]["lifted"] for row in summary["objects"].values()] for s in ("paper", "manipulability")}
            candidates = {name: row["candidates"] for name, row in summary["objects"].items()}
            print(f"seed {summary['seed']}: lifted {lifts}, grasps {candidates}", flush=True)
    rows = [row for summary in summaries for row in summary["objects"].values()]
    report = {
        "robot": options.robot,
        "seeds": options.seeds,
        "machine": platform.platform(),
        "versions": {name: version(name) for name in ("numpy", "pin", "ruckig", "pybullet")},
        "lifted_share": {s: float(np.mean([row[s]["lifted"] for row in rows])) for s in ("paper", "manipulability")},
        "grasps": len(rows),
        "least_candidates": min(row["candidates"] for row in rows),
        "limit_violations": sum(sum(summary["limit_violations"].values()) for summary in summaries),
        "interventions": sum(summary["interventions"] for summary in summaries),
        "ticks": sum(summary["ticks"] for summary in summaries),
        "tick_p50_us": float(np.median([summary["tick_p50_us"] for summary in summaries])),
        "tick_p99_us": float(np.median([summary["tick_p99_us"] for summary in summaries])),
        "cpu_s_per_seed": float(np.median([summary["cpu_s"] for summary in summaries])),
        "paired": paired(summaries),
    }
    if options.perception:
        report["perception"] = seen(summaries)
    if options.against:
        report["lifted_share_lost"] = against(report, options.against)
    print(json.dumps(report, indent=2))
    if options.output:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        options.output.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
