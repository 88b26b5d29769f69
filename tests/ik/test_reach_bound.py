"""Bound of the reach: what it excludes has no configuration, and it excludes most of what is too far away."""

import numpy as np
import pytest

from optsc.geometry import Pose, rotation
from optsc.ik.batch import solve_ik
from optsc.ik.reach_bound import ReachBound
from optsc.robot import ROBOT_NAMES, load_robot, model_from_urdf

JOINT = """
  <joint name="j{i}" type="{kind}">
    <parent link="l{i}"/><child link="l{next}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
    <limit lower="-0.4" upper="0.3" velocity="1" effort="1"/>
  </joint>"""


def random_arm(folder, seed):
    """An arm of joints in arbitrary directions, some of which slide."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 8))
    words = [" ".join(map(repr, row)) for row in rng.uniform(-0.4, 0.4, (n + 1, 3)).tolist()]
    joints = []
    for i in range(n):
        axis = rng.normal(size=3)
        joints.append(
            JOINT.format(
                i=i,
                next=i + 1,
                kind="prismatic" if rng.random() < 0.2 else "continuous",
                xyz=words[i],
                rpy=" ".join(map(repr, rng.uniform(-3, 3, 3).tolist())),
                axis=" ".join(map(repr, (axis / np.linalg.norm(axis)).tolist())),
            )
        )
    links = "".join(f'<link name="l{i}"/>' for i in range(n + 1)) + '<link name="tool"/>'
    tip = f'<joint name="tip" type="fixed"><parent link="l{n}"/><child link="tool"/><origin xyz="{words[n]}"/></joint>'
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="random">{links}{"".join(joints)}{tip}</robot>')
    return model_from_urdf(path, "tool")


def excluded(robot, q):
    X_WT = robot.forward(q)
    return ReachBound.of(robot).excludes(X_WT.quaternion, X_WT.translation)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_no_pose_of_a_configuration_is_excluded_within_limits_and_beyond(name):
    robot = load_robot(name)
    assert not excluded(robot, np.random.default_rng(0).uniform(-np.pi, np.pi, (20000, robot.n))).any()


@pytest.mark.parametrize("seed", range(12))
def test_no_pose_of_an_arm_of_any_kind_is_excluded(seed, tmp_path):
    robot = random_arm(tmp_path, seed)
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (20000, robot.n))
    assert not excluded(robot, np.where(robot.chain.slides, robot.limits.clip(q), q)).any()


def test_an_offset_elbow_does_not_reach_as_far_as_its_links_add_up_to():
    robot, rng = load_robot("panda"), np.random.default_rng(1)
    bound, lengths = ReachBound.of(robot), np.linalg.norm(robot.chain.translation[1:], axis=1)
    assert bound.radius < lengths.sum() - 0.05
    # The wrist comes as far as the bound says: stretched, with the elbow where its two offsets add up least.
    q = rng.uniform(-np.pi, np.pi, (20000, 7))
    X_WT = robot.forward(q)
    wrist = X_WT.apply(np.broadcast_to(bound.last, (20000, 3)))
    assert np.linalg.norm(wrist - bound.centre, axis=1).max() > bound.radius - 0.03


def test_most_poses_that_are_too_far_away_are_excluded_without_a_search():
    robot, rng = load_robot("panda"), np.random.default_rng(2)
    down = rotation.multiply(rotation.exp(rng.uniform(-0.3, 0.3, (200, 3))), np.array([0.0, 1.0, 0.0, 0.0]))
    angle, distance = rng.uniform(-1.0, 1.0, 200), rng.uniform(0.6, 0.9, 200)
    p = np.stack([distance * np.cos(angle), distance * np.sin(angle), rng.uniform(0.1, 0.3, 200)], axis=1)
    solutions = solve_ik(robot, Pose(down, p))
    out = solutions.reason == "out of reach"
    assert out.sum() > 30
    at_once = ReachBound.of(robot).excludes(down, p)
    assert not (at_once & ~out).any()
    assert at_once.sum() > 0.8 * out.sum()
