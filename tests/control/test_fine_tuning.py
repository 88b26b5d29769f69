"""Fine-tuning, next best and veto: the operator has a say in the grasp while the robot goes to it."""

import numpy as np
import pytest

import optsc
from optsc.control.approach import Approach, PathTarget
from optsc.control.fine_tuning import FineTuning, Shift, Tuning, TuningScene, hand_nudge, nudged, untouched
from optsc.control.modes import Event, Mode
from optsc.errors import InvalidValue
from optsc.geometry import Pose, rotation
from optsc.operators import Button, ClutchSettings, OperatorSample
from optsc.operators.clutch import Hand
from optsc.robot import load_robot
from optsc.testing.loop import DOWN, PERIOD, Loop, assert_limits_hold, modes, scene

PLACE = {"thing": (0.45, 0.1, 0.25)}
SETTINGS = FineTuning()


@pytest.fixture(scope="module")
def robot():
    return load_robot("panda")


def target_of(robot, clear=None):
    selector = optsc.GraspSelector(robot)
    candidates = scene(PLACE)
    selector.observe(candidates, robot.home, clear=clear)
    X_WT = Pose(DOWN, np.array(PLACE["thing"]) + [0, 0, 0.1])
    return TuningScene(robot, Approach(), candidates, clear), selector.rank(X_WT, robot.home).target()


def test_a_nudge_moves_grasp_and_pregrasp_in_the_grippers_own_frame_scaled(robot):
    where, target = target_of(robot)
    tuned, reason = nudged(SETTINGS, where, untouched(target), (0.01, -0.02, 0.005, 0.0, 0.0, 0.2))
    assert reason == ""
    step = Pose.from_rotation_vector([0, 0, 0.06], [0.003, -0.006, 0.0015])
    assert tuned.target.X_WG.almost_equal(target.X_WG @ step, 1e-12)
    assert tuned.target.X_WP.almost_equal(target.X_WG @ step @ Pose.from_translation([0, 0, -0.1]), 1e-9)
    for q, X in ((tuned.target.q, tuned.target.X_WG), (tuned.target.q_pregrasp, tuned.target.X_WP)):
        assert robot.forward(q).almost_equal(X, 1e-4)
    assert tuned.stored is target


def test_nudges_add_up_to_no_more_than_the_bounds(robot):
    where, target = target_of(robot)
    tuned = untouched(target)
    for _ in range(20):
        tuned, reason = nudged(SETTINGS, where, tuned, (0.02, 0.01, 0.0, 0.1, 0.0, 0.2))
        assert reason == ""
    offset = target.X_WG.inverse() @ tuned.target.X_WG
    assert np.linalg.norm(offset.translation) == pytest.approx(0.03, abs=1e-9)
    assert np.linalg.norm(rotation.log(offset.quaternion)) == pytest.approx(0.35, abs=1e-9)


def test_what_the_arm_cannot_reach_or_would_touch_is_not_taken_over(robot):
    where, target = target_of(robot)
    far = FineTuning(scale=(1.0, 1.0), most=(2.0, 3.0))
    start = untouched(target)
    assert nudged(far, where, start, (1.0, 0, 0, 0, 0, 0)) == (start, "the nudged pre-grasp is out of reach")
    touching = where._replace(clear=lambda q, q_pregrasp, candidates: np.array([False]))
    tuned, reason = nudged(SETTINGS, touching, start, (0.01, 0, 0, 0, 0, 0))
    assert (tuned, reason) == (start, "the nudged grasp would touch something")


def test_the_collision_check_sees_the_nudged_grasp(robot):
    seen = []

    def clear(q, q_pregrasp, candidates):
        seen.append((q, q_pregrasp, candidates))
        return np.array([True])

    where, target = target_of(robot)
    tuned, _ = nudged(SETTINGS, where._replace(clear=clear), untouched(target), (0.01, 0, 0, 0, 0, 0))
    q, q_pregrasp, candidates = seen[0]
    np.testing.assert_array_equal(q[0], tuned.target.q)
    np.testing.assert_array_equal(q_pregrasp[0], tuned.target.q_pregrasp)
    assert candidates.X_WG[0].almost_equal(tuned.target.X_WG)
    assert candidates.object_names[int(candidates.object_index[0])] == "thing"


def test_the_motion_of_a_hand_is_told_in_the_grippers_frame():
    R_WS, grasp = rotation.exp([0, 0, 0.7]), rotation.exp([0.2, 3.0, 0.1])
    before = Hand((0, 0, 0), tuple(rotation.exp([0.1, 0.2, 0.3])), 0.0)
    turn = np.array([0.01, -0.02, 0.03])
    after = Hand((0.1, 0.2, 0.3), tuple(rotation.multiply(rotation.exp(turn), before.q)), 0.1)
    told = hand_nudge(ClutchSettings(R_WS=tuple(R_WS)), before, after, tuple(grasp))
    to_grasp = rotation.multiply(rotation.conjugate(grasp), R_WS)
    np.testing.assert_allclose(told[:3], rotation.rotate(to_grasp, after.p), atol=1e-12)
    np.testing.assert_allclose(told[3:], rotation.rotate(to_grasp, turn), atol=1e-12)


