"""Rest test of the servo: targets that come in and stay, out of reach or inside obstacles; do the arms come to rest?

Each episode draws a start and a target from a random generator seeded by the seed of the test, the arm, the rule of its
limits and the number of the episode, so that each can be repeated alone. The target comes in smoothly and rests; from
`SETTLE` after that on every joint is watched for `OBSERVE`.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from math import pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optsc.collision import CollisionAvoidance
from optsc.control.servo import Servo, Status
from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.geometry.rotation import Array
from optsc.robot import ROBOT_NAMES, RobotModel, load_robot, urdf

SETTLE, OBSERVE = 2.0, 2.0
"""Time to come to rest, and time of watching after that [s]."""
STANDING = 0.01
"""A joint slower than this [rad/s, m/s] counts as standing."""
LEAST_APPROACH = 2.0
"""How long a target takes to come in at least [s]; longer where the arm is slow."""
RATE = 250.0
"""Control rate [Hz]."""
ON_TARGET = (1e-3, 5e-3)
"""Distance and angle [m, rad] within which, and only within which, the status at rest may be following."""
_CORNERS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=float)
BLOCK = 0.08
"""Half the edge of the cube that a target lies in [m]."""
CLEAR, AWAY = 0.02, np.array([9.0, 9.0, 9.0])
"""Distance that the arm at home has to the cube at least [m]; where the cube is otherwise."""

FOREIGN: dict[str, tuple[tuple[str, ...], str]] = {
    "j2s6s200": (("kinova_description", "robots", "kinova.urdf"), "j2s6s200_end_effector"),
    "ur3": (("ur_description", "urdf", "ur3_robot.urdf"), "tool0"),
    "ur10": (("ur_description", "urdf", "ur10_robot.urdf"), "tool0"),
    "so101": (("so_arm_description", "urdf", "so101.urdf"), "gripper_frame_link"),
    "z1": (("z1_description", "urdf", "z1.urdf"), "link06"),
    "talos_left_arm": (("talos_data", "robots", "talos_left_arm.urdf"), "gripper_left_base_link"),
}
"""Arms that are not of the catalogue: their description among the example descriptions, and their tool frame."""
ARMS = (*ROBOT_NAMES, *FOREIGN)
"""Names of the arms."""


def _ruled(v: Array, rule: str) -> dict[str, ArrayLike]:
    if rule == "default":
        return {"acceleration": v / 0.2, "jerk": v / 0.2 / 0.05}
    return {"acceleration": np.full(len(v), 2.0), "jerk": np.full(len(v), 100.0)}


RULES = ("own", "default", "slow")
"""Limits of acceleration and jerk: the arm's own; those that follow from its velocities; 2 rad/s^2 and 100 rad/s^3."""
KINDS = ("far", "turned", "near", "inside")
"""Targets: beyond reach; at a place that can be reached, turned at random; at the end of reach, turned as at home; and
inside an obstacle or below the table, with avoidance."""


class RestEpisode(NamedTuple):
    """What one episode was and how it ended.

    Attributes:
        arm, rule, kind, number: which it was.
        fastest: the fastest joint while it was watched [rad/s].
        fastest_at_end: the same of the last quarter.
        status, reason: of the last tick.
        distance, angle: of the tool to the target at the end [m, rad].
        status_changes: while it was watched.
    """

    arm: str
    rule: str
    kind: str
    number: int
    fastest: float
    fastest_at_end: float
    status: str
    reason: str
    distance: float
    angle: float
    status_changes: int

    @property
    def at_rest(self) -> bool:
        """Whether every joint stood all the time that it was watched."""
        return self.fastest < STANDING

    @property
    def truthful(self) -> bool:
        """Whether following was said exactly of a tool on its target, and a reason was given otherwise."""
        on_target = self.distance <= ON_TARGET[0] and self.angle <= ON_TARGET[1]
        return (self.status == Status.FOLLOWING.name) == on_target and (on_target or bool(self.reason))


@lru_cache(maxsize=64)
def arm_of(name: str, rule: str) -> RobotModel:
    """Return an arm with limits by a rule; raise `UnknownName`."""
    if name not in ARMS:
        raise UnknownName("arm of the rest test", name, ARMS)
    if rule not in RULES:
        raise UnknownName("rule of limits", rule, RULES)
    source: tuple[str | Path, str | None] = (name, None)
    if name in FOREIGN:
        parts, tip = FOREIGN[name]
        source = (urdf.example_robot_data("example-robot-data", "robots", *parts), tip)
    robot = load_robot(*source)
    return robot if rule == "own" else load_robot(*source, limits=_ruled(robot.limits.velocity, rule))


@lru_cache(maxsize=32)
def _reach(robot: RobotModel) -> float:
    p = robot.forward(robot.random_configuration(np.random.default_rng(0), (500,))).translation
    return float(np.linalg.norm(p, axis=1).max())


def _target(rng: np.random.Generator, robot: RobotModel, kind: str) -> Pose:
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    if kind == "far":
        return Pose(rotation.random(rng), direction * _reach(robot) * rng.uniform(1.0, 1.6))
    if kind == "near":
        return Pose(robot.forward(robot.home).quaternion, direction * _reach(robot) * rng.uniform(0.9, 1.3))
    place = robot.forward(robot.random_configuration(rng)).translation
    if kind == "inside" and rng.random() < 0.5:
        place = place * [1.0, 1.0, 0.0] - [0.0, 0.0, rng.uniform(0.02, 0.2)]
    turned = rng.random() < 0.5 if kind == "inside" else True
    return Pose(rotation.random(rng) if turned else robot.forward(robot.home).quaternion, place)


