"""How long the reach table and the ranking take, beside TRAC-IK and Pink, and how both grow.

1. The reach table of three objects with 150 grasps each, with the jaws' twins and without: inverse kinematics of
   pre-grasps and grasps, penalised manipulability and the collision check; beside a loop of TRAC-IK over the same
   poses, which does the inverse kinematics alone.
2. Ranking them against a moving hand, by the paper's cascade and by all costs there are; beside Pink's `solve_ik` on
   the same arm, in turns, tick by tick.
3. Both for 10 to 10 000 candidates, as a plot.
"""

from __future__ import annotations

import argparse
import inspect
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.ik_success import TracIk
from benchmarks.machine import machine, markdown_table, save
from benchmarks.peers import PinkPeer
from optsc import selection
from optsc.cache import cache_directory
from optsc.collision import CollisionModel, GraspClearance
from optsc.geometry import Pose
from optsc.grasps import Candidates
from optsc.ik.batch import solve_ik
from optsc.robot import ROBOT_NAMES, RobotModel, load_robot
from optsc.robot.manipulability import Manipulability
from optsc.sampling import build_library
from optsc.selection import Cascade, GraspCost, GraspSelector, ReachSolver, ReachTable, WeightedSum
from optsc.sim import tabletop

SIZES = (10, 30, 100, 300, 1000, 3000, 10000)
RATE = 500.0
"""Ticks of the moving hand [Hz]."""
JITTER, TURN = 0.02, 0.2
"""Further candidates are those there are, moved by so much [m and rad, standard deviations]."""
LEAST_RANKINGS = 20
LIBRARY_SEED = 0
"""As in the demonstration, so that grasps in the cache are shared."""

Clear = Callable[..., np.ndarray]


def all_costs() -> tuple[list[GraspCost], list[str]]:
    """Return every cost that `optsc.selection` exports and that needs no argument, and the names of the others."""
    costs, others = [], []
    for name in selection.__all__:
        kind = getattr(selection, name)
        if not (inspect.isclass(kind) and issubclass(kind, GraspCost)) or inspect.isabstract(kind):
            continue
        parameters = inspect.signature(kind).parameters.values()
        if any(p.default is inspect.Parameter.empty for p in parameters):
            others.append(name)
        else:
            costs.append(kind())
    return costs, others


def scene(robot: RobotModel, objects: list[str], seed: int, library: Path | None) -> tuple[Candidates, Clear]:
    """Return the candidates of the demonstration's scene, and its collision check."""
    world = tabletop(robot, objects=tuple(objects), seed=seed)
    if robot.gripper is None:
        raise SystemExit(f"{robot.name} has no gripper")
    meshes = {name: model.mesh for name, model in world.objects.items()}
    directory = library or cache_directory("grasps")
    placed = build_library(meshes, robot.gripper, seed=LIBRARY_SEED, directory=directory).place(world.X_WO)
    obstacles = {name: (model.parts, world.X_WO[name]) for name, model in world.objects.items()}
    return placed, GraspClearance(CollisionModel(robot).scene(obstacles))


def resized(candidates: Candidates, count: int, rng: np.random.Generator) -> Candidates:
    """Return ``count`` candidates: some of those there are, or all and more that are moved a little."""
    index = np.sort(np.arange(count) % len(candidates))
    moved = rng.normal(size=(2, count, 3)) * (count > len(candidates))
    X_WG = candidates.X_WG[index] @ Pose.from_rotation_vector(TURN * moved[1], JITTER * moved[0])
    if count < len(candidates):
        index = np.sort(rng.choice(len(candidates), count, replace=False))
        X_WG = candidates.X_WG[index]
    return replace(
        candidates,
        object_index=candidates.object_index[index],
        grasp_index=np.arange(count),
        X_WG=X_WG,
        opening=candidates.opening[index],
        quality=candidates.quality[index],
    )


