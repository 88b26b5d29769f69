from __future__ import annotations

from functools import lru_cache

import numpy as np
import pinocchio
import pytest

from optsc.collision import CollisionModel
from optsc.errors import DamagedFile, InvalidValue
from optsc.geometry import Pose, TriangleMesh
from optsc.robot import ROBOT_NAMES, load_robot, model_from_urdf

FAR = Pose.from_translation([0.0, 0.0, 5.0])


@lru_cache
def arm(name="panda"):
    return CollisionModel(load_robot(name))


def box(x, y, z):
    """A box of these extents [m] around the origin."""
    corners = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return TriangleMesh(corners * [x, y, z], np.array(faces))


def at_tool(model, p=(0.0, 0.0, 0.0)):
    """A pose at the tool of the home configuration, moved by p in the tool frame."""
    return model.robot.forward(model.robot.home) @ Pose.from_translation(p)


def hand_links(model):
    return tuple(dict.fromkeys(model.shapes.links[i] for i in sorted(model.shapes.hand)))


def near_home(model, rng, count, spread=0.6):
    robot = model.robot
    return robot.limits.clip(robot.home + rng.normal(size=(count, robot.n)) * spread)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_every_robot_of_the_catalogue_is_clear_at_home(name):
    model = arm(name)
    found = model.clear(model.robot.home[None])
    assert found.clear.tolist() == [True]
    assert found.reason.tolist() == [""]
    assert hand_links(model) == ("panda_hand", "panda_leftfinger", "panda_rightfinger")


def lowest_points(model, q):
    """The height (N,) [m] of the lowest vertex of any link that moves, by forward kinematics alone."""
    urdf = str(model.robot.urdf)
    full = pinocchio.buildModelFromUrdf(urdf)
    shapes = pinocchio.buildGeomFromUrdf(full, urdf, pinocchio.GeometryType.COLLISION)
    data, placed = full.createData(), shapes.createData()
    moving = [k for k, g in enumerate(shapes.geometryObjects) if g.parentJoint != 0]
    corners = {k: vertices_of(shapes.geometryObjects[k].geometry) for k in moving}
    lowest = []
    for configuration in q:
        opened = np.concatenate([configuration, [0.04, 0.04]])
        pinocchio.updateGeometryPlacements(full, data, shapes, placed, opened)
        places = [(placed.oMg[k].rotation[2], placed.oMg[k].translation[2], corners[k]) for k in moving]
        lowest.append(min((v @ row).min() + z for row, z, v in places))
    return np.array(lowest)


def vertices_of(shape):
    if hasattr(shape, "halfSide"):
        return np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * shape.halfSide
    return shape.vertices()


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_table_is_touched_just_when_a_moving_link_reaches_below_it(name):
    model = arm(name)
    q = near_home(model, np.random.default_rng(1), 200, spread=1.0)
    touches = np.array(["touches table" in reason for reason in model.clear(q).reason])
    assert np.array_equal(touches, lowest_points(model, q) < 0.0)
    assert 3 <= touches.sum() <= 100


def test_a_margin_to_the_table_is_a_higher_table():
    model = arm("ur5")
    q = near_home(model, np.random.default_rng(3), 200, spread=1.0)
    higher = model.clear(q, table_height=0.02).clear
    assert np.array_equal(model.clear(q, margin=0.02).clear, higher)
    assert not np.array_equal(model.clear(q).clear, higher)


def test_without_a_table_nothing_touches_it():
    model = arm()
    low = np.array([[0.0, 1.5, 0.0, -0.5, 0.0, 1.5, 0.8]])
    assert "touches table" in model.clear(low).reason[0]
    assert model.clear(low, table_height=None).clear[0]
    assert model.clear(low, table_height=-0.5).clear[0]


