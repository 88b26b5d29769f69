"""Whether an arm is calm when pressed against what it cannot pass: joint limits, its reach, a table, a wall.

    python -m benchmarks.press --robots panda ur5 iiwa --output results

Each target comes in over two seconds and stays, with and without the tremor of a hand; the servo, Pink and mink follow
it for 10 s. Counted are sign changes of joint velocity and the jerk, over the last half, when all should be at rest.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from benchmarks.machine import markdown_table, save
from benchmarks.peers import MinkPeer, PinkPeer, Surface
from optsc.collision import CollisionAvoidance
from optsc.control.servo import Servo
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.robot import RobotModel, load_robot

APPROACH = 2.0
"""How long the target takes to come in [s]."""
SAMPLE_RATE = 50.0
"""Of the targets [Hz]."""
TREMOR = (0.5e-3, 2e-3)
"""Standard deviation of a hand's noise per axis, position [m] and angle [rad]; a consumer tracker's order."""
STILL = 1e-5
"""A joint slower than this [rad/s] counts as standing."""
BEYOND = 0.3
"""How far beyond its limit a joint would have to go [rad]."""
FAR = 1.0
"""How far beyond the arm's reach a target is [m]."""


WALL = 0.15
"""How far before the tool the wall stands [m]."""
BEHIND = 0.3
"""How far behind the surface of table or wall a target is [m]."""


class Case(NamedTuple):
    """A target that is not to be reached: its name, where it is in the end, and the surface in between, if any."""

    name: str
    X_WT: Pose
    surface: Surface | None = None


class Arm(Protocol):
    """What follows: takes the newest sample, or None, and gives the velocity (n,) of the next tick [rad/s]."""

    def __call__(self, X_WT: Pose | None) -> np.ndarray: ...


def cases_for(robot: RobotModel) -> list[Case]:
    """Return one case per joint with limits in the middle of the arm, one behind the reach, a table and a wall."""
    cases, X, limits = [], robot.forward(robot.home), robot.limits
    for i in range(1, robot.n - 1):
        if not limits.bounded[i]:
            continue
        q = robot.home.copy()
        towards_upper = limits.upper[i] - q[i] < q[i] - limits.lower[i]
        q[i] = limits.upper[i] + BEYOND if towards_upper else limits.lower[i] - BEYOND
        if abs(q[i] - robot.home[i]) < np.pi:
            cases.append(Case(f"{robot.joint_names[i]} beyond its limit", robot.forward(q)))
    outwards = np.array([X.translation[0], X.translation[1], 0.0])
    outwards *= FAR / np.linalg.norm(outwards)
    cases.append(Case("target behind the reach", Pose(X.quaternion, X.translation + outwards)))
    ahead = int(np.argmax(np.abs(X.translation[:2])))
    sign = 1.0 if X.translation[ahead] > 0.0 else -1.0
    table = Surface(2, -1.0, 0.0)
    wall = Surface(ahead, sign, sign * float(X.translation[ahead]) + WALL)
    for name, surface in (("table", table), ("wall", wall)):
        p = X.translation.copy()
        p[surface.axis] = surface.sign * (surface.at + BEHIND)
        cases.append(Case(name, Pose(X.quaternion, p), surface))
    return cases


def avoidance_of(robot: RobotModel, surface: Surface) -> CollisionAvoidance:
    """Return what keeps the servo's whole arm clear of itself and of a surface: the table, or a wall without one."""
    if surface.axis == 2:
        return CollisionAvoidance(robot, table_height=-surface.at)
    half = np.array([1.5, 1.5, 1.5])
    half[surface.axis] = 0.05
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    centre = np.zeros(3)
    centre[surface.axis] = surface.sign * (surface.at + 0.05)
    # Of a mesh its hull counts, so one face will do.
    wall = TriangleMesh(half * corners, [[0, 1, 3]])
    return CollisionAvoidance(robot, {"wall": (wall, Pose.from_translation(centre))}, table_height=None)


def stream(robot: RobotModel, case: Case, rate: float, seconds: float, tremor: bool) -> list[Pose | None]:
    """Return, per tick, the newest sample or None."""
    start, rng, samples, due = robot.forward(robot.home), np.random.default_rng(0), [], 0.0
    for k in range(round(seconds * rate)):
        if k / rate + 1e-9 < due:
            samples.append(None)
            continue
        due += 1.0 / SAMPLE_RATE
        share = min(1.0, k / rate / APPROACH)
        share = share * share * (3.0 - 2.0 * share)
        p = start.translation + share * (case.X_WT.translation - start.translation)
        q = rotation.slerp(start.quaternion, case.X_WT.quaternion, share)
        if tremor:
            p = p + TREMOR[0] * rng.normal(size=3)
            q = rotation.multiply(rotation.exp(TREMOR[1] * rng.normal(size=3)), q)
        samples.append(Pose(q, p))
    return samples


