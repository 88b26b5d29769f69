"""Clearances of capsules: against the bodies themselves, and that they never call a configuration clear that is not."""

from functools import lru_cache

import coal
import numpy as np
import pinocchio
import pytest

from optsc.collision import CollisionModel, GraspClearance
from optsc.collision.capsules import link_capsules
from optsc.collision.clearance import HORIZON, SAFE, level, level_ends, self_pairs
from optsc.collision.kernels.capsules import capsule_ends
from optsc.collision.kernels.clearance import between_capsules, to_box
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.grasps import Candidates
from optsc.kernels import compiler
from optsc.robot import ROBOT_NAMES, load_robot


def cuboid(x, y, z):
    corners = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return TriangleMesh(corners * [x, y, z], np.array(faces))


BLOCKS = {
    "block": (cuboid(0.1, 0.2, 0.15), Pose.from_quaternion(rotation.exp([0.2, -0.4, 0.6]), [0.45, 0.1, 0.3])),
    "post": (cuboid(0.05, 0.05, 0.4), Pose.from_translation([0.3, -0.35, 0.2])),
}


@lru_cache
def collisions(name):
    return CollisionModel(load_robot(name))


def scene_of(name, margin=0.0):
    return collisions(name).scene(BLOCKS, 0.0, margin)


def configurations(name, count, seed=0):
    return load_robot(name).random_configuration(np.random.default_rng(seed), (count,))


def segment_distance(a, b, c, d, count=60):
    """The distance of two segments by ever finer grids."""
    low, high = np.zeros(2), np.ones(2)
    for _ in range(7):
        s, t = (np.linspace(low[k], high[k], count) for k in (0, 1))
        p, r = a + s[:, None] * (b - a), c + t[:, None] * (d - c)
        grid = np.linalg.norm(p[:, None] - r[None], axis=2)
        i, j = np.unravel_index(grid.argmin(), grid.shape)
        step = 2 * (high - low) / (count - 1)
        low, high = np.maximum([s[i], t[j]] - step, 0), np.minimum([s[i], t[j]] + step, 1)
    return grid.min()


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("hulls", [False, True])
def test_capsules_are_where_pinocchio_puts_their_joints(name, hulls):
    robot = load_robot(name)
    capsules = link_capsules(robot, hulls)
    place, data = capsule_ends(robot.chain, capsules), robot.model.createData()
    for q in configurations(name, 10):
        pinocchio.forwardKinematics(robot.model, data, q)
        frames = [data.oMi[int(joint) + 1] for joint in capsules.joint]
        expected = [np.r_[X.act(a), X.act(b)] for X, (a, b) in zip(frames, capsules.ends, strict=True)]
        np.testing.assert_allclose(place(q).full().T, expected, atol=1e-13)


def test_the_distance_of_two_capsules_is_that_of_their_segments_less_both_radii():
    rng, distance = np.random.default_rng(1), between_capsules()
    for k in range(60):
        a, b, c, d = rng.normal(size=(4, 3))
        if k % 3 == 0:
            d = c + rng.normal() * (b - a) + 1e-9 * rng.normal(size=3)  # parallel
        if k % 5 == 0:
            b = a  # a ball
        found = float(distance(np.r_[a, b], np.r_[c, d], 0.1))
        assert found == pytest.approx(segment_distance(a, b, c, d) - 0.1, abs=1e-6)


