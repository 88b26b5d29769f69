"""The selection with real inverse kinematics, manipulability and collision geometry."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from selection_cases import random_hand

from optsc.collision import CollisionModel, GraspClearance
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.grasps import Candidates
from optsc.ik.batch import solve_ik
from optsc.robot import load_robot
from optsc.robot.manipulability import Manipulability
from optsc.selection import GraspSelector

PLACES = {"cube": (0.45, 0.15), "post": (0.5, -0.15)}
HEIGHTS = {"cube": 0.05, "post": 0.12}


def block(x, y, z):
    """A block [m] that stands on the origin."""
    corners = [[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (0.0, 1.0)]
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return TriangleMesh(np.array(corners) * [x, y, z], np.array(faces))


def leaning_grasps(rng, count=40):
    """Grasps of both objects: from above and leaning by up to 110 degrees, some of them through the table."""
    pieces = []
    for name, (x, y) in PLACES.items():
        yaw = rng.uniform(-np.pi, np.pi, count)
        lean = rng.uniform(0.0, np.radians(110.0), count)
        zero = np.zeros(count)
        down = rotation.exp(np.stack([zero + np.pi, zero, zero], axis=-1))
        about_z = rotation.exp(np.stack([zero, zero, yaw], axis=-1))
        about_y = rotation.exp(np.stack([zero, lean, zero], axis=-1))
        q = rotation.multiply(rotation.multiply(about_z, about_y), down)
        pieces.append(Pose(q, np.tile([x, y, 0.8 * HEIGHTS[name]], (count, 1))))
    return Candidates(
        object_names=tuple(PLACES),
        object_index=np.repeat([0, 1], count),
        grasp_index=np.tile(np.arange(count), 2),
        X_WG=Pose.concatenate(pieces),
        opening=np.full(2 * count, 0.04),
        quality=np.ones(2 * count),
        jaw_symmetric=True,
    )


@lru_cache
def observed():
    robot = load_robot("panda")
    candidates = leaning_grasps(np.random.default_rng(61))
    obstacles = {
        name: (block(0.04, 0.04, HEIGHTS[name]), Pose.from_translation([*PLACES[name], 0.0])) for name in PLACES
    }
    scene = CollisionModel(robot).scene(obstacles)
    selector = GraspSelector(robot, solve=lambda X_WT, seeds: solve_ik(robot, X_WT, seeds=seeds))
    table = selector.observe(candidates, robot.home, clear=GraspClearance(scene))
    return robot, scene, selector, table


def test_the_configurations_of_the_table_hold_the_tool_at_grasps_and_pre_grasps():
    robot, _, _, table = observed()
    reached = table.admissible
    assert 20 < reached.sum() < reached.size
    assert robot.forward(table.q_grasp[reached]).almost_equal(table.X_WG[reached], 1e-4)
    assert robot.forward(table.q_pregrasp[reached]).almost_equal(table.X_WP[reached], 1e-4)
    M = Manipulability().evaluate(robot, table.q_grasp[reached])
    assert np.allclose(table.manipulability[reached], M, atol=1e-12)
    assert np.median(M) > 0.01


def test_a_twin_is_reached_by_turning_the_wrist_and_may_be_out_of_reach_where_the_stored_pose_is_not():
    _, _, _, table = observed()
    one, both = table.admissible.any(axis=1), table.admissible.all(axis=1)
    assert 0 < both.sum() < one.sum()


def test_grasps_through_the_table_are_rejected_as_collisions():
    _, _, _, table = observed()
    # The far edges of the palm, well inside the body of the gripper.
    edges = np.array([[x, y, -0.12] for x in (-0.03, 0.03) for y in (-0.09, 0.09)])
    low = (table.X_WG[:, :, None].apply(edges)[..., 2] < 0.0).any(axis=-1)
    assert low.any()
    assert not table.admissible[low].any()
    assert table.rejected("collision")[low].any()


def test_what_is_chosen_is_clear_of_everything_but_the_object_it_grasps():
    robot, scene, selector, _ = observed()
    rng = np.random.default_rng(62)
    for _ in range(10):
        ranking = selector.rank(random_hand(rng), robot.home)
        for name in PLACES:
            target = ranking.target(name)
            assert scene.clear(target.q_pregrasp[None]).clear[0]
            assert scene.clear(target.q[None], hand_may_touch=[name]).clear[0]
            closed = scene.clear(target.q[None], opening=0.035)
            assert closed.reason[0].endswith(f"finger touches {name}")


def test_the_ranking_of_a_moving_arm_is_judged_by_the_configurations_it_would_be_driven_to():
    robot, scene, _, table = observed()
    selector = GraspSelector(robot, solve=lambda X_WT, seeds: solve_ik(robot, X_WT, seeds=seeds))
    selector.use(table, clear=GraspClearance(scene))
    q = robot.limits.clip(robot.home + 0.4)
    ranking = selector.rank(robot.forward(q), q, refresh_limit=100)
    assert not ranking.stale
    for name in PLACES:
        target = ranking.target(name)
        before = solve_ik(robot, target.X_WP[None], seeds=q)
        there = solve_ik(robot, target.X_WG[None], seeds=before.q)
        assert np.allclose(target.q, there.q[0], atol=1e-9)
        assert target.manipulability == pytest.approx(Manipulability().evaluate(robot, there.q[0]))