def test_an_obstacle_is_touched_where_it_is_and_named():
    model = arm()
    cube = box(0.05, 0.05, 0.05)
    home = model.robot.home[None]
    hit = model.clear(home, {"far": (cube, FAR), "cup": (cube, at_tool(model, (0.0, 0.0, -0.06)))})
    assert not hit.clear[0]
    assert hit.reason[0].endswith("touches cup")
    assert model.clear(home, {"far": (cube, FAR)}).clear[0]


def test_the_margin_is_the_distance_that_is_kept():
    model = arm()
    # The finger tips end 9.5 mm in front of the tool's origin.
    plate = box(0.3, 0.3, 0.02)
    home = model.robot.home[None]
    for gap, margin, clear in ((0.004, 0.0, True), (0.004, 0.003, True), (0.004, 0.006, False)):
        X_WO = at_tool(model, (0.0, 0.0, 0.0095 + 0.01 + gap))
        assert model.clear(home, {"plate": (plate, X_WO)}, margin=margin).clear[0] == clear


def test_a_hollow_thing_made_of_parts_lets_the_hand_in_and_its_hull_does_not():
    model = arm()
    wall = box(0.02, 0.3, 0.02)
    sides = np.array([[-0.08, 0.0, 0.0], [0.08, 0.0, 0.0]])
    walls = tuple(TriangleMesh(wall.vertices + side, wall.faces) for side in sides)
    both = np.concatenate([w.vertices for w in walls])
    faces = np.concatenate([walls[0].faces, walls[1].faces + len(walls[0].vertices)])
    home = model.robot.home[None]
    assert model.clear(home, {"frame": (walls, at_tool(model))}).clear[0]
    assert not model.clear(home, {"frame": (TriangleMesh(both, faces), at_tool(model))}).clear[0]


def test_the_jaws_stand_where_the_opening_says():
    model = arm()
    held = {"block": (box(0.01, 0.06, 0.01), at_tool(model))}
    scene = model.scene(held)
    home = np.tile(model.robot.home, (3, 1))
    assert scene.clear(home, opening=[0.08, 0.062, 0.05]).clear.tolist() == [True, True, False]
    assert scene.clear(home[:1]).clear[0]
    with pytest.raises(InvalidValue, match="opening"):
        scene.clear(home, opening=0.09)


def test_the_hand_may_touch_what_it_grasps_and_nothing_else_and_the_arm_not_even_that():
    model = arm()
    home = np.tile(model.robot.home, (4, 1))
    cube = box(0.05, 0.05, 0.05)
    scene = model.scene({"cup": (cube, at_tool(model, (0.0, 0.0, -0.03)))})
    targets = ["cup", None, "can", "cup"]
    assert scene.clear(home, hand_may_touch=targets).clear.tolist() == [True, False, False, True]
    wrist = model.scene({"cup": (cube, at_tool(model, (0.0, 0.0, -0.20)))})
    assert wrist.clear(home[:1], hand_may_touch=["cup"]).clear.tolist() == [False]
    # A permission holds for its own configuration only.
    assert scene.clear(home[:1]).clear.tolist() == [False]


def test_a_batch_gives_what_its_configurations_give_one_by_one():
    model = arm("ur5")
    rng = np.random.default_rng(2)
    cube = box(0.1, 0.1, 0.2)
    X_WO = {"a": Pose.from_translation([0.5, 0.1, 0.1]), "b": Pose.from_translation([0.4, -0.2, 0.1])}
    scene = model.scene({name: (cube, X) for name, X in X_WO.items()}, margin=0.01)
    q = near_home(model, rng, 80)
    targets = [("a", "b", None)[k] for k in rng.integers(0, 3, len(q))]
    together = scene.clear(q, hand_may_touch=targets)
    for k in range(len(q)):
        alone = scene.clear(q[k : k + 1], hand_may_touch=targets[k : k + 1])
        assert alone.clear[0] == together.clear[k] == (together.reason[k] == "")
    assert 5 < together.clear.sum() < 75


