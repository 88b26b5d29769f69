"""What the hand may touch, and when."""

from types import SimpleNamespace

import numpy as np
import pytest

from optsc.collision import CollisionAvoidance
from optsc.control.mode_entry import touchable
from optsc.control.modes import Mode
from optsc.control.policies import Manual
from optsc.geometry import Pose
from optsc.geometry.mesh import TriangleMesh
from optsc.grasps import Candidates
from optsc.robot import load_robot
from optsc.testing.loop import DOWN, PLACES, Loop, assert_limits_hold, scene

CAN = SimpleNamespace(object_name="can")


def allowed(*ticks):
    """What the hand may touch after each of some ticks: their mode, target and intended object."""
    names, name = [], None
    for mode, target, intended in ticks:
        name = touchable(mode, target, intended, name)
        names.append(name)
    return names


def test_the_hand_may_touch_what_the_robot_grasps_from_the_advance_until_it_sets_out_again():
    before = [(Mode.MANUAL, None, None), (Mode.APPROACH, CAN, None), (Mode.ADJUST, CAN, None)]
    at_it = [(mode, CAN, None) for mode in (Mode.ADVANCE, Mode.CLOSE, Mode.LIFT, Mode.CARRY)]
    after = [(Mode.MANUAL, None, None), (Mode.APPROACH, CAN, None)]
    assert allowed(*before, *at_it, *after) == [None] * 3 + ["can"] * 5 + [None]


def test_where_the_hand_grasps_it_may_touch_the_intended_object():
    ticks = [
        (Mode.MANUAL, None, "mug"),
        (Mode.MANUAL, None, "can"),
        (Mode.CLOSE, None, None),
        (Mode.HOLD, None, None),
    ]
    assert allowed(*ticks) == ["mug", "can", "can", None]


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def box(size):
    """A box with the origin in its centre."""
    s = 0.5 * np.array(size)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * s
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    faces += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    return TriangleMesh(corners, np.array(faces))


@pytest.mark.parametrize("policy", [None, Manual()], ids=["alternating", "manual"])
def test_with_collision_avoidance_the_hand_still_gets_to_its_grasp(robot, policy):
    place = np.array([0.5, 0.0, 0.3])
    one = Candidates(
        object_names=("thing",),
        object_index=np.zeros(1, dtype=int),
        grasp_index=np.zeros(1, dtype=int),
        X_WG=Pose(DOWN[None], place[None]),
        opening=np.full(1, 0.04),
        quality=np.ones(1),
        jaw_symmetric=True,
    )
    obstacle = {"thing": (box((0.04, 0.04, 0.1)), Pose.from_translation(place))}
    avoid = CollisionAvoidance(robot, obstacle, table_height=None)
    loop = Loop(robot, one, avoid=avoid, arbitration=policy)
    loop.go(0.1)
    way = place - loop.tool().translation
    if policy is None:
        loop.press()
        loop.go(6.0)
        assert any(step.mode is Mode.CLOSE for step in loop.steps)
    else:
        loop.go(3.0, move=way)
        loop.go(0.5)
        loop.press()
        assert loop.controller.mode is Mode.CLOSE
    closing = next(step for step in loop.steps if step.mode is Mode.CLOSE)
    assert np.linalg.norm(robot.forward(closing.command.q).translation - place) < 0.005
    assert_limits_hold(robot, loop.steps)


def test_an_object_that_is_no_obstacle_is_no_matter(robot):
    """The hand may touch it anyway."""
    loop = Loop(robot, scene(), avoid=CollisionAvoidance(robot, table_height=None), arbitration=Manual())
    loop.go(0.2)
    assert loop.controller.state.touchable in PLACES
    assert loop.steps[-1].mode is Mode.MANUAL