@lru_cache(maxsize=4)
def _avoiding(robot: RobotModel) -> CollisionAvoidance:
    """Return the avoidance of a table and a cube."""
    height = 0.0
    tool = robot.forward(robot.home).translation[2]
    if tool < 0.1:
        height = float(tool) - 0.15  # an arm that hangs
    cube = TriangleMesh(BLOCK * _CORNERS, np.array([[0, 1, 3]]))
    return CollisionAvoidance(robot, {"cube": (cube, Pose.from_translation(AWAY))}, height)


def _servo(robot: RobotModel, kind: str, target: Pose) -> Servo:
    if kind != "inside":
        return Servo(robot, RATE)
    avoid = _avoiding(robot)
    avoid.move("cube", Pose.from_translation(target.translation))
    distances, _ = avoid.model.distances(robot.home)
    nearest = min(d for d, pair in zip(distances, avoid.model.pairs, strict=True) if pair.other == "cube")
    if nearest < CLEAR:  # no arm can leave a cube that its base is in
        avoid.move("cube", Pose.from_translation(AWAY))
    return Servo(robot, RATE, avoid=avoid)


def _incoming(start: Pose, target: Pose, robot: RobotModel) -> tuple[Callable[[float], Pose], float]:
    """Return the target as a function of time [s], and how long it comes in."""
    turn = rotation.log(rotation.multiply(target.quaternion, rotation.conjugate(start.quaternion)))
    shift = target.translation - start.translation
    slowest = float(robot.limits.velocity.min())
    # No faster than a slow arm may go: what is asked is how it comes to rest, not how it catches up.
    linear = 1.875 * float(np.linalg.norm(shift)) / min(0.5, 0.4 * slowest)
    angular = 1.875 * float(np.linalg.norm(turn)) / min(1.5, 0.5 * slowest)
    duration = max(LEAST_APPROACH, linear, angular)

    def at(time: float) -> Pose:
        s = min(time / duration, 1.0)
        if s == 1.0:
            return target
        s = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        return Pose(rotation.multiply(rotation.exp(s * turn), start.quaternion), start.translation + s * shift)

    return at, duration


def run_episode(seed: int, arm: str, rule: str, number: int) -> RestEpisode:
    """Return how one episode ends: a pure function of the arguments. Raises `UnknownName` for an arm or a rule."""
    robot, kind = arm_of(arm, rule), KINDS[number % len(KINDS)]
    rng = np.random.default_rng([seed, zlib.crc32(f"{arm} {rule}".encode()), number])
    target = _target(rng, robot, kind)
    servo = _servo(robot, kind, target)
    # With things around, a random start would often be inside of them.
    if kind != "inside" and rng.random() < 0.5:
        servo.reset(robot.random_configuration(rng))
    at, duration = _incoming(servo.X_WT, target, robot)
    watched = int(OBSERVE * RATE)
    fastest, statuses = np.zeros(watched), []
    for tick in range(int((duration + SETTLE) * RATE)):
        servo.step(at(tick / RATE), servo.time)
    for tick in range(watched):
        command = servo.step(target, servo.time)
        fastest[tick] = np.abs(command.v).max()
        statuses.append(command.status)
    tool = robot.forward(command.q)
    return RestEpisode(
        arm,
        rule,
        kind,
        number,
        float(fastest.max()),
        float(fastest[-watched // 4 :].max()),
        command.status.name,
        command.reason,
        float(np.linalg.norm(tool.translation - target.translation)),
        min(float(rotation.angle(tool.quaternion, target.quaternion)), pi),
        sum(a is not b for a, b in pairwise(statuses)),
    )


class Rest(NamedTuple):
    """What a rest test has found: all its episodes."""

    seed: int
    episodes: tuple[RestEpisode, ...]

    @property
    def passed(self) -> bool:
        """Whether every arm came to rest and said the truth."""
        return all(e.at_rest and e.truthful for e in self.episodes)

    def summary(self) -> dict[str, Any]:
        """Return counts by arm, rule and kind, and the failures, as plain values for a JSON file."""
        moving = [e for e in self.episodes if not e.at_rest]
        untrue = [e for e in self.episodes if not e.truthful]
        return {
            "seed": self.seed,
            "episodes": len(self.episodes),
            "moving": len(moving),
            "moving_at_end": sum(e.fastest_at_end >= STANDING for e in moving),
            "untrue": len(untrue),
            "moving_by_arm": dict(Counter(f"{e.arm} {e.rule}" for e in moving)),
            "moving_by_kind": dict(Counter(e.kind for e in moving)),
            "statuses": dict(Counter(e.status for e in self.episodes).most_common()),
            "passed": self.passed,
            "failures": [e._asdict() for e in self.episodes if not (e.at_rest and e.truthful)],
        }


def rest(
    count: int,
    *,
    seed: int = 0,
    arms: Sequence[str] = ARMS,
    rules: Sequence[str] = RULES,
    progress: Callable[[int, int], None] | None = None,
) -> Rest:
    """Return ``count`` episodes of every arm by every rule.

    Args:
        count: episodes of each arm and rule; kinds of targets take turns.
        seed: of all episodes.
        arms: names of `ARMS`.
        rules: names of `RULES`.
        progress: called after every episode with how many are done and how many there are.

    Raises `InvalidValue` for a count below one or a negative seed, and `UnknownName` for an arm or a rule.
    """
    if count < 1:
        raise InvalidValue("count", count, "1 or more")
    if seed < 0:
        raise InvalidValue("seed", seed, "0 or more")
    episodes: list[RestEpisode] = []
    for arm in arms:
        for rule in rules:
            for number in range(count):
                episodes.append(run_episode(seed, arm, rule, number))
                if progress is not None:
                    progress(len(episodes), len(arms) * len(rules) * count)
    return Rest(seed, tuple(episodes))
