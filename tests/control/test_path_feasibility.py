"""What a straight way to a grasp and up from there holds in store, and which one is taken."""

from types import SimpleNamespace

import numpy as np
import pytest

from optsc.control.approach import Approach
from optsc.control.path_feasibility import PathFeasibility, grasp_path, grasp_path_feasibility, most_feasible
from optsc.geometry import Pose
from optsc.robot import load_robot
from optsc.testing.loop import Loop, scene

DOWN = np.array([0.0, 1.0, 0.0, 0.0])
SEVERAL = scene({"thing": (0.5, 0.0, 0.15)})


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def target(p, candidate=3):
    X_WG = Pose(DOWN, np.asarray(p, dtype=float))
    return SimpleNamespace(candidate=candidate, X_WG=X_WG, X_WP=Pose(DOWN, X_WG.translation + [0.0, 0.0, 0.1]))


def ahead(robot, p, clear=None, **settings):
    home = robot.home
    return grasp_path_feasibility(robot, Approach(**settings), home, robot.forward(home), target(p), SEVERAL, clear)


def test_a_free_way_comes_first_and_none_comes_of_ways_that_are_infeasible():
    free, limited, colliding, infeasible = PathFeasibility
    for found, best in (
        ([infeasible, colliding, limited, free, free], 3),
        ([colliding, limited, colliding, limited], 1),
        ([infeasible, colliding, colliding], 1),
        ([infeasible, infeasible], None),
        ([], None),
    ):
        assert most_feasible(range(len(found)), found.__getitem__) == best


def test_what_comes_after_a_free_way_is_not_looked_at():
    looked = []
    most_feasible([1, 2, 3], lambda item: looked.append(item) or PathFeasibility.FREE)
    assert looked == [1]


def test_the_lift_belongs_to_the_way():
    one = target([0.5, 0.1, 0.2])
    _, before, at, up = grasp_path(Approach(lift=0.12), Pose.identity(), one.X_WP, one.X_WG)
    assert (before, at) == (one.X_WP, one.X_WG)
    np.testing.assert_allclose(up.translation - at.translation, [0.0, 0.0, 0.12])
    np.testing.assert_array_equal(up.quaternion, at.quaternion)


def test_a_grasp_from_which_the_arm_cannot_lift_is_infeasible(robot):
    assert ahead(robot, [0.5, 0.0, 0.15]) is PathFeasibility.FREE
    assert ahead(robot, [0.5, 0.0, 0.15], lift=2.0) is PathFeasibility.INFEASIBLE
    assert ahead(robot, [1.5, 0.0, 0.15]) is PathFeasibility.INFEASIBLE


def test_a_way_is_limited_where_a_joint_comes_near_its_greatest_speed(robot):
    found = [ahead(robot, [0.5, 0.0, 0.15], speed=v, angular_speed=5.0 * v) for v in (0.1, 0.7, 2.0)]
    assert found == [PathFeasibility.FREE, PathFeasibility.SPEED_LIMITED, PathFeasibility.INFEASIBLE]


def test_up_to_the_pregrasp_nothing_may_be_touched_and_then_nothing_but_the_object(robot):
    """The check is asked about whole ways: to the pre-grasp, and from there to the grasp and up."""
    asked = []

    def clear(q_grasp, q_pregrasp, candidates):
        asked.append((robot.forward(q_grasp), robot.forward(q_pregrasp), candidates))
        return np.ones(len(q_grasp), dtype=bool)

    assert ahead(robot, [0.5, 0.0, 0.15], clear) is PathFeasibility.FREE
    ((at, before, candidates),) = asked
    assert len(at) == len(before) == len(candidates)
    assert set(candidates.grasp_index.tolist()) == {3}
    np.testing.assert_allclose(before.translation[-1], [0.5, 0.0, 0.25], atol=1e-3)
    assert at.translation[:, 2].min() == pytest.approx(0.15, abs=1e-3)
    assert at.translation[:, 2].max() == pytest.approx(0.30, abs=1e-3)
    for way in (before, at):
        steps = np.linalg.norm(np.diff(way.translation, axis=0), axis=1)
        assert steps.max() < 0.02


@pytest.mark.parametrize("leg", ["q_grasp", "q_pregrasp"])
def test_a_single_posture_that_touches_makes_the_way_a_colliding_one(robot, leg):
    def clear(q_grasp, q_pregrasp, candidates):
        heights = robot.forward({"q_grasp": q_grasp, "q_pregrasp": q_pregrasp}[leg]).translation[:, 2]
        return ~((heights > 0.24) & (heights < 0.27))

    assert ahead(robot, [0.5, 0.0, 0.15], clear) is PathFeasibility.COLLIDING


def test_the_controller_takes_a_worse_grasp_whose_way_is_free(robot):
    """The way to the best one is said to touch something."""
    start = Loop(robot, SEVERAL)
    start.go(0.1)
    first = start.press().target

    def clear(q_grasp, q_pregrasp, candidates):
        return candidates.grasp_index != first.grasp_index

    loop = Loop(robot, SEVERAL)
    loop.go(0.1)
    # Only the look ahead hears of it: in the table of what can be reached the grasp stays the best one.
    state = loop.controller.state
    loop.controller.state = state._replace(choice=state.choice._replace(clear=clear))
    assert loop.press().target.grasp_index != first.grasp_index
