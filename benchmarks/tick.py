"""How long one control tick takes: the servo's beside other libraries' `solve_ik`, and the whole controller's.

    python -m benchmarks.tick --seconds 20 --robots panda ur5 iiwa --output results
    python -m benchmarks.tick --seconds 0 --steady-seconds 0 --rates 250 500 1000    # the whole controller alone

Same arm, same limits, same stream of targets. The contenders run in turns of a few milliseconds each, in changing
order, so that whatever else the machine does meets all of them. What each computes differs, and the table says so.
"""

from __future__ import annotations

import argparse
import gc
import json
import subprocess
import sys
from collections import defaultdict, deque
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks import controller_tick
from benchmarks.machine import markdown_table, save
from benchmarks.peers import (
    ORIENTATION_COST,
    POSITION_COST,
    POSTURE_COST,
    MinkPeer,
    PinkPeer,
    arm_only,
    target_path,
)
from benchmarks.ranking import scene
from optsc.collision import CollisionAvoidance
from optsc.control.controller import SharedController
from optsc.control.servo import Servo
from optsc.followers import IdealFollower
from optsc.geometry import Pose
from optsc.operators.clutch import ClutchSettings, Hand, engage, follow
from optsc.people import R_WS_DEFAULT, Simulated
from optsc.robot import RobotModel, load_robot
from optsc.selection import GraspSelector
from optsc.session import Session
from optsc.sim import tabletop

BLOCK = 40
"""Ticks of one turn."""
WARM_UP = 0.05
"""Share of each series that is not counted."""
SERVO_AVOIDING = "optsc, the same, avoiding itself, the table and three objects"
SERVO = "optsc, whole tick: clutch, prediction, reference, QP with position + velocity + acceleration + jerk, guard"
BASE = "Pink, position + velocity: solve_ik"

Samples = list[Pose | None]
Series = dict[str, Any]


def samples_of(robot: RobotModel, rate: float, sample_rate: float, count: int) -> Samples:
    """Return, per tick, the newest sample of the target path or None when there is none at this tick."""
    index = np.floor(np.arange(count) * (sample_rate / rate) + 1e-9).astype(int)
    poses = target_path(robot.forward(robot.home), np.arange(index[-1] + 1) / sample_rate)
    is_new = np.diff(index, prepend=-1) > 0
    return [poses[int(i)] if new else None for i, new in zip(index, is_new, strict=True)]


class ServoContender:
    """The servo behind a clutch, as a controller in manual mode runs it."""

    def __init__(
        self, robot: RobotModel, rate: float, name: str = SERVO, avoid: CollisionAvoidance | None = None
    ) -> None:
        self._settings, self._name = ClutchSettings(orientation="relative"), name
        self.servo = Servo(robot, rate, avoid=avoid)
        X = robot.forward(robot.home)
        p, q = tuple(X.translation.tolist()), tuple(X.quaternion.tolist())
        self._clutch = engage(self._settings, Hand(p, q, 0.0), p, q)

    def run(self, samples: Samples, series: Series) -> None:
        """Run the ticks of one turn and add their times [s]."""
        servo, times = self.servo, series[self._name]
        for X in samples:
            start = perf_counter()
            if X is not None:
                hand = Hand(tuple(X.translation.tolist()), tuple(X.quaternion.tolist()), servo.time)
                self._clutch = follow(self._settings, self._clutch, hand)
                servo.observe(self._clutch.tool_p, self._clutch.tool_q, servo.time)
            servo.step()
            times.append(perf_counter() - start)


class PeerContender:
    """A library of this process."""

    def __init__(self, peer: PinkPeer | MinkPeer) -> None:
        self.peer = peer

    def run(self, samples: Samples, series: Series) -> None:
        """Run the ticks of one turn and add their times [s]."""
        name, peer = self.peer.name, self.peer
        for X in samples:
            tick = peer.tick(X)
            series[f"{name}: solve_ik"].append(tick.solve)
            series[f"{name}: set target, solve_ik, integrate"].append(tick.whole)