def test_a_path_is_shifted_no_faster_than_its_speed_and_ends_where_it_was_led():
    shift = Shift((0.05, 0.25))
    turn = tuple(rotation.exp([0, 0, 0.05]))
    shift = shift.led(((0, 0, 0), (1, 0, 0, 0)), ((0.01, 0, 0), turn))
    still = PathTarget((1, 2, 3), (1, 0, 0, 0), *((0.0, 0.0, 0.0),) * 4)
    places = []
    for _ in range(101):
        shift, place = shift.applied(still, PERIOD)
        places.append(place)
    np.testing.assert_allclose(np.diff([x.p[0] for x in places])[:98], 0.05 * PERIOD, rtol=1e-9)
    assert places[50].v == pytest.approx((0.05, 0, 0))
    assert places[50].w == pytest.approx((0, 0, 0.25))
    assert not shift.moving
    np.testing.assert_allclose((*places[-1].p, *places[-1].q), (1.01, 2, 3, *turn))
    assert shift.applied(still, PERIOD)[1].v == (0, 0, 0)


def test_nudges_are_checked_together_when_it_is_time(robot):
    where, target = target_of(robot)
    tuning = Tuning(SETTINGS, where, untouched(target), 0.0)
    tuning = tuning.pushed((0.01, 0, 0, 0, 0, 0)).pushed((0.01, 0, 0, 0, 0, 0))
    assert tuning.settled(0.01) == (tuning, "")
    tuning, reason = tuning.settled(0.02)
    assert reason == ""
    moved = (target.X_WG.inverse() @ tuning.tuned.target.X_WG).translation
    np.testing.assert_allclose(moved, [0.006, 0, 0], atol=1e-12)


def going(robot, tuning=SETTINGS, **settings):
    """A loop in which the robot is on its way to the thing."""
    loop = Loop(robot, scene(PLACE), fine_tuning=tuning, **settings)
    loop.go(0.1)
    loop.press()
    assert loop.controller.mode is Mode.APPROACH
    return loop


def until(loop, mode, longest=8.0, **sample):
    end = loop.time + longest
    while loop.controller.mode is not mode and loop.time < end:
        loop.go(0.02, **sample)
    assert loop.controller.mode is mode


def press(loop, button):
    step = loop.decided(loop.tick(OperatorSample(loop.time, loop.hand, buttons=frozenset({button}))))
    loop.go(0.02)
    return step


def test_the_robot_waits_at_the_pregrasp_and_grasps_what_was_nudged_once_it_is_confirmed(robot):
    loop = going(robot)
    stored = loop.steps[-1].target
    # On the way, with a stick.
    loop.tick(OperatorSample(loop.time, loop.hand, nudge=(0.03, 0, 0, 0, 0, 0)))
    loop.go(0.1)
    until(loop, Mode.ADJUST)
    on_the_way = loop.steps[-1].target
    moved = (stored.X_WG.inverse() @ on_the_way.X_WG).translation
    np.testing.assert_allclose(moved, [0.009, 0, 0], atol=1e-9)
    assert loop.tool().almost_equal(on_the_way.X_WP, 0.012)
    # While it waits, with the hand: 4 cm along the world's y axis, of which 0.3 count.
    loop.go(0.4, move=(0, 0.04, 0), buttons=frozenset({Button.NUDGE}))
    loop.go(0.5)
    assert loop.controller.mode is Mode.ADJUST
    waiting = loop.steps[-1].target
    shift = waiting.X_WG.translation - on_the_way.X_WG.translation
    np.testing.assert_allclose(shift, [0, 0.012, 0], atol=3e-4)
    assert np.linalg.norm(loop.tool().translation - waiting.X_WP.translation) < 1.5e-3
    assert press(loop, Button.CONFIRM).event is Event.CONFIRMED
    until(loop, Mode.CLOSE)
    assert np.linalg.norm(loop.tool().translation - waiting.X_WG.translation) < 2e-3
    assert rotation.angle(loop.tool().quaternion, waiting.X_WG.quaternion) < 0.02
    assert_limits_hold(robot, loop.steps)


def test_a_hand_that_jumps_nudges_nothing(robot):
    loop = going(robot)
    loop.go(0.1, buttons=frozenset({Button.NUDGE}))
    target = loop.steps[-1].target
    loop.hand = Pose(rotation.multiply(rotation.exp([0.0, 0.0, 0.5]), loop.hand.quaternion), loop.hand.translation)
    loop.go(0.1, buttons=frozenset({Button.NUDGE}))
    loop.hand = Pose(loop.hand.quaternion, loop.hand.translation + [0.0, 0.08, 0.0])
    loop.go(0.1, buttons=frozenset({Button.NUDGE}))
    assert loop.steps[-1].target.X_WG.almost_equal(target.X_WG, 1e-9)


def test_without_the_button_the_hand_nudges_nothing(robot):
    loop = going(robot)
    target = loop.steps[-1].target
    loop.go(0.3, move=(0, 0.05, 0.02))
    assert loop.steps[-1].target is target


