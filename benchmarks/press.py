"""Whether an arm is calm when it is pressed against what it cannot pass: joint limits, and the end of its reach.

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
from benchmarks.peers import MinkPeer, PinkPeer
from optsc.control.servo import Servo
from optsc.geometry import Pose, rotation
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


class Case(NamedTuple):
    """A target that is not to be reached: its name, and where it is in the end."""

    name: str
    X_WT: Pose


class Arm(Protocol):
    """What follows: takes the newest sample, or None, and gives the velocity (n,) of the next tick [rad/s]."""

    def __call__(self, X_WT: Pose | None) -> np.ndarray: ...


def cases_for(robot: RobotModel) -> list[Case]:
    """Return one case per joint with limits in the middle of the arm, and one behind the reach.

    Cases of a table and of a wall belong here too, beside the servo's rows for distances.
    """
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
    return cases


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


def arms_for(robot: RobotModel, rate: float) -> tuple[dict[str, Callable[[], Arm]], list[str]]:
    """Return what follows, by name, each made anew for each case; and what is not installed here."""

    def servo() -> Arm:
        made = Servo(robot, rate)
        return lambda X: made.step(X).v

    def peer(make: Callable[[], PinkPeer | MinkPeer]) -> Callable[[], Arm]:
        def fresh() -> Arm:
            made = make()
            return lambda X: made.tick(X).v

        return fresh

    peers: dict[str, Callable[[], PinkPeer | MinkPeer]] = {
        "Pink": lambda: PinkPeer(robot, rate),
        "Pink with accelerations": lambda: PinkPeer(robot, rate, accelerations=True),
        "mink": lambda: MinkPeer(robot, rate),
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
        "greatest speed in the last half [%]": 100.0
        * float((np.abs(v[len(v) // 2 :]) / robot.limits.velocity).max()),
    }


def _changes(signs: np.ndarray) -> int:
    moving = signs[signs != 0.0]
    return int(np.count_nonzero(moving[1:] != moving[:-1]))


def measure(robot: RobotModel, rate: float, seconds: float) -> dict[str, Any]:
    """Return all cases of one arm."""
    arms, missing = arms_for(robot, rate)
    found: dict[str, Any] = {"robot": robot.name, "missing": missing, "cases": {}}
    for case in cases_for(robot):
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