def table_of(robot: RobotModel, candidates: Candidates, clear: Clear | None, restarts: int) -> ReachTable:
    """Return the reach table as seen from home, with ``restarts`` of the inverse kinematics."""

    def solve(X_WT: Pose, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return solve_ik(robot, X_WT, seeds=seeds, restarts=restarts)[:2]

    return ReachSolver(robot, solve, Manipulability()).table(candidates, robot.home, clear=clear)


def solved_rows(table: ReachTable) -> int:
    """Return how many rows have a configuration at the pre-grasp and at the grasp, whatever they touch."""
    lacking = table.rejected("unreachable") | table.rejected("pre-grasp unreachable")
    return int(np.count_nonzero(~lacking))


def trac_ik_loop(peer: TracIk, robot: RobotModel, table: ReachTable) -> tuple[float, int]:
    """Return TRAC-IK's seconds for the table's poses, each from the configuration before, and how many it solves."""
    seconds, rows = 0.0, 0
    before = Pose(table.X_WP.quaternion.reshape(-1, 4), table.X_WP.translation.reshape(-1, 3))
    there = Pose(table.X_WG.quaternion.reshape(-1, 4), table.X_WG.translation.reshape(-1, 3))
    for X_WP, X_WG in zip(before, there, strict=True):
        q, found, time = peer.solve(X_WP, robot.home)
        seconds += time
        if found:
            _, found, time = peer.solve(X_WG, q)
            seconds += time
            rows += bool(found)
    return seconds, rows


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return the seconds of a call, and its result."""
    start = perf_counter()
    result = call()
    return perf_counter() - start, result


def reach_part(robot: RobotModel, candidates: Candidates, clear: Clear, rounds: int) -> tuple[list[dict], list[str]]:
    """Return the times of the table, with twins and without, and what was left out."""
    results, missing = [], []
    peer = None
    try:
        peer = TracIk(robot, robot.home)
    except ImportError as error:
        missing.append(f"TRAC-IK was left out: {error}")
    for twins in (False, True):
        chosen = replace(candidates, jaw_symmetric=twins)
        cases = {
            "with 32 restarts": partial(table_of, robot, chosen, clear, 32),
            "from the present configuration only": partial(table_of, robot, chosen, clear, 0),
            "with 32 restarts, without collisions": partial(table_of, robot, chosen, None, 32),
        }
        times: dict[str, list[float]] = {name: [] for name in (*cases, "TRAC-IK")}
        solved: dict[str, int] = {}
        table = {name: call() for name, call in cases.items()}["with 32 restarts"]  # also warms up
        for _ in range(rounds):
            for name, call in cases.items():
                seconds, found = timed(call)
                times[name].append(seconds)
                solved[name] = solved_rows(found)
            if peer is not None:
                seconds, solved["TRAC-IK"] = trac_ik_loop(peer, robot, table)
                times["TRAC-IK"].append(seconds)
        results.append(
            {
                "twins": twins,
                "rows": table.rows,
                "usable": int(np.count_nonzero(table.admissible)),
                "solved": solved,
                "seconds": {name: values for name, values in times.items() if values},
            }
        )
    return results, missing


def hand_path(robot: RobotModel, count: int) -> tuple[list[Pose], np.ndarray]:
    """Return poses of the tool that a hand moves about home, and the configurations (count, n) that follow."""
    t = np.arange(count) / RATE
    shift = 0.08 * np.stack([np.sin(1.1 * t), np.sin(1.7 * t), np.sin(0.7 * t)], axis=1)
    turn = 0.3 * np.stack([np.sin(0.9 * t), np.sin(1.3 * t), np.sin(0.6 * t)], axis=1)
    start = robot.forward(robot.home)
    poses = list(start @ Pose.from_rotation_vector(turn, shift))
    q, configurations = robot.home, []
    for X_WT in poses:
        found = solve_ik(robot, X_WT, seeds=q, restarts=0)
        q = found.q if found.success else q
        configurations.append(q)
    return poses, np.array(configurations)


def selectors(robot: RobotModel) -> dict[str, GraspSelector]:
    """Return the selectors that are timed, by name."""
    costs, _ = all_costs()
    rules = {
        "paper's cascade": Cascade.paper(),
        "all costs": WeightedSum(tuple((cost, 1.0) for cost in costs)),
    }
    return {name: GraspSelector(robot, rule) for name, rule in rules.items()}


def rank_times(
    ranked: dict[str, GraspSelector], path: tuple[list[Pose], np.ndarray], count: int, pink: PinkPeer | None
) -> dict[str, list[float]]:
    """Return the seconds of each ranking, and of Pink's `solve_ik`, in turns along the path."""
    times: dict[str, list[float]] = {name: [] for name in ranked}
    if pink is not None:
        times["Pink"] = []
    for i in range(count):
        X_WT, q = path[0][i % len(path[0])], path[1][i % len(path[0])]
        for name, selector in ranked.items():
            times[name].append(timed(partial(selector.rank, X_WT, q))[0])
        if pink is not None:
            times["Pink"].append(pink.tick(X_WT).solve)
    warm = min(100, count // 4)
    return {name: values[warm:] for name, values in times.items()}


def growth_part(
    robot: RobotModel,
    candidates: Candidates,
    clear: Clear,
    largest: int,
    path: tuple[list[Pose], np.ndarray],
    seed: int,
) -> list[dict[str, Any]]:
    """Return the times of table and ranking for growing numbers of candidates."""
    rows = []
    for count in (size for size in SIZES if size <= largest):
        some = resized(candidates, count, np.random.default_rng(seed))
        repeats = max(1, min(5, 2000 // count))
        facts: dict[str, Any] = {"candidates": count}
        for name, check in (("table", clear), ("table without collisions", None)):
            call = partial(table_of, robot, some, check, 32)
            facts[f"{name} [ms]"] = 1e3 * float(np.median([timed(call)[0] for _ in range(repeats)]))
        ranked = selectors(robot)
        for selector in ranked.values():
            selector.observe(some, robot.home, clear=clear)
        for name, values in rank_times(ranked, path, max(LEAST_RANKINGS, 20000 // count), None).items():
            facts[f"{name} [µs]"] = 1e6 * float(np.median(values))
        rows.append(facts)
        print(f"{count} candidates", flush=True)
    return rows


def plot(growth: list[dict[str, Any]], pink: float | None, loop: float | None, path: Path) -> None:
    """Draw table and ranking over the number of candidates; ``pink`` [µs], ``loop`` [ms] for each candidate."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), constrained_layout=True)
    n = [row["candidates"] for row in growth]
    for name, label in (("table", "with collision check"), ("table without collisions", "without")):
        left.loglog(n, [row[f"{name} [ms]"] for row in growth], "o-", label=label)
    if loop is not None:
        left.loglog(n, [loop * count for count in n], "k--", label="TRAC-IK, inverse kinematics alone")
    for name in ("paper's cascade", "all costs"):
        right.loglog(n, [row[f"{name} [µs]"] for row in growth], "o-", label=name)
    if pink is not None:
        right.axhline(pink, color="k", linestyle="--", label="Pink's solve_ik")
    left.set(xlabel="candidates", ylabel="reach table, with twins [ms]")
    right.set(xlabel="candidates", ylabel="ranking, median [µs]")
    for axes in (left, right):
        axes.grid(which="both", alpha=0.25)
        axes.legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def reach_table_text(results: list[dict[str, Any]]) -> str:
    rows = []
    for result in results:
        base = np.median(result["seconds"]["TRAC-IK"]) if "TRAC-IK" in result["seconds"] else None
        for name, seconds in result["seconds"].items():
            ratio = "" if base is None else f"{np.median(seconds) / base:.3f}"
            label = name if name == "TRAC-IK" else f"optsc, {name}"
            counts = [str(result["rows"]), str(result["solved"][name])]
            rows.append(["on" if result["twins"] else "off", label, *counts, f"{1e3 * np.median(seconds):.1f}", ratio])
    return markdown_table(["twins", "", "rows", "with configurations", "median [ms]", "of TRAC-IK's"], rows)


def rank_text(times: dict[str, list[float]]) -> str:
    pink = np.median(times["Pink"]) if "Pink" in times else None
    rows = []
    for name, seconds in times.items():
        quantiles = [f"{1e6 * x:.0f}" for x in np.percentile(seconds, [50, 95, 99])]
        rows.append([name, *quantiles, "" if pink is None else f"{np.median(seconds) / pink:.2f}"])
    return markdown_table(["ranking", "p50 [µs]", "p95 [µs]", "p99 [µs]", "median / Pink's"], rows)


def growth_text(growth: list[dict[str, Any]]) -> str:
    head = list(growth[0])
    return markdown_table(head, [[str(row[head[0]]), *(f"{row[name]:.1f}" for name in head[1:])] for row in growth])


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="Times of the reach table and of the ranking.",
        epilog="example: python -m benchmarks.ranking --robot panda --seed 3 --output results",
    )
    parser.add_argument("--robot", default="panda", choices=ROBOT_NAMES)
    parser.add_argument("--objects", nargs="+", default=["mug", "can", "box"])
    parser.add_argument("--seed", type=int, default=3, help="of the scene")
    parser.add_argument("--rounds", type=int, default=9, help="repetitions of the reach table")
    parser.add_argument("--ticks", type=int, default=3000, help="ticks of the moving hand")
    parser.add_argument("--largest", type=int, default=10000, help="greatest number of candidates")
    parser.add_argument("--library", type=Path, help="folder of grasps, by default the user's cache")
    parser.add_argument("--output", type=Path, help="folder for the tables, their numbers and the plot")
    options = parser.parse_args()
    for name, least in (("rounds", 1), ("ticks", 8), ("largest", 10)):
        if getattr(options, name) < least:
            parser.error(f"--{name}: at least {least}")
    return options


def main() -> None:
    options = parsed()
    robot = load_robot(options.robot)
    candidates, clear = scene(robot, options.objects, options.seed, options.library)
    results, missing = reach_part(robot, candidates, clear, options.rounds)
    path = hand_path(robot, options.ticks)
    ranked = selectors(robot)
    for selector in ranked.values():
        selector.observe(candidates, robot.home, clear=clear)
    pink = None
    try:
        pink = PinkPeer(robot, RATE)
    except ImportError as error:
        missing.append(f"Pink was left out: {error}")
    times = rank_times(ranked, path, options.ticks, pink)
    growth = growth_part(robot, candidates, clear, options.largest, path, options.seed)
    costs, others = all_costs()
    names = ", ".join(cost.name for cost in costs)
    notes = [f"{robot.name}, {len(candidates)} candidates of {', '.join(options.objects)}. All costs: {names}."]
    notes += [f"Not among them, for want of arguments: {', '.join(others)}."] if others else []
    text = "\n\n".join([*notes, reach_table_text(results), rank_text(times), growth_text(growth), *missing])
    command = f"python -m benchmarks.ranking --robot {options.robot} --seed {options.seed} --rounds {options.rounds}"
    command += f" --ticks {options.ticks} --largest {options.largest}"
    facts = {"reach": results, "growth": growth, "costs": [c.name for c in costs], "missing": missing}
    facts["rank"] = {name: np.percentile(s, [0, 50, 95, 99]).tolist() for name, s in times.items()}
    save(options.output, "ranking", facts, text, command)
    if options.output is not None:
        on = results[-1]["seconds"]
        loop = 1e3 * float(np.median(on["TRAC-IK"])) / len(candidates) if "TRAC-IK" in on else None
        base = 1e6 * float(np.median(times["Pink"])) if "Pink" in times else None
        plot(growth, base, loop, options.output / "ranking.png")
        summary = {**facts, "machine": machine(), "command": command}
        (options.output / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