def test_links_that_fold_onto_each_other_are_found():
    model = arm()
    folded = np.array([0.0, 1.0, 0.0, -3.0, 0.0, 0.2, 0.8])
    found = model.clear(folded[None], table_height=None)
    assert not found.clear[0]
    assert "touches panda_" in found.reason[0]


def test_neighbours_and_the_parts_of_the_hand_are_not_checked_against_each_other():
    model = arm()
    pairs = {frozenset(pair) for pair in model.self_pairs}
    assert frozenset(("panda_link3", "panda_link4")) not in pairs
    assert frozenset(("panda_link7", "panda_hand")) not in pairs
    assert frozenset(("panda_leftfinger", "panda_rightfinger")) not in pairs
    assert frozenset(("panda_link0", "panda_hand")) in pairs
    assert model.clear(model.robot.home[None], opening=0.0).clear[0]


def test_bent_links_are_compared_as_they_are_not_as_their_hulls():
    # The hulls of links 5 and 7 of the iiwa overlap over much of joint 6, the links never do.
    model = arm("iiwa")
    q = np.tile(model.robot.home, (40, 1))
    q[:, 5] = np.linspace(model.robot.limits.lower[5], model.robot.limits.upper[5], 40)
    reasons = model.clear(q, table_height=None).reason
    assert not any("link_5 touches lbr_iiwa_link_7" in reason for reason in reasons)


def test_a_scene_can_be_made_again_while_its_objects_move():
    model = arm()
    cube = box(0.1, 0.1, 0.1)
    home = model.robot.home[None]
    clear = [model.clear(home, {"cup": (cube, X)}).clear[0] for X in (FAR, at_tool(model), FAR)]
    assert clear == [True, False, True]


@pytest.mark.parametrize(
    ("settings", "field"),
    [
        ({"margin": -0.01}, "margin"),
        ({"margin": float("nan")}, "margin"),
        ({"obstacles": {"table": (box(1, 1, 1), FAR)}}, "obstacle name"),
        ({"obstacles": {"sheet": (box(1, 1, 0), FAR)}}, "a part of sheet"),
    ],
)
def test_a_scene_that_makes_no_sense_is_refused(settings, field):
    with pytest.raises(InvalidValue, match=field):
        arm().scene(**settings)


def test_configurations_that_make_no_sense_are_refused():
    scene = arm().scene()
    with pytest.raises(InvalidValue, match="q"):
        scene.clear(np.full((1, 7), np.nan))
    with pytest.raises(InvalidValue, match="hand_may_touch"):
        scene.clear(arm().robot.home[None], hand_may_touch=["a", "b"])


PENDULUM = """<robot name="pendulum">
<link name="base"/><link name="rod"><collision><origin xyz="0 0 0.5"/><geometry>
<box size="0.02 0.02 1"/></geometry></collision></link><link name="tip"/>
<joint name="swing" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<origin xyz="0 0 0.3"/><limit effort="1" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="rod"/><child link="tip"/><origin xyz="0 0 1"/></joint></robot>"""


def test_a_joint_that_turns_endlessly_is_placed_by_its_angle(tmp_path):
    path = tmp_path / "pendulum.urdf"
    path.write_text(PENDULUM)
    model = CollisionModel(model_from_urdf(path, "tip"))
    angles = np.array([[0.0], [1.5], [2.0], [np.pi], [2 * np.pi + 0.1]])
    assert model.clear(angles).clear.tolist() == [True, True, False, False, True]
    assert hand_links(model) == ()


def test_a_missing_collision_mesh_is_named(tmp_path):
    path = tmp_path / "broken.urdf"
    path.write_text(PENDULUM.replace('<box size="0.02 0.02 1"/>', '<mesh filename="gone.stl"/>'))
    with pytest.raises(DamagedFile, match=r"broken\.urdf"):
        CollisionModel(model_from_urdf(path, "tip"))
