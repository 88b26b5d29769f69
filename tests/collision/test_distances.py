"""Distances of capsules against the shapes themselves, gradients against differences, and what is left out."""

from functools import lru_cache

import coal
import numpy as np
import pinocchio
import pytest

from optsc.collision import CollisionModel
from optsc.collision.capsule_fit import distance_to_segment
from optsc.collision.capsules import link_capsules
from optsc.collision.distances import DistanceModel
from optsc.collision.kernels.distances import BLEND
from optsc.collision.obstacles import boxes_of
from optsc.errors import InvalidValue, UnknownName
from optsc.geometry import Pose, TriangleMesh, rotation
from optsc.robot import ROBOT_NAMES, load_robot


def cuboid(x, y, z):
    corners = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return TriangleMesh(corners * [x, y, z], np.array(faces))


SIZE = (0.1, 0.2, 0.15)
SOMEWHERE = Pose.from_quaternion(rotation.exp([0.2, -0.4, 0.6]), [0.45, 0.1, 0.3])


@lru_cache
def model(name="panda"):
    return DistanceModel(load_robot(name), {"block": (cuboid(*SIZE), SOMEWHERE)})


def configurations(robot, count, seed=0):
    return robot.random_configuration(np.random.default_rng(seed), (count,))


class Exact:
    """The links' own meshes and distances between them, by coal, with the jaws wherever they are asked to be."""

    def __init__(self, robot):
        path = str(robot.urdf)
        self.full = pinocchio.buildModelFromUrdf(path)
        self.shapes = pinocchio.buildGeomFromUrdf(self.full, path, pinocchio.GeometryType.COLLISION)
        self.data, self.placed = self.full.createData(), self.shapes.createData()
        frames = self.full.frames
        self.links = {}
        for k, shape in enumerate(self.shapes.geometryObjects):
            self.links.setdefault(frames[shape.parentFrame].name, []).append(k)
        self.links["panda_leftfinger"] = self.links["panda_leftfinger"] + self.links["panda_rightfinger"]

    def place(self, q, jaw=0.04):
        pinocchio.updateGeometryPlacements(self.full, self.data, self.shapes, self.placed, np.r_[q, jaw, jaw])

    def shape(self, k):
        X = self.placed.oMg[k]
        return self.shapes.geometryObjects[k].geometry, coal.Transform3s(X.rotation, X.translation)

    def points(self, k):
        shape, X = self.shape(k)
        if isinstance(shape, coal.Box):
            signs = np.array([[i, j, m] for i in (-1, 1) for j in (-1, 1) for m in (-1, 1)])
            return signs * np.ravel(shape.halfSide) @ X.getRotation().T + X.getTranslation()
        return np.asarray(shape.vertices()) @ X.getRotation().T + X.getTranslation()


def apart(shape_a, X_a, shape_b, X_b):
    return coal.distance(shape_a, X_a, shape_b, X_b, coal.DistanceRequest(), coal.DistanceResult())


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_capsules_hold_every_corner_of_their_link_wherever_the_jaws_stand(name):
    robot = load_robot(name)
    capsules, exact = link_capsules(robot), Exact(robot)
    assert set(capsules.link) == set(CollisionModel(robot).links) - {"panda_rightfinger"}
    assert len(capsules.link) <= 24
    data = robot.model.createData()
    for q, jaw in zip(configurations(robot, 4), (0.0, 0.01, 0.025, 0.04), strict=True):
        exact.place(q, jaw)
        pinocchio.forwardKinematics(robot.model, data, q)
        frames = [data.oMi[int(joint) + 1] for joint in capsules.joint]
        for link, shapes in exact.links.items():
            own = [c for c, covered in enumerate(capsules.link) if covered == link]
            for k in shapes if own else []:
                inside = [
                    distance_to_segment(exact.points(k), *(frames[c].act(e) for e in capsules.ends[c]))
                    <= capsules.radius[c] + 1e-7
                    for c in own
                ]
                assert np.any(inside, axis=0).all(), link


def true_distance(exact, pair, X_block):
    own = exact.links[pair.link]
    if pair.other == "table":
        return min(exact.points(k)[:, 2].min() for k in own)
    if pair.other == "block":
        return min(apart(*exact.shape(k), coal.Box(*SIZE), X_block) for k in own)
    return min(apart(*exact.shape(i), *exact.shape(j)) for i in own for j in exact.links[pair.other])


def whole(distances):
    """The pairs of bodies of which every pair of capsules is kept apart: the others touch at home in part."""
    capsules = distances.capsules
    points = np.linalg.norm(capsules.ends[:, 1] - capsules.ends[:, 0], axis=1) <= 1e-3
    of = {link: [c for c, other in enumerate(capsules.link) if other == link] for link in capsules.link}
    for pair in dict.fromkeys(distances.pairs):
        count = len(of[pair.link])
        if pair.other == "table":
            count = sum(2 - points[c] for c in of[pair.link])
        elif pair.other in of:
            count *= len(of[pair.other])
        if pair.other and distances.pairs.count(pair) == count:
            yield pair