def test_the_distance_of_a_capsule_from_a_box_is_that_of_coal():
    rng, distance, met = np.random.default_rng(2), to_box(), 0
    for _ in range(200):
        X, half, ends = (
            Pose(rotation.random(rng), rng.normal(size=3) * 0.3),
            rng.uniform(0.02, 0.3, 3),
            rng.normal(size=(2, 3)) * 0.4,
        )
        box = np.r_[X.rotation_matrix().T.ravel(), X.translation, half]
        found = float(distance(ends.ravel(), 0.05, box))
        length = np.linalg.norm(ends[1] - ends[0])
        turn = pinocchio.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (ends[1] - ends[0]) / length).matrix()
        capsule = coal.Transform3s(turn, ends.mean(axis=0))
        at = coal.Transform3s(X.rotation_matrix(), X.translation)
        truth = coal.distance(
            coal.Capsule(0.05, float(length)),
            capsule,
            coal.Box(*(2 * half)),
            at,
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
        if truth > -0.04:
            assert found == pytest.approx(truth, abs=1e-5)
        else:
            met += 1
            assert found == pytest.approx(-0.05, abs=1e-5) or found < -0.03
    assert met > 10


def exact(scene):
    """The same scene without the check of its capsules."""
    scene.certainly_clear = lambda q, allowed: (np.zeros(len(q), dtype=bool),) * 2
    return scene


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_check_of_the_capsules_never_changes_what_the_exact_check_says(name):
    q = configurations(name, 400, seed=3)
    touch = [("block", None, "post")[k % 3] for k in range(len(q))]
    for margin in (0.03, 0.0):
        quick, slow = scene_of(name, margin), exact(scene_of(name, margin))
        for arguments in ({}, {"hand_may_touch": touch}):
            found, truth = quick.clear(q, **arguments), slow.clear(q, **arguments)
            assert np.array_equal(found.clear, truth.clear)
            assert np.array_equal(found.reason, truth.reason)
    assert 10 < truth.clear.sum() < 390


@pytest.mark.skipif(compiler() is None, reason="only compiled capsules are checked first")
@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_most_configurations_that_are_clear_of_the_world_need_no_exact_check(name):
    q = configurations(name, 400, seed=4)
    scene = scene_of(name)
    world, own = scene.certainly_clear(q, np.full(len(q), ""))
    clear = scene.clear(q).clear
    assert world[clear].mean() > 0.7
    assert not (world & own & ~clear).any()


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_clearance_is_never_more_than_the_distance_of_the_bodies(name):
    scene = scene_of(name)
    arm, data = scene._arm, scene._geometry.createData()
    robot = load_robot(name)
    # What turns about the vertical alone is always at the same height over the table, and so is a shoulder.
    turning = {link_capsules(robot, True).link[k] for k in np.flatnonzero(level_ends(robot).any(axis=1))}
    tight = 0
    for q in configurations(name, 25, seed=5):
        found = scene.capsules.measure(q[None])
        full = arm.shapes.configurations(q[None])[0]
        pinocchio.updateGeometryPlacements(arm.shapes.model, arm.shapes.model.createData(), scene._geometry, data, full)
        truth = HORIZON
        for pair, reason in zip(scene._geometry.collisionPairs, scene._checker.reasons, strict=False):
            if reason.endswith("touches table") and reason.split()[0] in turning:
                continue
            shapes = [scene._geometry.geometryObjects[k].geometry for k in (pair.first, pair.second)]
            at = [coal.Transform3s(data.oMg[k].rotation, data.oMg[k].translation) for k in (pair.first, pair.second)]
            result = coal.distance(shapes[0], at[0], shapes[1], at[1], coal.DistanceRequest(), coal.DistanceResult())
            truth = min(truth, result)
        assert found.world[0] <= max(truth, 0.0) + 1e-6 or found.world[0] == HORIZON == truth
        tight += found.world[0] > truth - 0.05
    assert tight > 12


def test_clearances_are_cut_off_at_the_horizon_and_agree_below_it():
    q, scene = configurations("panda", 60, seed=6), scene_of("panda")
    near, far = scene.capsules.measure(q, None, 0.05), scene.capsules.measure(q, None, 0.2)
    for short, long in zip(near, far, strict=True):
        assert short.max() <= 0.05
        np.testing.assert_allclose(short, np.minimum(long, 0.05), atol=1e-12)


def test_what_the_hand_may_touch_is_not_in_its_way_but_in_that_of_the_arm():
    scene, q = scene_of("panda"), configurations("panda", 300, seed=7)
    allowed = scene.capsules.measure(q, np.full(len(q), "block"))
    asked = scene.capsules.measure(q)
    assert np.all(allowed.world >= asked.world)
    assert np.any(allowed.world > asked.world + 0.01)
    assert np.array_equal(scene.capsules.measure(q, np.full(len(q), "no such thing")).world, asked.world)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_links_that_turn_about_the_vertical_alone_stay_at_their_height(name):
    robot = load_robot(name)
    capsules = link_capsules(robot, True)
    assert {capsules.link[k] for k in level(robot)} == {
        link for link, joint in zip(capsules.link, capsules.joint, strict=True) if joint == 0
    }


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_clearance_from_the_world_tells_configurations_apart(name):
    world = scene_of(name).capsules.measure(configurations(name, 200, seed=8)).world
    assert np.ptp(world) > 0.1


def test_a_table_as_high_as_the_shoulder_is_touched_by_it():
    scene = collisions("ur5").scene({}, 0.1)
    assert not scene._level_links_clear
    assert not scene.clear(load_robot("ur5").home[None]).clear[0]


def test_links_built_close_together_tell_nothing_and_touching_ones_are_left_to_the_exact_check():
    for name in ROBOT_NAMES:
        pairs = self_pairs(load_robot(name), collisions(name).capsule_pairs)
        assert len(pairs.informative) > 20
        assert not set(pairs.informative) & set(pairs.close)
    assert self_pairs(load_robot("ur5"), collisions("ur5").capsule_pairs).overlapping
    home = load_robot("panda").home
    assert scene_of("panda").capsules.measure(home[None]).own_close[0] > SAFE


def test_a_scene_of_nothing_has_all_the_clearance_there_is():
    scene = collisions("panda").scene({}, None)
    found = scene.capsules.measure(configurations("panda", 5))
    assert np.all(found.world == HORIZON)
    assert scene.capsules.measure(np.zeros((0, 7))).world.shape == (0,)


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_interpreted_clearances_equal_compiled_ones(monkeypatch):
    q = configurations("panda", 40, seed=8)
    compiled = scene_of("panda").capsules.measure(q)
    monkeypatch.setenv("OPTSC_COMPILER", "none")
    fresh = CollisionModel(load_robot("panda"))
    interpreted = fresh.scene(BLOCKS, 0.0)
    assert not interpreted.capsules.compiled
    for a, b in zip(compiled, interpreted.capsules.measure(q), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-14)
    assert np.array_equal(interpreted.clear(q).clear, scene_of("panda").clear(q).clear)


def test_a_grasp_is_clear_where_both_its_configurations_are_and_without_grasps_nothing_is():
    robot, scene, names = load_robot("panda"), scene_of("panda"), tuple(BLOCKS)
    q = robot.random_configuration(np.random.default_rng(3), (2, 60))
    index = np.arange(60) % len(names)
    opening, numbers = np.full(60, 0.04), np.arange(60)
    candidates = Candidates(names, index, numbers, robot.forward(q[0]), opening, np.ones(60), False)
    at_grasp = scene.clear(q[0], hand_may_touch=[names[k] for k in index]).clear
    at_pregrasp = scene.clear(q[1]).clear
    assert 0 < np.count_nonzero(at_grasp & at_pregrasp) < np.count_nonzero(at_pregrasp) < 60
    clear = GraspClearance(scene)
    np.testing.assert_array_equal(clear(q[0], q[1], candidates), at_grasp & at_pregrasp)
    assert clear(q[0, :0], q[1, :0], candidates.select(numbers[:0])).shape == (0,)
