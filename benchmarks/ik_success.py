"""How often and how fast poses are solved, by the protocol of TRAC-IK and beside TRAC-IK.

Configurations uniform in the joint limits, targets by forward kinematics, the middle of the limits as seed, 1e-5 on
distance [m] and angle [rad], the mean time over all poses, also those that are not solved. TRAC-IK (`pytracik`) gets
the same targets, seeds, limits and frames, with its 5 ms; both are called once for each pose, in turns of `BLOCK`,
so that both see the same machine. What either returns is judged by pinocchio's forward kinematics and by the limits.

TRAC-IK reads `<safety_controller>` soft limits, also absent ones, as hard: they are taken out of the description.
"""

from __future__ import annotations

import argparse
import json
import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from benchmarks.machine import machine, markdown_table, save
from benchmarks.peers import arm_only
from optsc.geometry import Pose, rotation
from optsc.ik.batch import solve_ik
from optsc.robot import ROBOT_NAMES, RobotModel, load_robot

TOLERANCE, TIMEOUT = 1e-5, 0.005
BLOCK = 100
"""Poses that a contender solves before it is the other's turn."""
RESAMPLES = 2000
"""Resamples of the bootstrap."""
PUBLISHED = {"panda": (99.88, 370.0), "ur5": (99.17, 370.0), "iiwa": (99.92, 280.0)}
"""TRAC-IK's own table: success [%] and mean time [us], of other machines and slightly different descriptions."""
PUBLISHED_SOURCE = "README of TRAC-IK 1.5.1, bitbucket.org/traclabs/trac_ik"
ROUNDING = 1e-6
"""By how much a peer may exceed limits and tolerance [rad and m, relative]: TRAC-IK's own rounding puts joints
up to 6e-8 beyond their limits. Nothing is granted to optsc."""


class Answer(NamedTuple):
    """What a contender made of N poses: configurations (N, n), which it calls solved (N,), seconds (N,)."""

    q: np.ndarray
    claimed: np.ndarray
    seconds: np.ndarray


class Optsc:
    """`optsc.solve_ik`, one call for each pose."""

    name = "optsc"

    def __init__(self, robot: RobotModel, seed: np.ndarray) -> None:
        self._robot, self._seed = robot, seed

    def solve(self, X_WT: Pose) -> tuple[np.ndarray, bool, float]:
        """Return the configuration, whether it is called solved, and the seconds of the call."""
        start = perf_counter()
        solution = solve_ik(self._robot, X_WT, seeds=self._seed, tolerance=TOLERANCE)
        seconds = perf_counter() - start
        return solution.q, bool(solution.success), seconds


class TracIk:
    """TRAC-IK, one call for each pose; the extension is called directly, without its wrapper's eigenvalues."""

    name = "TRAC-IK"

    def __init__(self, robot: RobotModel, seed: np.ndarray) -> None:
        import pytracik

        root = ElementTree.fromstring(arm_only(robot))
        for joint in root.findall("joint"):
            for soft in joint.findall("safety_controller"):
                joint.remove(soft)
        children = {child.get("link") for child in root.iter("child")}
        (base,) = [link.get("name") for link in root.findall("link") if link.get("name") not in children]
        text = ElementTree.tostring(root, encoding="unicode")
        speed = pytracik.SolveType.Speed
        self._call, self._seed = pytracik.ik, seed
        self._chain = pytracik.TRAC_IK(base, robot.tip, text, TIMEOUT, TOLERANCE, speed)
        bounds = [pytracik.get_joint_lower_bounds(self._chain), pytracik.get_joint_upper_bounds(self._chain)]
        if not np.allclose(bounds, [robot.limits.lower, robot.limits.upper], atol=1e-12):
            raise ValueError(f"TRAC-IK reads other limits than {robot.name}'s: {bounds}")
        there, own = pytracik.fk(self._chain, robot.home), robot.forward(robot.home).matrix()
        if not np.allclose(there, own, atol=1e-9):
            raise ValueError(f"TRAC-IK's forward kinematics of {robot.name} differs")

    def solve(self, X_WT: Pose, seed: np.ndarray | None = None) -> tuple[np.ndarray, bool, float]:
        """Return the configuration, whether it is called solved, and the seconds of the call."""
        seed = self._seed if seed is None else seed
        (w, x, y, z), p = X_WT.quaternion.tolist(), X_WT.translation.tolist()
        start = perf_counter()
        code, *q = self._call(self._chain, seed, p[0], p[1], p[2], x, y, z, w)
        seconds = perf_counter() - start
        return np.array(q), code >= 0, seconds