def test_who_confirms_on_the_way_is_not_waited_for_and_who_does_not_want_to_be_neither(robot):
    loop = going(robot)
    press(loop, Button.CONFIRM)
    until(loop, Mode.ADVANCE)
    assert "adjust" not in modes(loop.steps)
    loop = going(robot, FineTuning(wait=False))
    until(loop, Mode.ADVANCE)
    assert "adjust" not in modes(loop.steps)


@pytest.mark.parametrize("waiting", [False, True])
def test_cancel_and_trigger_give_the_motion_back_to_the_hand(robot, waiting):
    for way in ("cancel", "trigger"):
        loop = going(robot)
        if waiting:
            until(loop, Mode.ADJUST)
        else:
            loop.go(0.2)
        if way == "cancel":
            assert press(loop, Button.CANCEL).event is Event.CANCELLED
        else:
            loop.press()
        assert loop.controller.mode is Mode.MANUAL
        loop.go(0.1)
        assert_limits_hold(robot, loop.steps)


def test_next_takes_the_next_best_grasp_from_where_the_arm_is(robot):
    loop = going(robot)
    ranking, first = loop.controller.ranking, loop.steps[-1].target
    order = ranking.of("thing").tolist()
    loop.go(0.3)
    step = press(loop, Button.NEXT)
    assert step.event is Event.RETARGETED
    second = loop.steps[-1].target
    assert order.index(second.candidate) > order.index(first.candidate)
    until(loop, Mode.ADJUST)
    assert np.linalg.norm(loop.tool().translation - second.X_WP.translation) < 2e-3
    press(loop, Button.NEXT)
    assert loop.controller.mode is Mode.APPROACH
    assert loop.steps[-1].target.candidate not in (first.candidate, second.candidate)
    assert_limits_hold(robot, loop.steps)


def test_when_no_grasp_is_left_next_says_so_and_the_robot_goes_on(robot):
    loop = Loop(robot, scene(PLACE, count=2))
    loop.go(0.1)
    loop.press()
    for _ in range(3):
        step = press(loop, Button.NEXT)
    assert "no other grasp" in step.reason
    assert loop.controller.mode is Mode.APPROACH


def test_a_vetoed_grasp_is_not_offered_again_until_the_scene_changes(robot):
    candidates = scene(PLACE)
    loop = Loop(robot, candidates)
    loop.go(0.1)
    loop.press()
    refused = loop.steps[-1].target
    assert press(loop, Button.VETO).event is Event.RETARGETED
    assert loop.steps[-1].target.candidate != refused.candidate
    press(loop, Button.CANCEL)
    loop.go(0.1)
    ranking = loop.controller.ranking
    assert refused.candidate not in ranking.of("thing")
    assert ranking.rejected_by[refused.candidate] == "vetoed"
    loop.controller.observe(candidates)
    loop.go(0.1)
    assert refused.candidate in loop.controller.ranking.of("thing")


def test_a_veto_while_the_hand_leads_refuses_the_grasp_that_is_shown(robot):
    loop = Loop(robot, scene(PLACE))
    loop.go(0.1)
    shown = loop.controller.ranking.target()
    assert "refused" in press(loop, Button.VETO).reason
    loop.go(0.05)
    assert loop.controller.ranking.target().candidate != shown.candidate


def test_the_last_grasp_vetoed_leaves_the_motion_to_the_hand(robot):
    loop = Loop(robot, scene(PLACE, count=1))
    loop.go(0.1)
    loop.press()
    step = press(loop, Button.VETO)
    assert step.event is Event.CANCELLED
    assert "refused" in step.reason
    assert loop.controller.mode is Mode.MANUAL


def test_the_target_stays_locked_while_the_robot_moves(robot):
    loop = Loop(robot, scene({"left": (0.45, 0.2, 0.25), "right": (0.45, -0.2, 0.25)}))
    loop.go(0.6, move=(0.0, 0.1, 0.0))
    loop.press()
    target, ranking = loop.steps[-1].target, loop.controller.ranking
    loop.go(0.6, move=(0.0, -0.5, 0.0))
    assert loop.steps[-1].target is target
    assert loop.controller.ranking is ranking


@pytest.mark.parametrize("bad", [{"scale": (0.0, 1.0)}, {"most": (0.1,)}, {"speed": (0.1, np.nan)}, {"period": 0.0}])
def test_settings_out_of_range_of_fine_tuning_are_refused(bad):
    with pytest.raises(InvalidValue):
        FineTuning(**bad)


def test_a_nudge_that_is_no_nudge_is_skipped_and_shifts_nothing(robot):
    loop = going(robot)
    target = loop.controller.state.target
    loop.tick(OperatorSample(loop.time, loop.hand, nudge=(0, 0, 0, 0, 0, np.nan)))
    loop.go(0.05)
    assert loop.controller.mode is Mode.APPROACH
    assert loop.controller.state.target is target
    assert "nudge" in loop.controller.state.monitor.counts.reason