def arms_for(robot: RobotModel, rate: float, surface: Surface | None) -> tuple[dict[str, Callable[[], Arm]], list[str]]:
    """Return what follows, by name, made again for each case; and what is not installed here."""

    def servo() -> Arm:
        made = Servo(robot, rate, avoid=None if surface is None else avoidance_of(robot, surface))
        return lambda X: made.step(X).v

    def peer(make: Callable[[], PinkPeer | MinkPeer]) -> Callable[[], Arm]:
        def start() -> Arm:
            made = make()
            return lambda X: made.tick(X).v

        return start

    peers: dict[str, Callable[[], PinkPeer | MinkPeer]] = {
        "Pink": lambda: PinkPeer(robot, rate, surface=surface),
        "Pink with accelerations": lambda: PinkPeer(robot, rate, accelerations=True, surface=surface),
        "mink": lambda: MinkPeer(robot, rate, surface),
    }
    arms, missing = {"optsc": servo}, []
    for name, make in peers.items():
        try:
            make()
        except ImportError as error:
            missing.append(f"{name}: {error}")
        else:
            arms[name] = peer(make)
    return arms, missing


def pressed(arm: Arm, samples: list[Pose | None], robot: RobotModel, rate: float) -> dict[str, float]:
    """Return what the arm does: over the last half, and the greatest jerk of all."""
    v = np.array([arm(X) for X in samples])
    jerk = np.diff(v, 2, axis=0) * rate**2 / robot.limits.jerk
    late, signs = jerk[len(jerk) // 2 :], np.sign(np.where(np.abs(v) < STILL, 0.0, v))[len(v) // 2 :]
    # Zeros in between are skipped: only a change from one direction to the other counts.
    changes = max(_changes(column) for column in signs.T)
    return {
        "sign changes per second, worst joint": changes / (len(signs) / rate),
        "rms jerk, worst joint [%]": 100.0 * float(np.sqrt(np.mean(late**2, axis=0)).max()),
        "greatest jerk of the whole run [%]": 100.0 * float(np.abs(jerk).max()),
        "greatest speed in the last half [%]": 100.0 * float((np.abs(v[len(v) // 2 :]) / robot.limits.velocity).max()),
    }


def _changes(signs: np.ndarray) -> int:
    moving = signs[signs != 0.0]
    return int(np.count_nonzero(moving[1:] != moving[:-1]))


def measure(robot: RobotModel, rate: float, seconds: float) -> dict[str, Any]:
    """Return all cases of one arm."""
    found: dict[str, Any] = {"robot": robot.name, "missing": [], "cases": {}}
    for case in cases_for(robot):
        arms, found["missing"] = arms_for(robot, rate, case.surface)
        for tremor in (False, True):
            samples = stream(robot, case, rate, seconds, tremor)
            name = case.name + (", with tremor" if tremor else "")
            found["cases"][name] = {who: pressed(make(), samples, robot, rate) for who, make in arms.items()}
    return found


def report(results: list[dict[str, Any]], seconds: float) -> str:
    """Return one table per arm."""
    parts = [f"Pressed for {seconds:.0f} s; sign changes, jerk and speed over the last half."]
    for result in results:
        rows = [
            [name, who, *(f"{x:.2f}" for x in numbers.values())]
            for name, arms in result["cases"].items()
            for who, numbers in arms.items()
        ]
        header = ["case", "arm follows"]
        header += list(next(iter(next(iter(result["cases"].values())).values())))
        parts.append(f"**{result['robot']}**\n\n{markdown_table(header, rows)}")
        parts.extend(f"Not measured: {reason}" for reason in result["missing"])
    return "\n\n".join(parts)


def main(arguments: list[str] | None = None) -> None:
    """Measure and report."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.press", description=__doc__.split("\n")[0])
    parser.add_argument("--robots", nargs="+", default=["panda", "ur5", "iiwa"])
    parser.add_argument("--rate", type=float, default=500.0, help="control rate in Hz (default 500)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each case (default 10)")
    parser.add_argument("--output", type=Path, metavar="DIR", help="where press.json and press.md go")
    o = parser.parse_args(arguments)
    results = [measure(load_robot(name), o.rate, o.seconds) for name in o.robots]
    command = "python -m benchmarks.press " + " ".join(sys.argv[1:] if arguments is None else arguments)
    save(o.output, "press", {"results": results}, report(results, o.seconds), command.strip())


if __name__ == "__main__":
    main()