def run_in_turns(contenders: list[Any], poses: list[Pose], warm: Pose) -> dict[str, Answer]:
    """Let every contender solve all poses, block by block in turns, and return their answers."""
    found: dict[str, list[tuple[np.ndarray, bool, float]]] = {c.name: [] for c in contenders}
    for contender in contenders:
        for _ in range(50):
            contender.solve(warm)
    for i in range(0, len(poses), BLOCK):
        turn = (i // BLOCK) % len(contenders)
        for contender in contenders[turn:] + contenders[:turn]:
            found[contender.name] += [contender.solve(X) for X in poses[i : i + BLOCK]]
    return {name: Answer(*(np.array(part) for part in zip(*rows, strict=True))) for name, rows in found.items()}


def solved(robot: RobotModel, X_WT: Pose, answer: Answer, slack: float = 0.0) -> np.ndarray:
    """Return which configurations (N,) are inside the limits and meet their pose, by pinocchio.

    A pose is met when distance and angle are within `TOLERANCE`; for TRAC-IK, which tests components, when each is, in
    the world's axes or in the target's. ``slack``, for peers, is granted on all: they compute with roundings of their
    own.
    """
    q = np.where(answer.claimed[:, None], answer.q, robot.home)
    inside = np.all((q >= robot.limits.lower - slack) & (q <= robot.limits.upper + slack), axis=1)
    miss, turn = errors(robot, X_WT, q)
    error = np.maximum(np.linalg.norm(miss, axis=1), np.linalg.norm(turn, axis=1))
    if slack > 0.0:
        back = rotation.conjugate(X_WT.quaternion)
        in_world = np.concatenate([miss, turn], axis=1)
        in_target = np.concatenate([rotation.rotate(back, miss), rotation.rotate(back, turn)], axis=1)
        error = np.minimum(np.max(np.abs(in_world), axis=1), np.max(np.abs(in_target), axis=1))
    return answer.claimed & inside & (error <= TOLERANCE * (1.0 + slack))


def errors(robot: RobotModel, X_WT: Pose, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what configurations (N, n) miss of poses, by pinocchio: shifts (N, 3) [m] and turns (N, 3) [rad] in W."""
    reached = robot.forward(q)
    turn = rotation.log(rotation.multiply(X_WT.quaternion, rotation.conjugate(reached.quaternion)))
    return X_WT.translation - reached.translation, turn


def residuals(robot: RobotModel, X_WT: Pose, q: np.ndarray) -> dict[str, float]:
    """Return how exactly configurations (N, n) meet their poses: the larger of distance [m] and angle [rad] of each."""
    error = np.maximum(*(np.linalg.norm(part, axis=1) for part in errors(robot, X_WT, q)))
    return {
        "median": float(np.median(error)),
        "p99.9": float(np.percentile(error, 99.9)),
        "greatest": float(error.max()),
        "above 1e-9": int(np.count_nonzero(error > 1e-9)),
    }


def wilson(successes: int, count: int, z: float = 1.959964) -> tuple[float, float]:
    """Return the 95 % interval of a share after Wilson (1927)."""
    share, square = successes / count, z * z / count
    centre, half = share + square / 2, z * math.sqrt(share * (1 - share) / count + square / (4 * count))
    return max(0.0, (centre - half) / (1 + square)), min(1.0, (centre + half) / (1 + square))


def bootstrap(times: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, tuple[float, float]]:
    """Return 95 % intervals of the mean times, and of optsc's over TRAC-IK's when both are there.

    Poses are drawn with replacement, the same for both. A pose's time is not only its own: the machine has slow
    moments that last, so what is drawn are blocks of `BLOCK` poses.
    """
    names = list(times)
    blocks = {name: _block_means(values) for name, values in times.items()}
    count = len(blocks[names[0]])
    drawn = rng.integers(count, size=(RESAMPLES, count))
    means = {name: values[drawn].mean(axis=1) for name, values in blocks.items()}
    if {"optsc", "TRAC-IK"} <= set(names):
        means["ratio"] = means["optsc"] / means["TRAC-IK"]
    return {name: tuple(np.percentile(values, [2.5, 97.5]).tolist()) for name, values in means.items()}


def _block_means(values: np.ndarray) -> np.ndarray:
    whole = len(values) // BLOCK
    return values[: whole * BLOCK].reshape(whole, BLOCK).mean(axis=1) if whole > 1 else values


def batch_time(robot: RobotModel, X_WT: Pose, seed: np.ndarray) -> float:
    """Return the seconds for each pose when all are solved in one call; the median of five calls."""
    seconds = []
    for _ in range(5):
        start = perf_counter()
        solve_ik(robot, X_WT, seeds=seed, tolerance=TOLERANCE)
        seconds.append(perf_counter() - start)
    return float(np.median(seconds)) / len(X_WT)


def measure(name: str, count: int, seed: int) -> dict[str, Any]:
    """Return everything about one arm."""
    robot, rng = load_robot(name), np.random.default_rng(seed)
    X_WT = robot.forward(robot.random_configuration(rng, (count,)))
    middle = np.mean(robot.limits.sampling, axis=0)
    contenders: list[Any] = [Optsc(robot, middle)]
    missing = None
    try:
        contenders.append(TracIk(robot, middle))
    except ImportError as error:
        missing = f"TRAC-IK was left out: {error}"
    answers = run_in_turns(contenders, list(X_WT), robot.forward(robot.home))
    good = {c: solved(robot, X_WT, a, 0.0 if c == "optsc" else ROUNDING) for c, a in answers.items()}
    intervals = bootstrap({c: a.seconds * 1e6 for c, a in answers.items()}, rng)
    result: dict[str, Any] = {"robot": name, "count": count, "missing": missing}
    for c, answer in answers.items():
        wins = int(np.count_nonzero(good[c]))
        microseconds = answer.seconds * 1e6
        result[c] = {
            "solved": wins,
            "claimed": int(np.count_nonzero(answer.claimed)),
            "success [%]": 100.0 * wins / count,
            "error of the solved": residuals(robot, X_WT[good[c]], answer.q[good[c]]),
            "success 95 % [%]": [100.0 * x for x in wilson(wins, count)],
            "mean [us]": float(microseconds.mean()),
            "mean 95 % [us]": intervals[c],
            "p50, p95, p99 [us]": np.percentile(microseconds, [50, 95, 99]).tolist(),
        }
    result["optsc"]["mean in one batch [us]"] = batch_time(robot, X_WT, middle) * 1e6
    if missing is None:
        result["solved by optsc alone"] = int(np.count_nonzero(good["optsc"] & ~good["TRAC-IK"]))
        result["solved by TRAC-IK alone"] = int(np.count_nonzero(~good["optsc"] & good["TRAC-IK"]))
        result["ratio of means"] = result["optsc"]["mean [us]"] / result["TRAC-IK"]["mean [us]"]
        result["ratio 95 %"] = intervals["ratio"]
    return result


def _row(result: dict[str, Any], contender: str) -> list[str]:
    facts = result[contender]
    low, high = facts["success 95 % [%]"]
    p50, p95, p99 = facts["p50, p95, p99 [us]"]
    ratio = "1"
    if contender == "optsc" and "ratio of means" in result:
        ratio = "{:.3f} ({:.3f} to {:.3f})".format(result["ratio of means"], *result["ratio 95 %"])
    return [
        result["robot"],
        f"{contender}, one call a pose",
        f"{facts['success [%]']:.2f} ({low:.2f} to {high:.2f})",
        "{:.1f} ({:.1f} to {:.1f})".format(facts["mean [us]"], *facts["mean 95 % [us]"]),
        f"{p50:.1f} / {p95:.1f} / {p99:.1f}",
        ratio if "ratio of means" in result else "",
    ]


def _exact(result: dict[str, Any]) -> tuple[float, float, int]:
    facts = result["optsc"]["error of the solved"]
    return facts["median"], facts["greatest"], facts["above 1e-9"]


def table(results: list[dict[str, Any]]) -> str:
    """Return the results as text."""
    rows = []
    for result in results:
        rows.append(_row(result, "optsc"))
        batch = result["optsc"]["mean in one batch [us]"]
        share = f"{batch / result['TRAC-IK']['mean [us]']:.3f}" if "TRAC-IK" in result else ""
        rows.append([result["robot"], "optsc, all in one call", "the same", f"{batch:.1f}", "", share])
        if "TRAC-IK" in result:
            rows.append(_row(result, "TRAC-IK"))
        if result["robot"] in PUBLISHED:
            success, mean = PUBLISHED[result["robot"]]
            rows.append([result["robot"], "TRAC-IK, published", f"{success:.2f}", f"{mean:.0f}", "", ""])
    head = [
        "arm",
        "",
        "success [%] (95 %)",
        "mean [us] (95 %)",
        "p50 / p95 / p99 [us]",
        "mean / TRAC-IK's (95 %)",
    ]
    ours, theirs = "solved by optsc alone", "solved by TRAC-IK alone"
    only = [f"{r['robot']}: {r[ours]} poses only by optsc, {r[theirs]} only by TRAC-IK" for r in results if ours in r]
    missing = [r["missing"] for r in results[:1] if r["missing"]]
    claims = [
        f"{r['robot']} {r['TRAC-IK']['claimed']} of {r['count']}, of which {r['TRAC-IK']['solved']} are"
        for r in results
        if "TRAC-IK" in r
    ]
    exact = ["{}: median {:.0e}, greatest {:.0e}, {} above 1e-9".format(r["robot"], *_exact(r)) for r in results]
    missing.append(f"Error of what optsc solved, the larger of distance [m] and angle [rad]: {'; '.join(exact)}.")
    if claims:
        missing.append(
            f"TRAC-IK calls solved: {'; '.join(claims)}. Its {TIMEOUT * 1e3:g} ms are wall time for two threads: on a "
            "busy machine it runs out of it, so judge success by a run on a quiet one."
        )
    note = f"Published: {PUBLISHED_SOURCE}; it has no xArm7."
    return "\n\n".join([markdown_table(head, rows), *(["; ".join(only) + "."] if only else []), *missing, note])


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Success and time of inverse kinematics beside TRAC-IK.",
        epilog="example: python -m benchmarks.ik_success --robots panda ur5 --count 10000 --output results",
    )
    parser.add_argument("--robots", nargs="+", default=list(ROBOT_NAMES), choices=ROBOT_NAMES)
    parser.add_argument("--count", type=int, default=10000, help="poses for each arm")
    parser.add_argument("--seed", type=int, default=0, help="of the configurations and of the bootstrap")
    parser.add_argument("--output", type=Path, help="folder for the table and its numbers")
    options = parser.parse_args()
    if options.count < 2:
        parser.error("--count: at least 2")
    results = []
    for name in options.robots:
        print(f"{name}: {options.count} poses", flush=True)
        results.append(measure(name, options.count, options.seed))
    names = " ".join(options.robots)
    command = f"python -m benchmarks.ik_success --robots {names} --count {options.count} --seed {options.seed}"
    facts = {"results": results, "published": PUBLISHED, "published by": PUBLISHED_SOURCE}
    save(options.output, "ik_success", facts, table(results), command)
    if options.output is not None:
        summary = {**facts, "machine": machine(), "command": command}
        (options.output / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