@pytest.mark.parametrize(("name", "typical"), [("panda", 0.03), ("ur5", 0.04)])
def test_distances_are_never_more_than_those_of_the_shapes_and_typically_not_much_less(name, typical):
    robot, distances = load_robot(name), model(name)
    exact = Exact(robot)
    X_block = coal.Transform3s(SOMEWHERE.rotation_matrix(), SOMEWHERE.translation)
    index = {pair: [k for k, p in enumerate(distances.pairs) if p == pair] for pair in whole(distances)}
    assert len(index) >= 40
    short = []
    for q in configurations(robot, 12):
        exact.place(q)
        d = distances.distances(q)[0]
        for pair, rows in index.items():
            truth = true_distance(exact, pair, X_block)
            if truth > 0.0:
                short.append(truth - d[rows].min())
    assert np.min(short) >= -1e-6
    assert np.median(short) < typical
    assert np.max(short) < 0.1


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_gradients_equal_differences(name):
    robot, distances = load_robot(name), model(name)
    h = 1e-6
    for q in configurations(robot, 8):
        d, gradient = distances.distances(q)
        some = np.isfinite(d)
        ahead, back = ([distances.distances(q + s * e)[0][some] for e in np.eye(robot.n)] for s in (h, -h))
        numeric = (np.array(ahead) - back).T / (2 * h)
        # Smooth but where a segment runs through a box and another face becomes the nearest one.
        wrong = np.abs(numeric - gradient[some]).max(axis=1) > 1e-5
        assert not wrong[d[some] > -0.02].any()
        assert wrong.mean() < 0.02


def capsule_of(distances, q, link):
    """The first capsule of a link as coal has it: shape and pose."""
    capsules, robot = distances.capsules, distances.robot
    c = capsules.link.index(link)
    data = robot.model.createData()
    pinocchio.forwardKinematics(robot.model, data, q)
    a, b = (data.oMi[int(capsules.joint[c]) + 1].act(e) for e in capsules.ends[c])
    along = (b - a) / np.linalg.norm(b - a)
    turn = pinocchio.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
    return coal.Capsule(float(capsules.radius[c]), float(np.linalg.norm(b - a))), turn, 0.5 * (a + b), c


def test_the_distance_of_a_capsule_from_a_box_is_exact_but_for_the_blending_also_inside():
    distances = DistanceModel(load_robot("panda"), {"block": (cuboid(*SIZE), SOMEWHERE)}, None)
    q, link, rng = distances.robot.home, "panda_link5", np.random.default_rng(1)
    shape, turn, centre, _ = capsule_of(distances, q, link)
    row = distances.pairs.index((link, "block"))
    inside = 0
    for _ in range(300):
        X = Pose.from_quaternion(rotation.random(rng), centre + rng.uniform(-0.2, 0.2, 3))
        distances.move("block", X)
        box = coal.Transform3s(X.rotation_matrix(), X.translation)
        truth = apart(shape, coal.Transform3s(turn, centre), coal.Box(*SIZE), box)
        d = distances.distances(q)[0][row]
        if truth > 0.0:
            assert truth - 2 * BLEND - 1e-9 <= d <= truth + 1e-6
        else:
            inside += 1
            assert d < 0.0
            # Deep inside the distance out is counted to the far side of the blending.
            assert truth - 2 * BLEND <= d <= truth + 0.012
    assert inside > 50


def test_going_along_the_gradient_leads_out_of_any_overlap():
    distances = model()
    distances.move("block", SOMEWHERE)
    rng, left = np.random.default_rng(2), 0
    robot = distances.robot
    for _ in range(40):
        q = robot.random_configuration(rng)
        middle = capsule_of(distances, q, "panda_link5")[2]
        distances.move("block", Pose.from_quaternion(rotation.random(rng), middle))
        row = distances.pairs.index(("panda_link5", "block"))
        start, g = (x[row] for x in distances.distances(q))
        assert np.linalg.norm(g) > 1e-3  # segments that meet still have a direction between them
        step = 1e-3 * g / np.linalg.norm(g)
        left += distances.distances(q + step)[0][row] > start
    distances.move("block", SOMEWHERE)
    assert left >= 38


def test_rows_hold_all_that_can_matter_at_a_tick_and_nothing_else():
    distances = model("ur5")
    distances.settings[2:] = 0.4, 3.0, 0.05, 0.1
    robot, rng = distances.robot, np.random.default_rng(3)
    met = 0
    for q in configurations(robot, 60):
        v = rng.uniform(-1, 1, robot.n) * robot.limits.velocity * rng.random()
        low, high = v - 0.02, v + 0.02
        rows = distances.rows(q, low, high, 1000)
        every = distances.rows(q, -1e6 * np.ones(robot.n), 1e6 * np.ones(robot.n), 1000)
        worst = np.where(every.gradient > 0, low, high)
        matters = np.einsum("ij,ij->i", every.gradient, worst) < every.lower
        assert np.array_equal(rows.pair, every.pair[matters])
        met += len(rows.pair)
        few = distances.rows(q, low, high, 3)
        assert len(few.pair) == min(3, len(rows.pair))
        assert set(few.pair) <= set(rows.pair)
    assert met > 20


