"""Which object is meant, when the robot begins by itself, and what the trigger does where it grasps."""

import numpy as np
import pytest

from optsc.control.jaws import GripStatus
from optsc.control.modes import Event, Mode
from optsc.control.policies import Automatic, Continuous, Hindsight, LinearBlending, Manual
from optsc.geometry import Pose, rotation
from optsc.operators import Button, OperatorSample
from optsc.robot import load_robot
from optsc.selection.intent import IntentSettings
from optsc.testing.loop import PLACES, Loop, modes, scene


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


TWO = {"left": (0.5, 0.25, 0.15), "right": (0.5, -0.25, 0.15)}


def test_the_belief_says_which_object_is_meant_where_it_is_asked_for(robot):
    """The tool is still nearer to the left thing, but the hand goes away from it."""
    places = {"left": (0.5, 0.1, 0.15), "right": (0.5, -0.4, 0.15)}
    pointing, believing = Loop(robot, scene(places)), Loop(robot, scene(places), intent=IntentSettings())
    for loop in (pointing, believing):
        loop.go(0.1)
        loop.go(1.2, move=(0.0, -0.11, 0.0))
    assert pointing.steps[-1].belief is None
    assert pointing.controller.ranking.best == "left"
    step = believing.steps[-1]
    assert believing.controller.ranking.best == "right"
    assert step.belief["right"] > step.belief["left"]
    assert sum(step.belief.values()) == pytest.approx(1.0)
    assert believing.press().target.object_name == "right"


def test_a_hand_at_rest_or_trembling_or_let_go_says_nothing(robot):
    loop = Loop(robot, scene(TWO), intent=IntentSettings())
    loop.go(0.6, move=(0.0, 0.1, 0.0))
    loop.go(0.1)
    rng, rest = np.random.default_rng(0), loop.hand
    for k in range(60):
        if k == 20:
            # What was left of the motion up to here may still have been told.
            before = loop.steps[-1].belief
        loop.hand = Pose(rest.quaternion, rest.translation + 5e-4 * rng.normal(size=3))
        loop.go(0.01)
    loop.go(0.1, clutch=False)
    loop.go(0.4, move=(0.0, -0.3, 0.0), clutch=False)
    loop.go(0.1)
    assert loop.steps[-1].belief == before


def test_the_robots_own_motion_says_nothing(robot):
    loop = Loop(robot, scene(TWO), arbitration=Hindsight())
    loop.go(0.6, move=(0.0, 0.06, 0.0))
    loop.go(0.1)
    before, at = loop.steps[-1].belief, loop.tool()
    loop.go(0.6)
    assert np.linalg.norm(loop.tool().translation - at.translation) > 0.01
    assert loop.steps[-1].belief == before


def test_a_tracker_that_jumps_says_nothing(robot):
    loop = Loop(robot, scene(TWO), intent=IntentSettings())
    loop.go(0.6, move=(0.0, 0.06, 0.0))
    loop.go(0.1)
    before = loop.steps[-1].belief
    loop.hand = Pose(loop.hand.quaternion, loop.hand.translation + [0.0, 0.5, 0.0])
    loop.go(0.1)
    assert loop.steps[-1].belief == before


def test_the_robot_begins_by_itself_once_the_same_object_has_been_meant_long_enough(robot):
    loop = Loop(robot, scene(TWO), arbitration=Automatic(dwell=0.3))
    loop.go(0.6)
    (begun,) = [step for step in loop.steps if step.event is Event.BEGUN]
    engaged = next(step.time for step in loop.steps if step.event is Event.ENGAGED)
    assert begun.time - engaged == pytest.approx(0.3, abs=0.03)
    assert begun.mode is Mode.APPROACH


def test_who_has_stepped_in_is_not_overruled_but_may_hand_over(robot):
    loop = Loop(robot, scene(TWO), arbitration=Automatic(dwell=0.1))
    loop.go(0.5)
    loop.press()
    loop.go(1.0)
    assert loop.controller.mode is Mode.MANUAL
    loop.press()
    assert loop.controller.mode is Mode.APPROACH


def test_after_a_halt_the_robot_begins_anew_when_the_operator_has_let_it_go_on(robot):
    loop = Loop(robot, scene(TWO), arbitration=Automatic(dwell=0.1))
    loop.go(0.3)
    loop.tick(OperatorSample(loop.time, loop.hand, lost=True))
    loop.go(0.3)
    assert loop.controller.mode is Mode.HOLD
    loop.go(0.02, clutch=False)
    loop.go(1.2)
    assert loop.controller.mode is Mode.APPROACH


def test_what_was_meant_during_a_halt_does_not_count(robot):
    loop = Loop(robot, scene(TWO), arbitration=Automatic(dwell=0.5))
    loop.go(0.2)
    loop.tick(OperatorSample(loop.time, loop.hand, lost=True))
    loop.go(0.8)
    assert loop.controller.mode is Mode.HOLD
    loop.go(0.02, clutch=False)
    halted = len(loop.steps)
    loop.go(1.0)
    resumed = next(step.time for step in loop.steps[halted:] if step.mode is Mode.MANUAL)
    (begun,) = [step.time for step in loop.steps if step.event is Event.BEGUN]
    assert begun - resumed == pytest.approx(0.5, abs=0.03)