class PlacoContender:
    """PlaCo, in the interpreter of another environment."""

    name = "PlaCo (C++), position + velocity"

    def __init__(self, robot: RobotModel, rate: float, python: str) -> None:
        worker = Path(__file__).with_name("placo_worker.py")
        self._process = subprocess.Popen(
            [python, str(worker)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        request = {
            "urdf": arm_only(robot),
            "tip": robot.tip,
            "joints": robot.joint_names,
            "q": robot.home.tolist(),
            "velocity": robot.limits.velocity.tolist(),
            "period": 1.0 / rate,
            "position_cost": POSITION_COST,
            "orientation_cost": ORIENTATION_COST,
            "posture_cost": POSTURE_COST,
        }
        self._ask(request)

    def _ask(self, request: Any) -> Any:
        stdin, stdout = self._process.stdin, self._process.stdout
        if stdin is None or stdout is None:
            raise RuntimeError("the worker has no pipes")
        stdin.write(json.dumps(request) + "\n")
        stdin.flush()
        answer = stdout.readline()
        if not answer:
            raise RuntimeError("the PlaCo worker ended; what it printed is above")
        return json.loads(answer)

    def run(self, samples: Samples, series: Series) -> None:
        """Let the worker run the ticks of one turn and add their times [s]."""
        answer = self._ask([None if X is None else X.matrix().tolist() for X in samples])
        series[f"{self.name}: solve"].extend(answer["solve"])
        series[f"{self.name}: set target, solve, update"].extend(answer["whole"])

    def close(self) -> None:
        """End the worker."""
        self._process.communicate()


def avoidance_of(robot: RobotModel) -> CollisionAvoidance:
    """Avoid the arm itself, the table and the three objects of a scene."""
    world = tabletop(robot, seed=0)
    return CollisionAvoidance(robot, {name: (model.parts, world.X_WO[name]) for name, model in world.objects.items()})


def contenders_for(robot: RobotModel, rate: float, placo: str | None) -> tuple[list[Any], list[str]]:
    """Return what can be measured here, and why not the rest."""
    makers: list[tuple[str, Callable[[], Any]]] = [
        ("optsc", lambda: ServoContender(robot, rate)),
        ("optsc avoiding", lambda: ServoContender(robot, rate, SERVO_AVOIDING, avoidance_of(robot))),
        ("Pink", lambda: PeerContender(PinkPeer(robot, rate))),
        ("Pink with accelerations", lambda: PeerContender(PinkPeer(robot, rate, accelerations=True))),
        ("mink", lambda: PeerContender(MinkPeer(robot, rate))),
    ]
    if placo is not None:
        makers.append(("PlaCo", lambda: PlacoContender(robot, rate, placo)))
    made, missing = [], [] if placo is not None else ["PlaCo: no --placo-python"]
    for name, make in makers:
        try:
            made.append(make())
        except (ImportError, OSError, RuntimeError) as error:
            missing.append(f"{name}: {error}")
    return made, missing


def measure(robot: RobotModel, rate: float, sample_rate: float, seconds: float, placo: str | None) -> dict[str, Any]:
    """Return the times of all contenders on one arm."""
    count = max(BLOCK, round(seconds * rate))
    samples = samples_of(robot, rate, sample_rate, count)
    contenders, missing = contenders_for(robot, rate, placo)
    series: Series = defaultdict(list)
    gc.collect()
    gc.disable()
    try:
        for turn, start in enumerate(range(0, count, BLOCK)):
            first = turn % len(contenders)
            for contender in contenders[first:] + contenders[:first]:
                contender.run(samples[start : start + BLOCK], series)
    finally:
        gc.enable()
        for contender in contenders:
            if isinstance(contender, PlacoContender):
                contender.close()
    return {"robot": robot.name, "ticks": count, "series": summary_of(series), "missing": missing}


def summary_of(series: Series) -> dict[str, dict[str, float]]:
    """Return least, median and high percentiles of each series [us], and the ratio of medians to Pink's."""
    found = {}
    for name, times in series.items():
        kept = 1e6 * np.array(times[int(WARM_UP * len(times)) :])
        p50, p95, p99, p999 = np.percentile(kept, [50, 95, 99, 99.9])
        found[name] = {"min": float(kept.min()), "p50": p50, "p95": p95, "p99": p99, "p99.9": p999}
    if BASE in found:
        for row in found.values():
            row["ratio"] = row["p50"] / found[BASE]["p50"]
            row["ratio of minima"] = row["min"] / found[BASE]["min"]
    return found


def snapshot_times(robot: RobotModel, rate: float, ticks: int) -> dict[str, float]:
    """Return the median times [us] of taking and restoring a snapshot, at each tick of a run with candidates."""
    candidates, clear = scene(robot, ["box"], 0, None)
    controller = SharedController(robot, GraspSelector(robot), clutch=ClutchSettings(R_WS=R_WS_DEFAULT))
    operator, follower = (
        Simulated(seed=1),
        IdealFollower(robot, tabletop(robot, objects=("box",), seed=0).X_WO, candidates),
    )
    options: dict[str, Any] = {"candidates": candidates, "clear": clear, "rate": rate}
    session = Session.start(controller, operator=operator, follower=follower, **options)
    times = np.empty((ticks, 2))
    for i in range(ticks):
        session.tick()
        start = perf_counter()
        snapshot = controller.snapshot()
        between = perf_counter()
        controller.restore(snapshot)
        times[i] = between - start, perf_counter() - between
    taken, restored = 1e6 * np.median(times, axis=0)
    return {"snapshot": float(taken), "restore": float(restored)}


def steadiness(robot: RobotModel, rate: float, sample_rate: float, seconds: float) -> dict[str, Any]:
    """Return how often the servo alone took over 1 ms, with and without the collector, beside an empty loop.

    The empty loop does nothing for as long as a median tick takes: what it is late by, the machine did.
    """
    count = round(seconds * rate)
    samples = samples_of(robot, rate, sample_rate, count)
    found: dict[str, Any] = {"seconds of control time": seconds, "ticks": count}
    median = 30e-6
    for name in ("collector off and heap frozen", "collector on", "empty loop"):
        times = _spin(count, median) if name == "empty loop" else _alone(robot, rate, samples, name)
        kept = times[count // 20 :]
        median = float(np.median(kept))
        found[name] = {
            "over 1 ms": float(np.mean(kept > 1e-3)),
            "p50": 1e6 * median,
            "p99.9": 1e6 * float(np.percentile(kept, 99.9)),
            "max": 1e6 * float(kept.max()),
        }
    found["memory blocks kept per tick"] = _growth(robot, rate, samples)
    return found


def _alone(robot: RobotModel, rate: float, samples: Samples, collector: str) -> np.ndarray:
    contender, series = ServoContender(robot, rate), defaultdict(list)
    gc.collect()
    if collector != "collector on":
        gc.freeze()
        gc.disable()
    try:
        contender.run(samples, series)
    finally:
        gc.enable()
        gc.unfreeze()
    return np.array(series[SERVO])


def _growth(robot: RobotModel, rate: float, samples: Samples) -> float:
    """Return how many blocks of memory a tick leaves behind without the collector.

    The first half only fills the interpreter's stores of small tuples.
    """
    contender, count, sink = ServoContender(robot, rate), min(len(samples), 20000), {SERVO: deque(maxlen=1)}
    gc.collect()
    gc.disable()
    try:
        contender.run(samples[: count // 2], sink)
        before = sys.getallocatedblocks()
        contender.run(samples[count // 2 : count], sink)
        return (sys.getallocatedblocks() - before) / (count - count // 2)
    finally:
        gc.enable()


def _spin(count: int, duration: float) -> np.ndarray:
    times = np.empty(count)
    for i in range(count):
        start = perf_counter()
        while perf_counter() - start < duration:
            pass
        times[i] = perf_counter() - start
    return times


def report(
    results: list[dict[str, Any]],
    steady: dict[str, Any] | None,
    snapshots: dict[str, float],
    whole: dict[str, controller_tick.Summary],
) -> str:
    """Return the tables."""
    parts = []
    for result in results:
        rows = [
            [name, *(f"{row[key]:.1f}" for key in ("min", "p50", "p95", "p99", "p99.9")), ratios(row)]
            for name, row in result["series"].items()
        ]
        header = [
            "tick [us]",
            "min",
            "median",
            "p95",
            "p99",
            "p99.9",
            "ratio of medians (of minima) to Pink's",
        ]
        parts.append(f"**{result['robot']}**, {result['ticks']} ticks\n\n{markdown_table(header, rows)}")
        parts.extend(f"Not measured: {reason}" for reason in result["missing"])
    if steady is not None:
        rows = [
            [name, f"{100 * row['over 1 ms']:.4f} %", *(f"{row[k]:.1f}" for k in ("p50", "p99.9", "max"))]
            for name, row in steady.items()
            if isinstance(row, dict)
        ]
        header = [f"{steady['ticks']} ticks alone", "over 1 ms", "median [us]", "p99.9 [us]", "longest [us]"]
        kept = steady["memory blocks kept per tick"]
        parts.append(f"{markdown_table(header, rows)}\n\nMemory blocks that a tick leaves behind: {kept:.3f}")
    for rate, summary in whole.items():
        parts.append(f"**Whole controller at {rate} Hz**\n\n{markdown_table(*controller_tick.table(summary))}")
    rows = [[f"{name} of a controller [us]", f"{median:.1f}"] for name, median in snapshots.items()]
    parts.append(markdown_table(["in a run with candidates", "median"], rows))
    return "\n\n".join(parts)


def ratios(row: dict[str, float]) -> str:
    """Return the two ratios of a row, where there is something to compare with."""
    return f"{row['ratio']:.2f} ({row['ratio of minima']:.2f})" if "ratio" in row else "-"


def main(arguments: list[str] | None = None) -> None:
    """Measure and report."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tick", description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of control time per arm (default 20)")
    parser.add_argument("--steady-seconds", type=float, default=60.0, help="of the servo alone; 0 for none")
    parser.add_argument("--robots", nargs="+", default=["panda", "ur5", "iiwa"])
    parser.add_argument("--rate", type=float, default=1000.0, help="control rate in Hz (default 1000)")
    parser.add_argument("--sample-rate", type=float, default=90.0, help="of the targets in Hz (default 90)")
    parser.add_argument("--rates", type=float, nargs="*", default=[500.0], help="of the whole controller, in Hz")
    parser.add_argument("--whole-seconds", type=float, default=60.0, help="of it at each rate; 0 for none")
    parser.add_argument("--repeats", type=int, default=3, help="of that run; of each tick the least time counts")
    parser.add_argument("--candidates", type=int, default=450, help="in that run (default 450)")
    parser.add_argument("--placo-python", metavar="PYTHON", help="interpreter of an environment with placo")
    parser.add_argument("--output", type=Path, metavar="DIR", help="where tick.json and tick.md go")
    o = parser.parse_args(arguments)
    robots = [load_robot(name) for name in o.robots]
    results = [measure(robot, o.rate, o.sample_rate, o.seconds, o.placo_python) for robot in robots if o.seconds > 0]
    steady = steadiness(robots[0], o.rate, o.sample_rate, o.steady_seconds) if o.steady_seconds > 0 else None
    snapshots = snapshot_times(robots[0], o.rate, max(1, round(min(o.seconds, 5.0) * o.rate)))
    whole = {
        f"{rate:g}": controller_tick.measure(robots[0], rate, o.whole_seconds, o.candidates, repeats=o.repeats)
        for rate in (o.rates if o.whole_seconds > 0 else [])
    }
    command = "python -m benchmarks.tick " + " ".join(sys.argv[1:] if arguments is None else arguments)
    facts = {"results": results, "steady": steady, "snapshots": snapshots, "whole": whole}
    save(o.output, "tick", facts, report(results, steady, snapshots, whole), command.strip())


if __name__ == "__main__":
    main()
