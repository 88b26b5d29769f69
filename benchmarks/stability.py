"""How often the choice changes while the hand rests, without and with hysteresis, and what rest costs.

    python -m benchmarks.stability --scenes 10 --seed 0 --output stability

Three hands, each about many poses near the objects of random scenes:

* still: the stillest half seconds of the recorded hand, scaled as by a clutch, played to and fro, with tracker noise;
* simulated: a resting hand with drift, tremor and tracker noise, as the simulated operator has them;
* moving: the recorded hand as it is, to see the price where it matters.

A switch is a change of the chosen grasp of any object from one ranking to the next. The price is how much worse the
choice is at the hand's true pose than the choice that would be made there, cost by cost, on average.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import optsc
from benchmarks.machine import markdown_table, save
from optsc.demo.demonstration import load_or_build
from optsc.geometry import Pose, rotation
from optsc.operators import HandRecording
from optsc.people.motor import SimulatedHand
from optsc.people.parameters import HumanParameters
from optsc.selection import Cascade, Hysteresis, ManipulabilityLoss, OrientationDistance, PositionDistance
from optsc.sim import tabletop
from optsc.study.episode_setup import true_scene

RATE = 50.0
"""Rankings per second [Hz], as the controller makes them."""
STILL_SAMPLES, STILL_COUNT = 25, 6
"""Length of a still stretch (0.5 s at the recording's rate) and how many of them are taken."""
SCALE = 0.3
"""Of the recorded hand's position and rotation, as a clutch would."""
NOISE = (0.3e-3, np.radians(0.1))
"""Standard deviation of the tracker, for each axis [m, rad]."""
ZONES: dict[str, Hysteresis | None] = {
    "none": None,
    "3 mm, 1 deg": Hysteresis(0.003, np.radians(1.0)),
    "6 mm, 2 deg": Hysteresis(0.006, np.radians(2.0)),
    "10 mm, 4 deg": Hysteresis(0.010, np.radians(4.0)),
    "15 mm, 5.7 deg (default)": Hysteresis(),
}
COSTS = (OrientationDistance(), PositionDistance(), ManipulabilityLoss())


class Tally(NamedTuple):
    """What one hand did to the choice: rankings, switches, runs without any, and the price of each cost."""

    rankings: int
    switches: int
    runs: int
    steady_runs: int
    price: tuple[float, ...]


def motions_of(recording: HandRecording, first: int, count: int) -> list[Pose]:
    """Return the scaled motion relative to its first sample."""
    X = recording.scaled(SCALE, SCALE).X_SH[first : first + count]
    turns = rotation.multiply(X.quaternion, rotation.conjugate(X.quaternion[0]))
    return [Pose(q, p) for q, p in zip(turns, X.translation - X.translation[0], strict=True)]


def stillest(recording: HandRecording) -> list[int]:
    """Return the first samples of the stillest stretches, apart from each other."""
    p = recording.X_SH.translation
    starts = np.arange(len(p) - STILL_SAMPLES)
    extent = np.array([np.linalg.norm(np.ptp(p[i : i + STILL_SAMPLES], axis=0)) for i in starts])
    picked: list[int] = []
    for i in np.argsort(extent, kind="stable"):
        if all(abs(i - j) > STILL_SAMPLES for j in picked):
            picked.append(int(i))
        if len(picked) == STILL_COUNT:
            break
    return picked


def moved(X: Pose, motion: Pose, rng: np.random.Generator, noisy: bool = True) -> Pose:
    """Return X shifted and turned by a motion, as the tracker reports it."""
    noise = rng.standard_normal(6) * np.repeat(NOISE, 3) * noisy
    turn = rotation.multiply(rotation.exp(noise[3:]), motion.quaternion)
    return Pose(rotation.multiply(turn, X.quaternion), X.translation + motion.translation + noise[:3])


def hands(recording: HandRecording, rng: np.random.Generator, seconds: float) -> Iterator[tuple[str, list]]:
    """Yield each hand's name and its motion about a pose, at the rate of rankings."""
    count = int(seconds * RATE)
    for first in stillest(recording):
        there = motions_of(recording, first, STILL_SAMPLES)
        cycle = [*there, *there[-2:0:-1]]
        yield "still", [cycle[k % len(cycle)] for k in range(count)]
    human = HumanParameters()
    hand = SimulatedHand(rng, Pose.identity(), human)
    samples = [hand.advance(None, k / human.sample_rate) for k in range(int(seconds * human.sample_rate))]
    yield "simulated", [samples[int(k * human.sample_rate / RATE)] for k in range(count)]
    first = int(rng.integers(0, len(recording.time) - count))
    yield "moving", motions_of(recording, first, count)


def watched(selector, poses: Sequence[Pose], q, exact) -> tuple[int, np.ndarray]:
    """Return the number of switches over ``poses`` and the sum of each cost's excess over the exact choice."""
    selector.forget()
    switches, excess, last = 0, np.zeros(len(COSTS)), None
    for X in poses:
        chosen = selector.rank(X, q, refresh_limit=0).chosen
        switches += 0 if last is None else sum(chosen[name] != last[name] for name in chosen)
        last = chosen
        exact.forget()
        right = exact.rank(X, q, refresh_limit=0)
        if any(chosen[name] != right.chosen[name] for name in chosen):
            values = [right.cost_of(cost) for cost in COSTS]
            for name, one in chosen.items():
                if one is not None and right.chosen[name] is not None:
                    excess += [v[one] - v[right.chosen[name]] for v in values]
    return switches, excess / max(1, len(last))


def start_poses(table, rng: np.random.Generator, count: int) -> list[Pose]:
    """Return tool poses as a person would bring them: near the pre-grasps of some grasps, but not at them."""
    rows = rng.choice(np.flatnonzero(table.admissible[:, 0]), size=count, replace=False)
    offsets = rng.normal(0.0, 0.03, (count, 3))
    turns = rng.normal(0.0, np.radians(12.0), (count, 3))
    X = table.X_WP[rows, 0]
    return [
        Pose(rotation.multiply(rotation.exp(turn), q), p + offset)
        for q, p, offset, turn in zip(X.quaternion, X.translation, offsets, turns, strict=True)
    ]


def one_scene(robot, seed: int, seconds: float, poses: int, say) -> dict[tuple[str, str], list]:
    """Return per hand and zone what was seen in one scene: rankings, switches and excess of each run."""
    rng = np.random.default_rng(seed)
    world = tabletop(robot, ("mug", "can", "box"), seed=seed)
    library = load_or_build(world, None, say)
    first = optsc.GraspSelector(robot, Cascade.paper())
    candidates, clear = true_scene(world, library)
    table = first.observe(candidates, robot.home, clear=clear)
    recording = HandRecording.example()
    found: dict[tuple[str, str], list] = {}
    for X in start_poses(table, rng, poses):
        for hand, motions in hands(recording, rng, seconds):
            path = [moved(X, motion, rng, noisy=hand != "simulated") for motion in motions]
            for zone, hysteresis in ZONES.items():
                selector = optsc.GraspSelector(robot, Cascade.paper(), hysteresis=hysteresis)
                selector.use(table)
                switches, excess = watched(selector, path, robot.home, first)
                found.setdefault((hand, zone), []).append((len(path), switches, excess))
    return found


def tallied(runs: Sequence[tuple]) -> Tally:
    rankings = sum(count for count, _, _ in runs)
    price = sum(excess for _, _, excess in runs) / rankings
    steady = sum(switches == 0 for _, switches, _ in runs)
    return Tally(rankings, sum(s for _, s, _ in runs), len(runs), steady, tuple(price.tolist()))


def table_of(tallies: dict[tuple[str, str], Tally]) -> str:
    header = [
        "hand",
        "dead zone",
        "switches per minute and object",
        "runs without a switch",
        "price: orientation [-]",
    ]
    header += ["position [mm]", "manipulability [-]"]
    rows = []
    for (hand, zone), tally in tallies.items():
        minutes = tally.rankings / RATE / 60.0
        rows.append(
            [
                hand,
                zone,
                f"{tally.switches / minutes / 3:.2f}",
                f"{tally.steady_runs} of {tally.runs}",
                f"{tally.price[0]:+.4f}",
                f"{1e3 * tally.price[1]:+.2f}",
                f"{-tally.price[2]:+.5f}",
            ]
        )
    return markdown_table(header, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--poses", type=int, default=5, help="poses of the hand in each scene")
    parser.add_argument("--seconds", type=float, default=4.0, help="length of each run [s]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    robot = optsc.load_robot(options.robot)
    found: dict[tuple[str, str], list] = {}
    for scene in range(options.seed, options.seed + options.scenes):
        for key, runs in one_scene(robot, scene, options.seconds, options.poses, lambda text: None).items():
            found.setdefault(key, []).extend(runs)
        print(f"scene {scene} done", file=sys.stderr, flush=True)
    tallies = {key: tallied(runs) for key, runs in sorted(found.items())}
    facts = {"rows": [{"hand": h, "zone": z, **tally._asdict()} for (h, z), tally in tallies.items()]}
    command = "python -m benchmarks.stability " + " ".join(sys.argv[1:])
    save(options.output, "stability", facts, table_of(tallies), command.strip())


if __name__ == "__main__":
    main()