def test_with_an_open_clutch_the_robot_does_not_begin(robot):
    loop = Loop(robot, scene(TWO), arbitration=Automatic(dwell=0.1))
    loop.go(0.08)
    loop.go(0.5, clutch=False)
    assert loop.controller.mode is Mode.MANUAL


def test_the_jaws_close_only_near_a_grasp_and_the_reason_says_how_far_it_is(robot):
    loop = Loop(robot, scene(), arbitration=Manual())
    loop.go(0.1)
    assert "mm and" in loop.press().reason
    assert loop.controller.mode is Mode.MANUAL
    anywhere = Loop(robot, scene(), arbitration=Manual(), grasp_within=None)
    anywhere.go(0.1)
    assert anywhere.press().event is Event.GRASPED
    assert anywhere.controller.mode is Mode.CLOSE
    assert anywhere.steps[-1].target is None
    anywhere.go(4.0)
    assert modes(anywhere.steps)[-2:] == ["close", "hold"]
    assert any("closed on nothing" in step.reason for step in anywhere.steps)


def test_the_trigger_opens_jaws_that_are_closed_on_nothing(robot):
    loop = Loop(robot, scene(), arbitration=LinearBlending(), grasp_within=None)
    loop.go(0.1)
    loop.press()
    assert loop.steps[-1].opening == 0.0
    loop.press()
    assert (loop.controller.mode, loop.steps[-1].opening) == (Mode.MANUAL, 0.0)
    loop.go(1.5)
    assert loop.controller.state.jaws.grip is GripStatus.EMPTY
    assert loop.press().reason == "the jaws open"
    assert loop.controller.mode is Mode.MANUAL
    assert loop.steps[-1].opening == robot.gripper.max_opening
    loop.press()
    assert loop.controller.mode is Mode.CLOSE


def test_without_a_scene_every_wish_is_refused_with_a_reason(robot):
    for policy, words in ((None, "there are no grasps"), (Manual(), "there are no grasps")):
        loop = Loop(robot, arbitration=policy)
        loop.go(0.1)
        assert loop.press().reason == words
    loop = Loop(robot, scene({"far": (3.0, 0.0, 0.2)}), arbitration=Manual())
    loop.go(0.1)
    assert loop.press().reason == "no grasp can be reached"


def test_goals_hold_the_nearest_and_the_most_manipulable_grasp_of_every_object(robot):
    loop = Loop(robot, scene(), arbitration=Hindsight())
    loop.go(0.1)
    choice, table = loop.controller.state.choice, loop.controller.selector.table
    assert [goal.name for goal in choice.goals] == sorted(PLACES)
    p, q = (np.array(part) for part in loop.controller.servo.reference)
    for goal in choice.goals:
        k = table.candidates.object_names.index(goal.name)
        rows = (np.asarray(table.candidates.object_index)[:, None] == k) & table.admissible
        places, turns = table.X_WG.translation[rows], table.X_WG.quaternion[rows]
        settings = IntentSettings()
        value = settings.translation.value(np.linalg.norm(places - p, axis=1))
        value = value + settings.rotation.value(rotation.angle(turns, q))
        np.testing.assert_allclose(goal.nearest.p, places[np.argmin(value)], atol=1e-12)
        np.testing.assert_allclose(goal.best.p, places[np.argmax(table.manipulability[rows])], atol=1e-12)


@pytest.mark.parametrize(("policy", "aim"), [(Hindsight(), "nearest"), (Manual(), "nearest"), (Continuous(), "best")])
def test_the_grasp_that_is_shown_is_the_one_that_the_policy_helps_towards(robot, policy, aim):
    loop = Loop(robot, scene(), arbitration=policy)
    loop.go(0.1)
    goals, shown = loop.controller.state.choice.goals, loop.controller.shown
    assert sorted(shown) == [goal.name for goal in goals]
    for goal in goals:
        grasp = getattr(goal, aim)
        np.testing.assert_array_equal(shown[goal.name].translation, grasp.p)
        stored = loop.controller.selector.table.candidates.X_WG[grasp.candidate]
        np.testing.assert_allclose(stored.translation, grasp.p, atol=1e-12)


@pytest.mark.parametrize("policy", [Hindsight(), Continuous()])
def test_where_the_robot_helps_a_veto_refuses_the_grasp_that_it_helps_towards(robot, policy):
    loop = Loop(robot, scene(), arbitration=policy)
    loop.go(0.1)
    meant = loop.controller.ranking.best
    shown = loop.controller.shown[meant]
    step = loop.tick(OperatorSample(loop.time, loop.hand, buttons=frozenset({Button.VETO})))
    assert meant in step.reason
    loop.go(0.1)
    assert not loop.controller.shown[meant].almost_equal(shown, 1e-6)