def test_what_the_hand_may_touch_is_its_matter_and_not_the_arms():
    distances = model()
    distances.hand_may_touch("block")
    d = distances.distances(distances.robot.home)[0]
    hand = {"panda_hand", "panda_leftfinger"}
    for pair, value in zip(distances.pairs, d, strict=True):
        if pair.other == "block":
            assert np.isinf(value) == (pair.link in hand)
    distances.hand_may_touch()
    with pytest.raises(UnknownName, match="block"):
        distances.hand_may_touch("cup")


def test_neighbours_the_base_over_the_table_and_what_touches_at_home_are_left_out():
    for name in ROBOT_NAMES:
        distances = model(name)
        links = {frozenset(pair) for pair in CollisionModel(distances.robot).self_pairs}
        base = distances.capsules.link[0]
        for pair in distances.pairs:
            if pair.other == "table":
                assert pair.link != base
            elif pair.other not in ("block", ""):
                assert frozenset(pair) in links
        d = distances.distances(distances.robot.home)[0]
        assert d[np.array([pair.other != "block" for pair in distances.pairs])].min() > 0.0


def test_boxes_hold_their_parts_and_keep_things_apart_that_stand_apart():
    rng = np.random.default_rng(4)
    parts = [TriangleMesh(cuboid(0.02, 0.3, 0.02).vertices + [x, 0, 0], cuboid(1, 1, 1).faces) for x in (-0.1, 0.1)]
    R, centre, half = boxes_of(parts, 4, "frame")
    assert len(half) == 2
    assert np.sort(half, axis=1)[0] == pytest.approx([0.01, 0.01, 0.15], abs=1e-9)
    cloud = [TriangleMesh(rng.normal(size=(20, 3)) * 0.05 + x, [[0, 1, 2]]) for x in rng.uniform(-1, 1, (9, 3))]
    R, centre, half = boxes_of(cloud, 3, "cloud")
    assert len(half) <= 3
    for part in cloud:
        local = np.einsum("bji,bvj->bvi", R, part.vertices[None] - centre[:, None])
        assert (np.abs(local) <= half[:, None] + 1e-9).all(axis=(1, 2)).any()


def test_impossible_scenes_and_moves_are_refused():
    robot = load_robot("panda")
    for wrong in ({"margin": -1.0}, {"obstacles": {"table": (cuboid(1, 1, 1), SOMEWHERE)}}, {"boxes": 0}):
        arguments = {"obstacles": {"block": (cuboid(*SIZE), SOMEWHERE)}, **wrong}
        with pytest.raises(InvalidValue):
            DistanceModel(robot, **arguments)
    with pytest.raises(InvalidValue, match="sheet"):
        DistanceModel(robot, {"sheet": (cuboid(1, 1, 0), SOMEWHERE)})
    with pytest.raises(InvalidValue, match="twist"):
        model().move("block", SOMEWHERE, [np.nan] * 6)
    with pytest.raises(UnknownName, match="block"):
        model().move("cup", SOMEWHERE)


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_what_is_skipped_as_too_far_away_could_not_have_mattered(name):
    robot, rng = load_robot(name), np.random.default_rng(5)
    block = cuboid(0.1, 0.2, 0.3), Pose.from_quaternion(rotation.exp([0.2, -0.4, 0.6]), [0.4, 0.1, 0.4])
    model, counted = DistanceModel(robot, {"block": block}), 0
    # The others keep less than the margin.
    roomy = model.distances(robot.home)[0] > 0.02
    for _ in range(150):
        q = robot.random_configuration(rng)
        v = rng.uniform(-1.0, 1.0, robot.n) * robot.limits.velocity * rng.choice([0.02, 0.2, 1.0])
        low, high = v - 0.1, v + 0.1
        found = model.rows(q, low, high, len(model.pairs))
        distance, gradient = model.distances(q)
        # The worst that this tick can do to a distance, however far away it is, against what it may do at most.
        worst = gradient @ (0.5 * (low + high)) - np.abs(gradient) @ (0.5 * (high - low))
        near = np.zeros(len(distance), dtype=bool)
        near[found.pair] = True
        np.testing.assert_array_equal(found.distance, distance[near])
        np.testing.assert_array_equal(found.gradient, gradient[near])
        able = np.minimum(np.abs(gradient) @ robot.limits.acceleration, 1.0)
        spare = np.minimum(distance, 1e3) - 0.01
        allowed = np.sqrt((0.1 * able) ** 2 + 2.0 * able * np.maximum(spare, 0.0)) - 0.1 * able
        moving = (np.abs(gradient).max(axis=1) > 1e-3) & np.isfinite(distance) & (spare > 0.0) & roomy
        np.testing.assert_array_equal((worst < -allowed - 1e-9) & moving, near & moving)
        counted += len(found.pair)
    assert counted > 300
